"""Samplings of an engine, from coarse to fine, each with its expected error."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from lfcal.simulate._pupil_scene import AnyScene, PupilScene
from lfcal.simulate._symmetry import is_separable
from lfcal.simulate.effects import Outlook
from lfcal.simulate.engines import (
    MAX_ORDERS,
    MAX_SAMPLES,
    MAX_SIDE,
    PUPIL_LEVELS,
    SWITCH,
    SWITCH_EXACT,
    Extent,
    Sampling,
    pupil_error,
)
from lfcal.simulate.scene import Scene

__all__ = [
    "GRID_REFERENCE",
    "WIDEST",
    "Fringes",
    "LevelSampling",
    "comparison",
    "finer",
    "grid_extent",
    "grid_margin",
    "steps_for",
    "tilt_orders",
]

WINDOWS: tuple[tuple[float, float, float], ...] = ((1, 1.0, 0.05), (1, 1.5, 0.007), (2, 2.0, 0.004), (4, 2.0, 0.0015))
"""Steps that add intensities of neighbouring lenslets: margin (px), nodes per cycle of the light's band, and their
relative L1 error (measured) in addition to that of the sum; see `Fringes.incoherent`. Light outside the windows is
added by `lfcal.simulate.engines._tails`."""

COHERENT: tuple[tuple[float, int, float, float], ...] = (
    (8, 0, 3e-3, 0.017),
    (11, 0, 3e-3, 0.0125),
    (14, 0, 3e-3, 0.009),
    (17, 0, 3e-3, 0.0065),
    (24, 0, 3e-3, 0.0035),
    (34, 1, 1e-3, 0.002),
    (48, 1, 5e-4, 0.001),
)
"""Samplings that add fields: margin (px), nodes beyond those for the fringes, energy floor, and expected error."""

AIRY_PX = 0.5
"""lambda B/d in pixels up to which the margins are sufficient; they grow with larger spots."""

WIDEST = 1000
"""Largest margin of a window (px)."""

SPARE = 0.6
"""Nodes per pixel beyond the band of the light, so that aliases are at frequencies that pixels do not detect."""

ONE_NODE = (0.16, 0.6)
"""Expected error of one node per pixel of the Debye path, divided by the square of `Fringes.band`: if the light is
within a lenslet, and otherwise. A failed attempt costs half the time of a small plane. The values are therefore upper
limits (measured on 17 random microscopes: 0.075 to 0.12, and 0.18 to 0.4; the comparison overestimates them by a factor
of 1.2)."""

UNBALANCED = 0.1
"""Error of one node above which it is not tried: often, the energy does not balance."""

DEBYE_NODES: tuple[tuple[int, float], ...] = ((2, 0.01), (3, 0.005), (4, 0.0025))
"""More nodes per pixel of the Debye path, each with its expected error."""

MAX_NODES = 12
"""Largest number of nodes per pixel of the Debye path."""

DEBYE_GAIN = 2.5
"""Factor by which one more node per pixel reduces the Debye path's error, at least (measured: 2.6 to 5)."""

GRID: tuple[tuple[float, int, float], ...] = ((1.0, 4, 0.008), (1.3, 5, 0.004), (1.6, 6, 0.002), (2.4, 9, 0.0012))
"""Steps on one grid. Each has the ratio of samples to the fewest for the light's angles, and the ratio to the fewest
for the lenslets' edges. It also has the fraction of light outside its margins."""

SAMPLED, STEEPNESS, ROUNDED = 0.82, 2.5, 1e-4
"""Error of n samples per pixel, of which the light's angles need m: ``SAMPLED`` (m/n)**``STEEPNESS`` divided by the
samples across a lenslet; and the rounding error. Fitted to grids of 45 random cameras (median; see
`_grid_error`)."""

DIM, SLOPE, DIMMEST, BRIGHT = 1.3, 1.5, 4.0, 0.15
"""Ratio of the error to the fraction of light outside a grid's margins. It is ``SLOPE`` times the excess over ``DIM``
of the shadow's width, relative to the cutout's. It is at most ``DIMMEST`` divided by that width, because the tail of a
wider shadow is further away. If most of the light falls into the cutout, it is ``BRIGHT``. (Measured: 1.8 with a ratio
of widths of 2.4, 1.3 with 3.5, 0.9 with 4.4, and 0.5 with 8.)"""

CAUTION = 1.2
"""Ratio of the expected error to its median over cameras. A sampling that fails costs time, and so does one that is too
fine: each happened in 9 % of all cases (13 % and 5 % with a ratio of 1)."""

