"""Frames of a target that may be shown at once: how many of them, and how their patterns lie over each other."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lfcal.simulate import PlaneResponse, plan_effects
from lfcal.targets.plan import TargetPlan

__all__ = ["ORDERS", "group_order", "subset_patterns"]

ORDERS = (3, 7, 11)
"""Frames that are shown together, sums of about half of them at a time: orders of S-matrices."""

TOLERANCE = 0.1
"""Of the simulated patterns: a gain in noise needs no better."""


def group_order(frames: int) -> int:
    """Return how many of a plane's frames are best shown together; 0 where there are too few.

    An S-matrix of order n gains (n + 1) / (2 sqrt n) of additive noise; the last group is filled up by repeats.
    """
    fitting = [n for n in ORDERS if n <= frames]
    return max(fitting, key=lambda n: (n + 1) / (2 * math.sqrt(n)) * math.sqrt(frames / _filled(frames, n)), default=0)


def _filled(frames: int, order: int) -> int:
    return math.ceil(frames / order) * order


def subset_patterns(plan: TargetPlan, z: int, frames: int) -> NDArray[np.float64]:
    """Return the patterns of one hole in the first frames of a plane ``(frames, rows, columns)``, where they lie.

    Neighbouring holes have the same beside them: the window is as large as the distance of their images, and goes
    round. NaN beyond each pattern's own cutout.
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
