"""Cost of a simulation, predicted from the description, short timings on this machine and earlier simulations.

The constants were fitted to the planes of 60 random cameras, for a machine with 2e10 complex multiply-adds per second
and thread in small matrix products. Forecasts for this machine are corrected by
`lfcal.simulate.accuracy.calibration`. The choice of a sampling uses the constants alone, so that it is the same on
every machine. `lfcal.simulate.predict_seconds` runs the engine briefly instead, and is more accurate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from lfcal.camera import LensletLattice, Microscope
from lfcal.simulate._pupil_scene import AnyScene, PupilScene
from lfcal.simulate.accuracy.calibration import machine_speed
from lfcal.simulate.accuracy.sampling import LevelSampling, grid_extent, steps_for
from lfcal.simulate.effects import EngineSeconds, Outlook, PupilOutlook
from lfcal.simulate.engines import Sampling, pupil_cost
from lfcal.simulate.scene import Scene

__all__ = [
    "correct_rate",
    "efficient_steps",
    "engine_seconds",
    "engine_times",
    "few_seconds",
    "step_for",
    "table_seconds",
]

FITTED_RATE = 2e10
"""Complex multiply-adds per second of the machine on which the constants were measured."""

SET_UP, PROBED = 0.1, 12
"""CPU-seconds for a plane's tables, twice because of the probe, and total number of positions that it computes."""

PER_LENSLET, PER_NODE, PER_COHERENT_NODE = 1.3e-5, 7e-9, 7.5e-9
"""CPU-seconds of windows: for each lenslet, for each sample and node, and for each node at which fields are added."""

OWN, SHARED, FEWEST = 0.45, 6.6, 12
"""Time of windows relative to that in a row of `FEWEST` positions: `OWN` plus `SHARED` divided by the positions of the
row, which share masks. Fitted to rows of 12 and 95 positions."""

PER_SAMPLE, PER_GRID, PER_TABLE_SAMPLE = 1.9e-10, 1.8e-5, 3e-7
"""CPU-seconds of a grid of n x n samples: for each n² log2 n, for each position, and for each sample of its table."""

PER_DEBYE, PER_DEBYE_NODE, DEBYE_SIDE = 1.2e-4, 2.8e-8, 200.0
"""CPU-seconds of the Debye path: for each position and node; side of a cutout (px) up to which pixels cost the same."""

MIRRORED = 6
"""Positions of a microscope's period for each position that is computed."""

REFERENCE_OVER_WAVE, REFERENCE_OVER_GRID = 280.0, 140.0
"""Ratio of the reference's time to that of windows, and of a grid."""

LEAST_RUN_S = 0.3
"""Smallest CPU-time of a plane, forecast or measured, that corrects forecasts; tables dominate shorter ones."""


def correct_rate(outlook: Outlook, level: str, tolerance: float, runs: int, took_s: float) -> None:
    """Correct later time forecasts with the measured computing time of one simulated plane.

    Parameters
    ----------
    outlook, level, tolerance
        As in `engine_seconds`.
    runs
        Number of light samples of the plane; the engine runs once for each.
    took_s
        Measured computing time (CPU-seconds).
    """
    if level in ("wave", "grid"):
        if isinstance(outlook.camera.optics, Microscope) and outlook.camera.has_lattice:
            return  # the Debye path was forecast: it did not run
        level = "wave"  # as it was forecast: the probe may have found another engine
    forecast = runs * engine_seconds(outlook, level, tolerance) / _ratio(outlook, level)
    if max(forecast, took_s) >= LEAST_RUN_S:
        machine_speed().correct(_engine(outlook, level), forecast, took_s)


def _slowness() -> float:
    return FITTED_RATE / machine_speed().rate()


def _engine(outlook: Outlook, level: str) -> str:
    """Return the name under which forecasts are corrected.

    Windows and grids have the same, so that the choice between them is the same on every machine.
    """
    return "single lenslets" if isinstance(outlook, PupilOutlook) else level


def _ratio(outlook: Outlook, level: str) -> float:
    return machine_speed().ratio(_engine(outlook, level))


def engine_seconds(outlook: Outlook, level: str, tolerance: float = 0.03) -> float:
    """Return the estimated CPU-seconds of one plane on this machine, including tables, at a level.

    The levels are those of `lfcal.simulate.engines.base.LEVELS`.
    """
    positions = outlook.period[0] * outlook.period[1]
    # most positions of a whole period of a microscope are mirror images of others
    seconds = _estimated_seconds(outlook, level, tolerance, positions / (MIRRORED if level == "debye" else 1))
    return _slowness() * _ratio(outlook, level) * seconds


