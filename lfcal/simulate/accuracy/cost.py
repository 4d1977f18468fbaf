"""Cost of a simulation, predicted from the description, short timings on this machine and earlier simulations.

The constants were fitted to the engines of this package on a machine with 2e10 complex multiply-adds per second and
thread in small matrix products; they are scaled by that rate. They are accurate within a factor of about 2 for planes
that take seconds. For planes that take tenths of a second they are up to ten times too high, because their tables cost
less than assumed. `lfcal.simulate.predict_seconds` runs the engine briefly instead, and is accurate within a factor of
2.
"""

from __future__ import annotations

import math
import threading
import time

import numpy as np

from lfcal.base import one_blas_thread
from lfcal.simulate.accuracy.sampling import grid_extent, step_for
from lfcal.simulate.effects import EngineSeconds, Outlook, PupilOutlook
from lfcal.simulate.engines import Sampling, pupil_cost

__all__ = ["correct_rate", "engine_seconds", "engine_times", "few_seconds", "machine_rate", "table_seconds"]

FITTED_RATE = 2e10
"""Complex multiply-adds per second of the machine on which the constants were measured."""

PER_LENSLET = 1.1e-5
PER_NODE = 6e-9
PER_COHERENT_NODE = 7.5e-9
SET_UP, PROBED = 0.4, 12
"""Time for the tables, counted twice because of the probe, and total number of positions that it computes."""

DEBYE_SIDE = 200.0
"""Side of a microscope's cutout (px) up to which each pixel costs the same."""

MIRRORED = 6
"""Positions of a microscope's period for each position that is computed."""

REFERENCE_OVER_WAVE, REFERENCE_OVER_GRID = 320.0, 65.0
PER_SAMPLE, PER_TABLE_SAMPLE, GRID_SET_UP = 4.2e-10, 7e-7, 0.15


TIMINGS, INTERVAL_S = 12, 0.5
"""Number of timings of the machine in a process, and seconds between them, because a single timing may be too slow."""

TICKS = 20
"""Smallest duration of a timing in ticks of the clock."""

LEAST_RUN_S = 1.0
"""Smallest CPU-time of a plane, forecast or measured, that corrects the rate; tables dominate shorter ones."""

MAX_CORRECTION = 5.0
"""Largest factor by which simulations correct the rate."""


