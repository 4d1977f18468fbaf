"""Interpolation: whole pixels change nothing; half a pixel is what a frame that is known loses."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.accuracy import PARTS, Subject, measure_curve
from lfcal.accuracy.parts import interpolation
from lfcal.camera import ScanPlan, preset


@pytest.mark.long
def test_moved_by_whole_pixels_nothing_is_lost(subject: Subject, monkeypatch: pytest.MonkeyPatch) -> None:
    """Lattice, source and cutout move the same way, or the pattern would be another."""
    monkeypatch.setattr(interpolation, "SHIFTS", ((2.0, -1.0),))
    curve = measure_curve(PARTS.get("interpolation"), subject, 100)
    assert {r.label for r in curve.points} == {"nearest", "linear", "cubic", "fourier"}
    assert all(r.error < 1e-3 for r in curve.points), curve.points


@pytest.mark.long
def test_smooth_spots_are_moved_the_right_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """A counter-test: against the shift, interpolation would be worse than none (twice as far off)."""
    monkeypatch.setattr(interpolation, "SHIFTS", ((0.4, 0.4),))
    plan = ScanPlan.for_camera(preset("lfm_20x05"), depths_um=(-10.0,), cutout=61)
    errors = {r.label: r.error for r in measure_curve(PARTS.get("interpolation"), Subject("lfm", plan), 100).points}
    assert 0 < errors["cubic"] < errors["linear"] < 0.85 * errors["nearest"]


def test_seconds_are_those_of_all_positions(subject: Subject, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(interpolation, "SHIFTS", ((0.5, 0.5),))
    curve = measure_curve(PARTS.get("interpolation"), subject, 100)
    for point in curve.points:
        assert point.cost == pytest.approx(27 * point.others["pattern (ms)"] / 1e3)
    assert np.isfinite([r.cost for r in curve.points]).all()