FINER_GRID = ((2, 0.75), (2, 0.55), (3, 0.8))
"""Index of the sampling with which samplings on a grid are compared, and the smallest fraction of their error that this
comparison shows."""

GRID_REFERENCE = 1
"""Index of the coarsest sampling on a grid with which windows are compared."""

KINK = 1.4
"""Oversampling on one grid if light meets the kink between lenslets, relative to other light. With 1.2 times the
sampling for its angles, the error of a response on a corner is 5 %; with 1.6 times, 0.6 %
(4x/0.28, lenslets of f/7)."""

OUTSIDE = 0.15
"""Fraction of light farther than r outside the shadow, times r / (lambda Nw)."""

PUPIL_MARGINS = (8, 12, 18, 27, 40, 60, 90, 135, 200, 300, 450, 670, 1000)
"""Margins (px) of the windows behind lenslets in a pupil plane."""

PUPIL_NODES, PUPIL_FLOOR = 8, 1e-5
"""For lenslets in a pupil plane: largest number of nodes per pixel, and an error that is always negligible."""

REFERENCE = ((1.0, 3, 0.03), (1.25, 4, 0.006), (1.6, 6, 0.002), (2.4, 10, 0.0005))
"""Samples of the reference: the ratio to the fewest for the light's angles, the fewest for the lenslets' edges, and the
expected error."""


@dataclass(frozen=True, slots=True)
class LevelSampling:
    """A level of the engine with one sampling and the expected relative L1 error."""

    level: str
    sampling: Sampling
    expected: float


@dataclass(frozen=True, slots=True)
class Fringes:
    """Spatial frequencies of light of wavelength lambda on the sensor, for lenslets of diameter d, pitch p and gap B.

    Attributes
    ----------
    band
        Highest frequency behind one lenslet, d/(lambda B) (cycles per pixel).
    between
        Frequency added by neighbouring lenslets, p/(lambda B) (cycles per pixel).
    pitch_px
        Lenslet pitch (pixels).
    angle
        Samples per pixel needed for all angles of the light between lenslets and sensor.
    """

    band: float
    between: float
    pitch_px: float
    angle: float

    @classmethod
    def of(cls, described: Scene | Outlook) -> Fringes:
        """Return the frequencies of a scene, or of an outlook (without the rotation of lattice cells)."""
        if isinstance(described, Outlook):
            scale = described.camera.lattice_scale
            lattice, px = described.camera.lattice.scaled(1 / scale), described.pixel_um / scale
            width, spread = lattice.clear_diameter_um, described.wavelength_um * described.gap_um / scale
            shortest = min(abs(kind.focal_length_um) for kind in lattice.types)
            steepest = 1 / (2 * described.f_number) + width / 2 / shortest
            angle = 2 * px * min(steepest, 1.0) / described.wavelength_um
        else:
            from lfcal.simulate.engines import (
                aperture_width,
                largest_angle,  # compiled code: loaded only when it is needed
            )

            lattice, px = described.lattice, described.reduced_pixel_um
            width, spread = aperture_width(described), described.wavelength_um * described.reduced_gap_um
            angle = largest_angle(described)
        pitch = lattice.pitch_um
        return cls(width * px / spread, pitch * px / spread, pitch / px, angle)

    @property
    def nodes(self) -> int:
        """Nodes per pixel needed to sample the fringes between neighbouring lenslets."""
        return math.ceil(self.band + self.between + SPARE)

    @property
    def spot(self) -> float:
        """Factor by which margins exceed those for spots of size `AIRY_PX`; at least 1."""
        return max(1.0, 1 / (max(self.band, 1e-6) * AIRY_PX))

    @property
    def incoherent(self) -> float:
        """Relative L1 error of adding intensities of neighbouring lenslets instead of their fields.

        It is estimated by a formula fitted to measured errors.
        """
        return 0.4 / self.pitch_px