class _Rate:
    """The speed of this machine, as estimated in this process."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.best, self.timings, self.last = 0.0, 0, -math.inf
        self.slowness = 1.0

    def measure(self) -> None:
        """Measure the speed at the first calls, and then at intervals; the best result is kept."""
        with self.lock:
            if self.timings >= TIMINGS or (self.timings and time.monotonic() - self.last < INTERVAL_S):
                return
            for _ in range(1 if self.timings else 3):
                self.best = max(self.best, _timed_rate())
            self.timings, self.last = self.timings + 1, time.monotonic()

    def correct_rate(self, forecast_s: float, took_s: float) -> None:
        """Correct the rate by half of the difference between actual and forecast time, on a logarithmic scale."""
        if max(forecast_s, took_s) >= LEAST_RUN_S and min(forecast_s, took_s) > 0:
            with self.lock:
                found = self.slowness * math.sqrt(took_s / forecast_s)
                self.slowness = min(max(found, 1 / MAX_CORRECTION), MAX_CORRECTION)


_RATE = _Rate()


def _timed_rate() -> float:
    """Return complex multiply-adds per CPU-second of this thread; the time of other programs is not counted."""
    n, count = 96, 0
    a = np.ones((n, n), np.complex64)
    least = max(2e-3, TICKS * time.get_clock_info("thread_time").resolution)
    with one_blas_thread():
        a @ a  # the first product fills caches
        start = time.thread_time()
        while (took := time.thread_time() - start) < least:
            a @ a
            count += 1
    return n**3 * count / took


def machine_rate() -> float:
    """Return the number of complex multiply-adds per CPU-second that one thread of this machine performs.

    The rate is the best of several measurements, corrected with the times of the planes that this process has
    simulated.
    """
    _RATE.measure()
    return _RATE.best / _RATE.slowness


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
    _RATE.correct_rate(runs * engine_seconds(outlook, "wave" if level == "grid" else level, tolerance), took_s)


def _slowness() -> float:
    return FITTED_RATE / machine_rate()


def engine_seconds(outlook: Outlook, level: str, tolerance: float = 0.03) -> float:
    """Return the estimated CPU-seconds of one plane, including tables, at a level.

    The levels are those of `lfcal.simulate.engines.base.LEVELS`.
    """
    positions = outlook.period[0] * outlook.period[1]
    # most positions of a whole period of a microscope are mirror images of others
    return _slowness() * _estimated_seconds(
        outlook, level, tolerance, positions / (MIRRORED if level == "debye" else 1)
    )


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
        widest = math.ceil(max(_spots_px(outlook)))
        seen = _lit_lenslets(outlook, widest)
        return 0.005 + positions * (2.5e-6 * seen + 1e-9 * outlook.pixels + 1e-5)
    # the reference has no separate sampling here: its cost is a multiple of that of the wave engine
    step = step_for(outlook, "wave" if level == "reference" else level, tolerance)
    if level == "debye":
        # for large cutouts, the time of matrix products grows with the side rather than with the number of pixels
        larger = max(1.0, math.sqrt(outlook.pixels) / DEBYE_SIDE)
        return 0.05 + positions * outlook.pixels * step.sampling.nodes_per_px**2 * 2.8e-8 * larger
    if step.level == "grid":
        each, setup = _grid_seconds(outlook, step.sampling)
    else:
        each, setup = _wave_seconds(outlook, step.sampling), SET_UP
    if level == "reference":
        return positions * each * (REFERENCE_OVER_GRID if step.level == "grid" else REFERENCE_OVER_WAVE)
    return setup + each * (positions + PROBED)


def _grid_seconds(outlook: Outlook, sampling: Sampling) -> tuple[float, float]:
    """Return the seconds of one position on a grid, of its tables, and of those of the grid for comparison."""
    per = int(sampling.samples_per_px or 4)
    side = grid_extent(outlook).side(per, sampling.margin_px)
    rows, columns = (side + per * n for n in outlook.period)
    return PER_SAMPLE * side**2 * math.log2(side), GRID_SET_UP + PER_TABLE_SAMPLE * rows * columns


def _wave_seconds(outlook: Outlook, sampling: Sampling) -> float:
    """Return the seconds of one position, from its lenslets, samples on them, and nodes of windows and cutout."""
    nodes, widest = 0.0, 0
    for spot in _spots_px(outlook):
        half = math.ceil(spot + sampling.margin_px)
        widest = max(widest, half)
        # samples per pixel on a lenslet that the window on the sensor needs (Nyquist), in steps of a half
        need = 2 * (half + 0.5) * outlook.pixel_um**2 / (outlook.wavelength_um * outlook.gap_um)
        samples = 2 * outlook.lit_px * max(1.0, math.ceil(2 * need) / 2) + 3
        window = (2 * half + 1) * sampling.nodes_per_px + 2
        nodes += (samples**2 + window**2) / len(outlook.defocus)
    coherent = PER_COHERENT_NODE * outlook.pixels * sampling.nodes_per_px**2 if sampling.coherent else 0.0
    return _lit_lenslets(outlook, widest) * (PER_LENSLET + PER_NODE * nodes) + coherent


def _spots_px(outlook: Outlook) -> tuple[float, ...]:
    """Return the radius of each type's spot (pixels); near the native plane, that of the pupil's image."""
    cone, gap = 1 / (2 * outlook.f_number), outlook.gap_um
    spots = []
    for kind, spot in zip(outlook.camera.lattice.types, outlook.geometric_px, strict=True):
        at_infinity = abs(1 - gap / kind.focal_length_um)
        pupil = at_infinity * outlook.clear_um / 2 + gap * cone
        whole = abs((1 - gap / kind.focal_length_um) * outlook.shift_um - gap) * cone
        spots.append(min(spot, pupil / outlook.pixel_um, whole / outlook.pixel_um))
    return tuple(spots)


def _lit_lenslets(outlook: Outlook, half_px: int) -> float:
    """Return the number of lenslets whose windows, ``half_px`` on either side, reach into the cutout."""
    pitch, px = outlook.camera.pitch_px, outlook.pixel_um
    rows, columns = (n + 2 * half_px + 0.5 * pitch for n in outlook.cutout)
    # spots are 1 - B/a times as far apart as their lenslets
    apart = abs(1 - 1 / outlook.virtual_depth) if abs(outlook.virtual_depth) > 1e-3 else math.inf
    cell = pitch * outlook.camera.lattice.row_step_um / px
    # lenslets at the shadow's edge are partly lit, and lit by its fringes
    radius = outlook.shadow_px + 0.25 * pitch + 0.5 * math.sqrt(outlook.wavelength_um * abs(outlook.shift_um)) / px
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