def few_seconds(outlook: Outlook, level: str, tolerance: float, positions: int) -> float:
    """Return the estimated CPU-seconds of ``positions`` positions, including tables, on the reference machine.

    The constants of the estimate were measured on that machine. Decisions based on these times are therefore the same
    on every machine.
    """
    return _estimated_seconds(outlook, level, tolerance, positions)


def _estimated_seconds(outlook: Outlook, level: str, tolerance: float, positions: float) -> float:
    """Return CPU-seconds of positions that are not mirror images of each other, by the uncorrected constants."""
    if isinstance(outlook, PupilOutlook):
        level = "reference" if level == "reference" else "wave"
        sampling = step_for(outlook.scene, level, tolerance).sampling
        return positions * pupil_cost(outlook.scene, level, sampling) / FITTED_RATE
    if level == "geometric":
        light = _Light.of(outlook)
        seen = light.lenslets(math.ceil(max(light.spots_px)))
        return 0.005 + positions * (2.5e-6 * seen + 1e-9 * outlook.pixels + 1e-5)
    # the reference has no separate sampling here: its cost is a multiple of that of the wave engine
    step = step_for(outlook, "wave" if level == "reference" else level, tolerance)
    tables, each = _step_seconds(outlook, step)
    if level == "reference":
        return positions * each * (REFERENCE_OVER_GRID if step.level == "grid" else REFERENCE_OVER_WAVE)
    return tables + each * (positions + PROBED)


def efficient_steps(described: AnyScene | Outlook, level: str) -> tuple[LevelSampling, ...]:
    """Return the samplings of a level, fastest first, without those for which a finer one is not slower.

    The first sampling that is expected to keep a tolerance is therefore the fastest that keeps it, and it is never
    slower than that of a smaller tolerance. Times are those of the reference machine, so that an H does not depend on
    the machine that computes it.
    """
    steps = steps_for(described, level)
    if isinstance(described, PupilScene) or len({step.level for step in steps}) == 1:
        return steps  # samplings of one engine become slower as they become finer
    positions = math.prod(described.period) + PROBED
    best, kept = math.inf, []
    for step in reversed(steps):
        tables, each = _step_seconds(described, step)
        if tables + positions * each < best:
            best = tables + positions * each
            kept.append(step)
    return tuple(reversed(kept))


def step_for(described: AnyScene | Outlook, level: str, tolerance: float) -> LevelSampling:
    """Return the fastest sampling of a level whose expected error is within ``tolerance``, or else the finest one."""
    steps = efficient_steps(described, level)
    return next((step for step in steps if step.expected <= tolerance), steps[-1])


def _step_seconds(described: Scene | Outlook, step: LevelSampling) -> tuple[float, float]:
    """Return the CPU-seconds of a sampling's tables, and of one position, on the reference machine."""
    sampling = step.sampling
    if step.level == "debye":
        # for large cutouts, the time of matrix products grows with the side rather than with the number of pixels
        pixels = math.prod(described.cutout)
        larger = max(1.0, math.sqrt(pixels) / DEBYE_SIDE)
        return 0.01, PER_DEBYE + pixels * sampling.nodes_per_px**2 * PER_DEBYE_NODE * larger
    if step.level == "grid":
        per = int(sampling.samples_per_px or 4)
        side = grid_extent(described).side(per, sampling.margin_px)
        rows, columns = (side + per * n for n in described.period)
        return SET_UP + PER_TABLE_SAMPLE * rows * columns, PER_GRID + PER_SAMPLE * side**2 * math.log2(side)
    return SET_UP, _Light.of(described).wave_seconds(sampling)