def steps_for(
    described: AnyScene | Outlook, level: str, *, exact: bool = False, separable: bool = True
) -> tuple[LevelSampling, ...]:
    """Return the samplings of a level, fastest first.

    Level ``"wave"``: windows whose intensities are added, then the whole array on one grid; near the native plane, only
    grids. If no grid is large enough for the scene, windows whose fields are added replace the grids. Level
    ``"debye"``: numbers of nodes for the separable path; for other arrays, grids that are small enough. Level
    ``"grid"``: all grids that are small enough, or else the smallest one, which the engine rejects as too large.

    ``exact`` and ``separable`` are those of the effects on an outlook; a scene has its own.
    """
    if isinstance(described, PupilScene):
        return _pupil_steps(described, level)
    fringes = Fringes.of(described)
    if level == "debye":
        by_rows = is_separable(described) if isinstance(described, Scene) else separable
        grid = () if by_rows else _grid_steps(described, fringes)
        if grid:
            return grid
        one = ONE_NODE[_shadow_um(described) > fringes.pitch_px * _pixel_um(described)] * fringes.band**2
        tried = DEBYE_NODES
        if one <= UNBALANCED:
            tried = ((1, max(one, tried[0][1])), *tried)
        known = [LevelSampling(level, Sampling(nodes_per_px=n), error) for n, error in tried]
        more = range(tried[-1][0] + 1, MAX_NODES + 1)
        return (*known, *(LevelSampling(level, Sampling(nodes_per_px=n), 0.04 / n**2) for n in more))
    if level == "reference":
        counts = [(max(fewest, math.ceil(share * fringes.angle)), error) for share, fewest, error in REFERENCE]
        return tuple(LevelSampling(level, Sampling(samples_per_px=n), error) for n, error in counts)
    if level == "geometric":
        return (LevelSampling(level, Sampling(), 0.0),)
    grid = _grid_steps(described, fringes)
    if level == "grid":
        return grid or _every_grid_step(described, fringes)[:1]
    if grid and _near(described, exact=exact):  # spots overlap, and windows do not follow exact angles
        return grid
    steps = []
    for margin, per_cycle, error in WINDOWS:
        nodes = max(round(2 * per_cycle), math.ceil(per_cycle * fringes.band))
        sampling = Sampling(nodes_per_px=nodes, margin_px=_margin_px(margin, fringes))
        steps.append(LevelSampling(level, sampling, error + fringes.incoherent))
    if grid:
        return (*steps, *grid)
    for margin, extra, floor, error in COHERENT:
        if margin * fringes.spot > WIDEST:
            break  # slow lenslets on small pixels: the remaining samplings are tried as they are
        sampling = Sampling(
            nodes_per_px=fringes.nodes + extra, margin_px=_margin_px(margin, fringes), energy_floor=floor, coherent=True
        )
        steps.append(LevelSampling(level, sampling, error))
    return tuple(steps)


def comparison(steps: Sequence[LevelSampling], step: LevelSampling) -> tuple[LevelSampling, float] | None:
    """Return the step on a grid with which ``step`` is compared first, and the fraction of its error that this reveals.

    ``steps`` are those of the scene. The fraction is 1 for windows. None: no step of ``steps`` is suitable.
    """
    grids = [one for one in steps if one.level == "grid"]
    if step.level == "wave":
        return next(((one, 1.0) for one in grids[GRID_REFERENCE:]), None)
    found = next((k for k, one in enumerate(grids) if one.sampling == step.sampling), len(grids))
    index, visible = FINER_GRID[found] if found < len(FINER_GRID) else (len(grids), 1.0)
    if step.level != "grid" or index >= len(grids):
        return None
    return grids[index], max(visible, 1 - grids[index].expected / step.expected)


def _pupil_steps(scene: PupilScene, level: str) -> tuple[LevelSampling, ...]:
    """Return the samplings for lenslets in a pupil plane: wider windows, each with its number of nodes per pixel."""
    if level not in PUPIL_LEVELS:
        return (LevelSampling(level, Sampling(), 0.0),)  # its engine refuses it
    steps = []
    for margin in PUPIL_MARGINS if level == "wave" else (WIDEST,):
        tried = [Sampling(nodes_per_px=n, margin_px=margin) for n in range(1, PUPIL_NODES + 1)]
        finest = pupil_error(scene, level, tried[-1])
        # the fewest nodes that add a tenth to the window's error
        chosen = next((s for s in tried if pupil_error(scene, level, s) <= 1.1 * finest + PUPIL_FLOOR), tried[-1])
        steps.append(LevelSampling(level, chosen, pupil_error(scene, level, chosen)))
    return tuple(steps)


def _grid_steps(described: Scene | Outlook, fringes: Fringes) -> tuple[LevelSampling, ...]:
    """Return the steps of level ``"grid"`` that are not too large, cheapest first."""
    extent, px = grid_extent(described), _pixel_um(described)
    steps = []
    for step in _every_grid_step(described, fringes):
        per = int(step.sampling.samples_per_px or 4)
        side = extent.side(per, step.sampling.margin_px)
        fits = side <= MAX_SAMPLES and side + per * max(described.period) <= MAX_SIDE
        if fits and tilt_orders(described, side / per / 2 * px) <= MAX_ORDERS:
            steps.append(step)
    return tuple(steps)


