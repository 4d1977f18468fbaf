"""Simulation: the error of a tolerance is that of the H it gives, compared with the reference."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.accuracy import PARTS, Subject, iter_measure_curve, measure_curve
from lfcal.accuracy.parts import simulation
from lfcal.accuracy.parts.sampling import QUICK
from lfcal.simulate import ladder, plan_effects, simulate_psf
from lfcal.simulate.accuracy.sampling import steps_for
from lfcal.simulate.staging import scene_for
from tests.acquire.rigs import small_plan


@pytest.fixture
def single() -> Subject:
    """Return a plan of one position, so that the positions compared are all of H."""
    return Subject("one", small_plan((1, 1), 1), workers=1)


@pytest.mark.long
def test_a_point_errs_as_the_h_that_its_tolerance_gives(single: Subject, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulation, "TOLERANCES", (0.3, 0.06))
    curve = measure_curve(PARTS.get("simulation"), single, 100)
    plan = single.planned
    assert [r.settings["tolerance"] for r in sorted(curve.points, key=lambda r: -r.error)] == [0.3, 0.06]
    finest = plan_effects(plan, simulation.FINEST)
    true = simulate_psf(plan, finest, "reference", tolerance=simulation.FINEST)[0].astype(float)
    for point in curve.points:
        tolerance = point.settings["tolerance"]
        assert 0 < point.error < tolerance and point.cost > 0
        H = simulate_psf(plan, tolerance=tolerance)[0]
        assert point.error == pytest.approx(np.abs(H - true).sum() / true.sum(), rel=0.02)
        assert point.settings["effects"] == [e.name for e in plan_effects(plan, tolerance).effects]


def test_closed_after_the_first_point_it_is_kept(single: Subject) -> None:
    work = iter_measure_curve(PARTS.get("simulation"), single, 10)
    record = next(r for r in work if r.curve.points)  # type: ignore[attr-defined]
    work.close()
    assert len(record.curve.points) == 1 and "reference" in record.curve.truth  # type: ignore[attr-defined]


@pytest.mark.long
def test_samplings_are_those_of_the_ladder(single: Subject) -> None:
    plan = single.planned
    work = iter_measure_curve(PARTS.get("sampling"), single, 50.0)
    curve = next(record.curve for record in work if len(record.curve.points) == 3)  # type: ignore[attr-defined]
    work.close()
    effects = plan_effects(plan, 0.03).effects
    two = [s.sampling for s in steps_for(scene_for(plan, 0, effects), "wave")][:2]
    found = ladder(plan, effects=effects, positions=1, samplings=two, reference=QUICK)
    errors = {r.label: r.error for r in found.rungs}
    assert {r.label: r.error for r in curve.points} == {r.label: errors[r.label] for r in curve.points}
    assert set(errors) == {r.label for r in curve.points} and curve.truth == found.reference