@dataclass(frozen=True, slots=True)
class _Light:
    """Sizes that determine an engine's work for one position: the same for a scene and for the outlook on it."""

    cutout: tuple[int, int]
    columns: int
    pixel_um: float
    wavelength_um: float
    f_number: float
    gap_um: float
    image_um: float
    lattice: LensletLattice
    shadow_px: float

    @classmethod
    def of(cls, described: Scene | Outlook) -> _Light:
        """Return the sizes of a scene in its reduced frame, or of an outlook."""
        columns = described.period[1]
        cutout, wavelength, f_number = described.cutout, described.wavelength_um, described.f_number
        if isinstance(described, Outlook):
            px, gap, image, lattice = described.pixel_um, described.gap_um, described.shift_um, described.camera.lattice
            assert isinstance(lattice, LensletLattice)  # of single lenslets, the engine itself states its cost
            return cls(cutout, columns, px, wavelength, f_number, gap, image, lattice, described.shadow_px)
        px, gap, image = described.reduced_pixel_um, described.reduced_gap_um, described.reduced_image_um
        image = image if abs(image) >= wavelength else math.copysign(wavelength, image)
        shadow = math.hypot(described.shadow_radius_um, 1.22 * wavelength * f_number) / px
        return cls(cutout, columns, px, wavelength, f_number, gap, image, described.lattice, shadow)

    def wave_seconds(self, sampling: Sampling) -> float:
        """Return the seconds of a position, from its lenslets, samples on them, and nodes of windows and cutout."""
        nodes, widest = 0.0, 0
        for spot in self.spots_px:
            half = math.ceil(spot + sampling.margin_px)
            widest = max(widest, half)
            # samples per pixel on a lenslet that the window on the sensor needs (Nyquist), in steps of a half
            need = 2 * (half + 0.5) * self.pixel_um**2 / (self.wavelength_um * self.gap_um)
            samples = 2 * self.lit_px * max(1.0, math.ceil(2 * need) / 2) + 3
            window = (2 * half + 1) * sampling.nodes_per_px + 2
            nodes += (samples**2 + window**2) / len(self.lattice.types)
        coherent = PER_COHERENT_NODE * math.prod(self.cutout) * sampling.nodes_per_px**2 if sampling.coherent else 0.0
        share = OWN + SHARED / max(self.columns, FEWEST)
        return share * self.lenslets(widest) * (PER_LENSLET + PER_NODE * nodes) + coherent

    @property
    def lit_px(self) -> float:
        """Radius of the lit part of a lenslet (pixels)."""
        return min(0.5 * self.lattice.clear_diameter_um / self.pixel_um, self.shadow_px)

    @property
    def spots_px(self) -> tuple[float, ...]:
        """Radius of each type's spot (pixels); near the native plane, that of the pupil's image."""
        cone, gap, spots = 1 / (2 * self.f_number), self.gap_um, []
        for kind in self.lattice.types:
            at_infinity = 1 - gap / kind.focal_length_um
            pupil = abs(at_infinity) * self.lattice.clear_diameter_um / 2 + gap * cone
            whole = abs(at_infinity * self.image_um - gap) * cone
            blur = abs(at_infinity - gap / self.image_um) * self.lit_px
            spots.append(min(blur, pupil / self.pixel_um, whole / self.pixel_um))
        return tuple(spots)

    def lenslets(self, half_px: int) -> float:
        """Return the number of lit lenslets whose windows, ``half_px`` on either side, reach into the cutout."""
        pitch, px = self.lattice.pitch_um / self.pixel_um, self.pixel_um
        rows, columns = (n + 2 * half_px + 0.5 * pitch for n in self.cutout)
        # spots are 1 - B/a times as far apart as their lenslets
        apart = abs(1 - self.gap_um / self.image_um) if abs(self.image_um) > 1e-3 * self.gap_um else math.inf
        cell = pitch * self.lattice.row_step_um / px
        # lenslets at the shadow's edge are partly lit, and lit by its fringes
        radius = self.shadow_px + 0.25 * pitch + 0.5 * math.sqrt(self.wavelength_um * abs(self.image_um)) / px
        lit = max(1.0, math.pi * radius * radius / cell)
        return min(lit, max(1.0, rows * columns / max(cell * apart * apart, 1e-9)))


def table_seconds(outlook: Outlook) -> float:
    """Return the estimated CPU-seconds of the Fourier transform that tabulates a plane's main-iris fringes."""
    if isinstance(outlook, PupilOutlook):
        return 0.0
    side = 4 * (outlook.shadow_px + 4 * outlook.camera.pitch_px)
    return _slowness() * 2.5e-7 * side**2


def engine_times(outlook: Outlook, waves: str, tolerance: float) -> EngineSeconds:
    """Return the CPU-seconds of one plane with rays, with waves at the level ``waves``, and of a table of fringes."""
    return EngineSeconds(
        engine_seconds(outlook, "geometric"), engine_seconds(outlook, waves, tolerance), table_seconds(outlook)
    )