def _every_grid_step(described: Scene | Outlook, fringes: Fringes) -> tuple[LevelSampling, ...]:
    """Return the steps of level ``"grid"``, whatever their size."""
    steps, needed = [], _kink_factor(described) * fringes.angle
    for share, fewest, left_out in GRID:
        per, margin = max(fewest, math.ceil(share * needed)), grid_margin(described, left_out)
        expected = _grid_error(per, needed, per * fringes.pitch_px, left_out * _dimness(described))
        steps.append(LevelSampling("grid", Sampling(samples_per_px=per, margin_px=margin), expected))
    return tuple(steps)


def _grid_error(per_px: float, needed: float, across: float, outside: float) -> float:
    """Return the expected error of a grid.

    Parameters
    ----------
    per_px, needed
        Samples per pixel, and those for the angles of the light.
    across
        Samples across a lenslet.
    outside
        Error by the light outside the margins.
    """
    sampled: float = SAMPLED * (needed / per_px) ** STEEPNESS / across
    return CAUTION * (sampled + outside) + ROUNDED


def _dimness(described: Scene | Outlook) -> float:
    """Return the ratio of the error to the fraction of light outside the margins."""
    radius_px = _shadow_um(described) / _pixel_um(described)
    wider = math.sqrt(math.pi * radius_px**2 / math.prod(described.cutout))
    return max(BRIGHT, min(SLOPE * (wider - DIM), DIMMEST / max(wider, DIM)))


def _shadow_um(described: Scene | Outlook) -> float:
    """Return the radius of the light on the array in the reduced frame (µm)."""
    if not isinstance(described, Outlook):
        return described.shadow_radius_um
    if not described.has_lens:
        return described.shadow_px * described.pixel_um
    image, pupil = described.shift_um, described.camera.optics.image_distance_um
    return abs(image / (1 + image / pupil)) / (2 * described.f_number)


def _kink_factor(described: Scene | Outlook) -> float:
    """Return the factor on the number of samples if all light may meet at the edge between touching lenslets."""
    if isinstance(described, Outlook):
        lattice = described.camera.lattice.scaled(1 / described.camera.lattice_scale)
        touching = lattice.gapless
    else:
        lattice, touching = described.lattice, not described.round_lenslets
    return KINK if touching and _shadow_um(described) < lattice.pitch_um / 2 else 1.0


def grid_margin(described: Scene | Outlook, left_out: float) -> int:
    """Return the margin of a grid (px) beyond which the fraction ``left_out`` of the light falls; at most `WIDEST`."""
    airy = described.wavelength_um * described.f_number / _pixel_um(described)
    return min(WIDEST, math.ceil(OUTSIDE * airy / left_out))


def _pixel_um(described: Scene | Outlook) -> float:
    if isinstance(described, Scene):
        return described.reduced_pixel_um
    return described.pixel_um / described.camera.lattice_scale


def tilt_orders(described: Scene | Outlook, reach_um: float) -> int:
    """Return the number of fields needed for a tilted array if lenslets up to ``reach_um`` (µm) away receive light.

    It is 1 without tilt, and for an outlook.
    """
    if not isinstance(described, Scene) or described.tilt == (0.0, 0.0):
        return 1
    from lfcal.simulate.engines import orders_of  # compiled code: loaded only when it is needed

    return orders_of(described, reach_um)


def grid_extent(described: Scene | Outlook) -> Extent:
    """Return the region that a grid must cover for the light of one position."""
    if isinstance(described, Scene):
        from lfcal.simulate.engines import extent_of  # compiled code: loaded only when it is needed

        return extent_of(described)
    outwards = _near(described) or described.shift_um < 0
    aside = described.gap_um / (2 * described.f_number) / described.pixel_um if outwards else 0.0
    return Extent(described.shadow_px, aside, max(described.cutout) / 2, described.camera.pitch_px)


def _near(described: Scene | Outlook, *, exact: bool = False) -> bool:
    """Return whether the field near the native plane is computed without removing its sphere.

    ``exact``: whether an outlook's angles are exact.
    """
    if isinstance(described, Outlook):
        return described.fresnel_main < (SWITCH_EXACT if exact else SWITCH)
    from lfcal.simulate.engines import choose_mode

    return choose_mode(described) == "U"


def _margin_px(margin: float, fringes: Fringes) -> int:
    return min(WIDEST, math.ceil(margin * fringes.spot))


def finer(sampling: Sampling) -> Sampling:
    """Return the next finer sampling: one more node per pixel, and a margin that is 3 px wider, up to the limits."""
    return replace(
        sampling, nodes_per_px=min(32, sampling.nodes_per_px + 1), margin_px=min(WIDEST, sampling.margin_px + 3)
    )
