"""Several frames of a target shown together: the best number, the effect on noise, and the display's plan."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.multiplex import CodingVerdict, coding_pays, display_fit, s_matrix, sensor_noise
from lfcal.simulate import PlaneResponse, plan_effects
from lfcal.targets.display import Display, coded_plan
from lfcal.targets.plan import TargetPlan

__all__ = ["ORDERS", "coding_verdict", "display_words", "group_order", "planned_for_display", "subset_patterns"]

ORDERS = (3, 7, 11)
"""Numbers of offsets that may be coded together, about half of them in each frame: orders of S-matrices."""

PEAK = 0.8
"""Default level of a point's brightest pixel, as a fraction of the full well."""

TOLERANCE = 0.1
"""Relative error of the simulated patterns, which is sufficient for a gain in noise."""


def group_order(frames: int) -> int:
    """Return the order n of the S-matrix with which coded sums of a plane's frames have the lowest noise.

    It is one of `ORDERS`, or 0 if ``frames``, the plane's number of frames, is too small. An S-matrix reduces additive
    noise by the factor (n + 1) / (2 sqrt n). Repeats that complete the last group of n frames are taken into account.
    """
    fitting = [n for n in ORDERS if n <= frames]
    return max(fitting, key=lambda n: (n + 1) / (2 * math.sqrt(n)) * math.sqrt(frames / _filled(frames, n)), default=0)


def _filled(frames: int, order: int) -> int:
    return math.ceil(frames / order) * order


def subset_patterns(plan: TargetPlan, z: int, frames: int) -> NDArray[np.float64]:
    """Return the patterns of one hole in the first ``frames`` frames of a plane, ``(frames, rows, columns)``.

    Neighbouring holes have the same pattern, so the window wraps around. Its sides are the distances of their images,
    or those of the cutout if these are larger. Values are NaN outside each pattern's cutout.
    """
    scan = plan.scan
    effects = plan_effects(scan, TOLERANCE).effects
    response = PlaneResponse(scan, z, effects, tolerance=TOLERANCE, on_sensor=True)
    step = scan.camera.step_um(scan.depths_um[z])
    apart = [pitch / step for pitch in plan.target.pitch_um]
    window = [max(round(a), side) for a, side in zip(apart, scan.cutout, strict=True)]
    out = np.full((frames, *window), np.nan)
    for pattern, offset in zip(out, np.array(plan.offsets_px[z]).reshape(-1, 2), strict=False):
        row, column = np.rint(offset).astype(int).tolist()
        light = response.rows([row % scan.period[0]], [column % scan.period[1]])[0, 0]
        rows = (row + np.arange(light.shape[0])) % window[0]
        columns = (column + np.arange(light.shape[1])) % window[1]
        pattern[np.ix_(rows, columns)] = light
    return out


def coding_verdict(plan: TargetPlan, z: int | None = None, signal_e: float | None = None) -> CodingVerdict | None:
    """Return a verdict on whether showing coded sums of frames reduces noise; None for one hole or too few frames.

    Parameters
    ----------
    plan
        Plan of the target; an S-matrix would select the frames to show together.
    z
        Index of the plane. None: the middle one.
    signal_e
        Electrons in a point's brightest pixel in a frame. None: the fraction `PEAK` of the full well.

    Raises
    ------
    InputError
        If ``signal_e`` is not above 0, or exceeds the full well.
    """
    at = len(plan.scan.depths_um) // 2 if z is None else z
    order = group_order(len(plan.offsets_px[at]))
    if not order or len(plan.target.holes) < 2:
        return None
    noise = sensor_noise(plan.scan.camera.sensor, exposure_s=plan.scan.exposures[at])
    if signal_e is not None and not 0 < signal_e <= noise.full_e:
        wanted = f"a number above 0, at most the full well of {noise.full_e:.4g}"
        raise InputError.expected(
            "--signal (electrons)", wanted, f"{signal_e:g}", "give the signal at the planned exposure"
        )
    light = subset_patterns(plan, at, order)
    return coding_pays(light, noise, signal_e=PEAK * noise.full_e if signal_e is None else signal_e)


def planned_for_display(plan: TargetPlan, display: Display, verdict: CodingVerdict | None) -> TargetPlan:
    """Return ``plan`` with several offsets in each frame if that reduces noise, otherwise ``plan`` itself.

    ``verdict`` is the result of `coding_verdict` for the plan. None: frames show single offsets. They also show single
    offsets if several would saturate the sensor, because the exposures do not change.
    """
    if verdict is None or not verdict.pays or verdict.gain.time.exposure < 1:
        return plan
    return coded_plan(plan, s_matrix(verdict.gain.points), display.pixel_um)


def display_words(plan: TargetPlan, display: Display) -> str:
    """Return a line that states whether the display's pixels are small enough, and how its frames show the points.

    The size of the pixels is compared with the step of the middle plane.
    """
    depth = plan.scan.depths_um[len(plan.scan.depths_um) // 2]
    fit = display_fit(plan.scan.camera.step_um(depth), display.pixel_um)
    if plan.lit is None:
        return f"display: {fit.words}; frames show one subset of points after the other"
    most = max(len(one) for plane in plan.lit for one in plane)
    return f"display: {fit.words}; frames show {most} subsets of points together, coded by an S-matrix"
