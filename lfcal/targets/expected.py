"""Predict the error of a target's patterns due to noise, for any number of frames."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import ScanPlan
from lfcal.simulate import SimulatedCamera, plan_effects
from lfcal.targets.images import whole_at
from lfcal.targets.phases import Phases, nearest_positions
from lfcal.targets.plan import TargetPlan

__all__ = ["ErrorForecast", "error_forecast", "noise_share"]

TOLERANCE = 0.1
"""Relative error of the simulated pattern, which is sufficient for its noise."""

LOOKED_AT = 5
"""Number of positions whose patterns are simulated, because the light hardly depends on the phase."""


@dataclass(frozen=True, slots=True, eq=False)
class ErrorForecast:
    """Expected relative error (L1) of the recorded patterns of one plane due to noise.

    Attributes
    ----------
    single
        Expected error of a pattern recorded in the scan of a single point.
    shown
        Fraction of the positions of the plane that have been shown after each frame, ``(frames,)``.
    error
        RMS, after each frame, of the expected errors of the positions shown until then, ``(frames,)``. Repeats of a
        position are averaged. NaN while no position has been shown.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.targets import ErrorForecast, Wishes, error_forecast, parse_target, plan_target
    >>> scan = ScanPlan.for_camera(preset("bench"), virtual_depths=(4.0,), cutout=31)
    >>> plan = plan_target(scan, parse_target("array:3x3@2mm"), Wishes(most_frames=5, level="geometric"))
    >>> expected: ErrorForecast = error_forecast(plan, 0, single=0.1)
    >>> print(f"after {len(expected.shown)} frames {expected.shown[-1]:.1%} shown, error {expected.error[-1]:.1%}")
    after 5 frames 4.8% shown, error 10.0%
    """

    single: float
    shown: NDArray[np.float64]
    error: NDArray[np.float64]


def noise_share(scan: ScanPlan, z: int, *, level: str = "auto") -> float:
    """Return the expected ``sum |noise| / sum light`` of a pattern of plane ``z``, averaged over a few positions.

    The pattern is the mean of ``scan.frames_averaged`` frames. Photon noise and read noise of the pixels of a cutout
    are included as Gaussian noise. For such noise, the mean of ``|x|`` is ``sqrt(2 / pi)`` times the standard
    deviation. The brightest pixel of the session reaches 0.8 of the full well. ``level`` is as in `simulate_psf`.
    """
    effects = plan_effects(scan, TOLERANCE).effects
    camera = SimulatedCamera(scan, effects, level=level, tolerance=TOLERANCE)
    ny, nx = scan.period
    order = scan.order_indices()
    numbers = {tuple(position): k for k, position in enumerate(order.tolist())}
    half = (np.array(scan.cutout) - 1) // 2
    shares = []
    for k in range(LOOKED_AT):
        place = (z, k * ny // LOOKED_AT, (2 * k) % LOOKED_AT * nx // LOOKED_AT)
        row, column = np.floor(scan.image_px(place) + 0.5).astype(int).tolist()
        light = camera.light(numbers[place])[
            row - half[0] : row + half[0] + 1, column - half[1] : column + half[1] + 1
        ].astype(np.float64)
        spread = np.sqrt(np.maximum(light, 0) + scan.camera.sensor.read_noise_e**2)
        shares.append(math.sqrt(2 / math.pi) * float(spread.sum()) / float(light.sum()))
    return float(np.mean(shares)) / math.sqrt(scan.frames_averaged)


def error_forecast(plan: TargetPlan, z: int, single: float | None = None) -> ErrorForecast:
    """Return the expected error for plane ``z`` after each frame.

    ``single`` is the relative error (L1) of one pattern in the scan of a single point. None: the result of
    `noise_share`.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.targets import Target, TargetPlan, error_forecast
    >>> scan = ScanPlan.for_camera(preset("bench"), virtual_depths=(4.0,), cutout=31)
    >>> plan = TargetPlan(scan, Target(), (((0.0, 0.0),) * 4,), 0.5, (0.0,), "geometric")
    >>> print(error_forecast(plan, 0, single=0.1).error.round(3).tolist())  # the same position four times
    [0.1, 0.071, 0.058, 0.05]
    """
    share = noise_share(plan.scan, z) if single is None else single
    phases, images = Phases.of(plan.scan), plan.images(z)
    counts = np.zeros(phases.count, np.intp)
    shown, error = [], []
    for offset in np.array(plan.offsets_px[z]).reshape(-1, 2):
        # every hole on a phase is a separate measurement
        pixels = images.moved(offset)
        pixels = pixels[whole_at(pixels, plan.scan.camera.sensor.shape, plan.scan.cutout)]
        found = nearest_positions(phases, pixels)
        met = (np.abs(found.residual_px) <= plan.tolerance_px + 1e-9).all(axis=1)
        np.add.at(counts, np.ravel_multi_index(tuple(found.positions[met].T), plan.scan.period), 1)
        there = counts > 0
        shown.append(float(there.mean()))
        error.append(share * math.sqrt(float((1.0 / counts[there]).mean())) if there.any() else math.nan)
    return ErrorForecast(share, np.array(shown), np.array(error))
