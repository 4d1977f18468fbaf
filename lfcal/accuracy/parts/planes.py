"""Depth planes: error at depths between planes versus number of frames in the scan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lfcal.accuracy.curves import CostPoint
from lfcal.accuracy.part import AccuracyPart, AccuracyStep, Measuring, Truth
from lfcal.accuracy.subject import Subject
from lfcal.base import InputError
from lfcal.camera import Forecast, ScanPlan
from lfcal.simulate import PlaneResponse, plan_effects, resolve_level, scene_for
from lfcal.simulate.accuracy import step_for
from lfcal.simulate.effects import Effect

__all__ = ["PART"]

COUNTS = (2, 3, 5, 9, 17, 33, 65)
"""Numbers of planes over the plan's range of depths; each set includes the planes of the previous one. The
planes of the plan itself are measured too."""

DEPTHS = 5
"""Number of tested depths, spread over the range; each is represented by the nearest plane."""

TOLERANCE = 0.05


def measure(subject: Subject, seconds: float) -> Measuring:
    """Yield the error of using the nearest plane's pattern for depths between planes, for several numbers of planes.

    Raises `InputError` if all planes of the plan have the same depth.
    """
    plan = subject.planned
    low, high = min(plan.depths_um), max(plan.depths_um)
    if low == high:
        raise InputError.expected(
            "depth planes", "at least two planes, as the ends of the depth range", "one", "add a plane"
        )
    effects = plan_effects(plan, TOLERANCE).effects
    # irrational fractions of the range, so that no depth coincides with a plane
    between = [float(low + (high - low) * ((k + 1) * 0.6180339887498949 % 1)) for k in range(DEPTHS)]
    true = []
    for depth in between:
        yield AccuracyStep(f"z = {depth:.4g} µm")
        true.append(_pattern(plan, depth, effects))
    yield Truth(
        "the simulation at the exact depth", (f"middle position, {DEPTHS} depths between {low:g} and {high:g} µm",)
    )
    known: dict[float, NDArray[np.float64]] = {}
    for count in sorted({*COUNTS, len(plan.depths_um)}):
        yield AccuracyStep(f"{count} planes")
        depths = np.array(plan.depths_um) if count == len(plan.depths_um) else np.linspace(low, high, count)
        error = total = 0.0
        for depth, pattern in zip(between, true, strict=True):
            nearest = float(depths[int(np.argmin(np.abs(depths - depth)))])
            if nearest not in known:
                known[nearest] = _pattern(plan, nearest, effects)
            error += float(np.abs(known[nearest] - pattern).sum())
            total += float(np.abs(pattern).sum())
            yield AccuracyStep(f"{count} planes, z = {depth:.4g} µm", 0.0)
        yield _point(plan, tuple(depths.tolist()), error / total)


def _pattern(plan: ScanPlan, depth: float, effects: tuple[Effect, ...]) -> NDArray[np.float64]:
    """Return the pattern of the middle position at a depth, ``(nt, ns)``."""
    ny, nx = plan.period
    anchor = (plan.anchor[0] + ny // 2, plan.anchor[1] + nx // 2)
    one = replace(plan, depths_um=(depth,), exposure_s=plan.exposures[0], period=(1, 1), anchor=anchor, resample=False)
    scene, level = resolve_level(scene_for(one, 0, effects))
    # the sampling expected to be sufficient, without a test, and equal for all depths
    step = step_for(scene, level, TOLERANCE)
    response = PlaneResponse(one, 0, effects, level=step.level, sampling=step.sampling)
    pattern: NDArray[np.float64] = response.rows([0], [0], 1)[0, 0].astype(np.float64)
    return pattern


def _point(plan: ScanPlan, depths: tuple[float, ...], error: float) -> CostPoint:
    scan = replace(plan, depths_um=depths, exposure_s=plan.exposures[0])
    found = Forecast.of(scan)
    others = {"recording (s)": 3600 * found.hours, "H, float32 (bytes)": float(found.h_float32_bytes)}
    settings, own = {"depths_um": list(depths)}, depths == plan.depths_um
    return CostPoint(f"{len(depths)} planes", settings, error, float(found.frames), "frames", others, in_use=own)


PART = AccuracyPart(
    "planes",
    "Depth planes",
    "relative L1 error of the pattern of the nearest plane, at depths between the planes",
    "frames of the scan",
    "frames",
    measure,
    rank=30,
)
