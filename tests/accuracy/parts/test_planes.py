"""Depth planes: the error of the nearest plane, by whole simulations; frames counted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfcal.accuracy import PARTS, Subject, measure_curve
from lfcal.accuracy.parts import planes
from lfcal.camera import ScanPlan
from lfcal.simulate import plan_effects, simulate_psf


def pattern(plan: ScanPlan, depth: float) -> np.ndarray:
    one = replace(plan, depths_um=(depth,), exposure_s=0.02)
    effects = plan_effects(plan, planes.TOLERANCE)
    return simulate_psf(one, effects, tolerance=planes.TOLERANCE)[0, 1, 1].astype(float)


@pytest.mark.long
def test_the_nearest_plane_stands_in(subject: Subject, plan: ScanPlan, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planes, "COUNTS", (2, 5))
    monkeypatch.setattr(planes, "DEPTHS", 1)
    curve = measure_curve(PARTS.get("planes"), subject, 100)
    low, high = min(plan.depths_um), max(plan.depths_um)
    depths = [low + (high - low) * ((k + 1) * 0.6180339887498949 % 1) for k in range(1)]
    assert [point.in_use for point in curve.points] == [False, True, False], "the plan has three planes"
    for point, count in zip(curve.points, (2, 3, 5), strict=True):
        steps = np.array(plan.depths_um) if count == 3 else np.linspace(low, high, count)
        near = [float(steps[np.abs(steps - depth).argmin()]) for depth in depths]
        true = [pattern(plan, depth) for depth in depths]
        off = sum(np.abs(pattern(plan, at) - one).sum() for at, one in zip(near, true, strict=True))
        # each pattern is computed to 5 % only, here and there in another way
        assert point.error == pytest.approx(off / sum(one.sum() for one in true), abs=0.06)
        assert point.cost == count * 9 and len(point.settings["depths_um"]) == count
    assert curve.points[1].error < curve.points[0].error


def test_one_plane_bounds_no_range(plan: ScanPlan) -> None:
    one = replace(plan, depths_um=plan.depths_um[:1], exposure_s=0.02)
    curve = measure_curve(PARTS.get("planes"), Subject("one", one))
    assert (
        not curve.points
        and curve.stopped
        == "depth planes: expected at least two planes, as the ends of the depth range, got one; add a plane"
    )
