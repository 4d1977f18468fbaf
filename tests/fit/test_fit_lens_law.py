"""Cameras whose main lens obeys the tangent law: the f-number's standard deviation holds what nobody knows of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks._fit_cameras import random_truth
from lfcal.fit import GROUPS, Setup, fit_camera
from lfcal.simulate.effects import ExactAngles, LensLaw
from tests.fit.common import CORE, small_plan, vector_of
from tests.fit.test_seidel import recorded, selected


@pytest.mark.parametrize("named", [False, pytest.param(True, marks=pytest.mark.long)], ids=["auto", "named groups"])
def test_a_fitted_f_number_holds_by_either_lens_law(named: bool) -> None:
    """A thin lens looks as a lens by the sine condition with an iris smaller by 1/(8 Nw²): many sigmas of its noise."""
    plan = small_plan(21)
    start = random_truth(plan, np.random.default_rng(1), size=0.0)
    truth = replace(start, setup=start.setup.with_effect(LensLaw(1.0)))
    patterns = recorded(truth, 10, np.random.default_rng(2))
    if named:
        fit = fit_camera(patterns, unknowns=CORE, workers=1)
    else:
        fit = selected(patterns, Setup(plan.camera, start.setup.effects, (0.0, 0.0)), ("lens_law",))
    found = fit.parameters["f_number"]
    off = found.value - truth.values["f_number"]
    assert off > 5 * found.sigma_held, "by noise alone it would be certain, and wrong"
    assert abs(off) < 3 * found.sigma < 0.04 * found.value
    assert "the main lens obeys the sine condition" in fit.held
    # by the law that the lens obeys it is found as it is
    known = selected(patterns, Setup(plan.camera, truth.setup.effects, (0.0, 0.0)), ("lens_law",))
    size = known.parameters["f_number"]
    assert abs(size.value - truth.values["f_number"]) < 4 * size.sigma_held
    assert "the main lens obeys the tangent law" in known.held


def test_the_lens_law_is_that_of_exact_angles() -> None:
    """By small angles sine and tangent are one, and no step of the law may switch exact angles on."""
    plan = small_plan(15)
    (law,) = vector_of(plan, ["lens_law"]).unknowns
    assert (law.start, law.low, law.high) == (0.0, -0.5, 1.5)
    vector = vector_of(plan, ["lens_law"])
    setup = vector.setup_at(np.array([2.0]))
    assert setup.effect(LensLaw) == LensLaw(1.0) and vector.setup_at(np.zeros(1)).effect(LensLaw) is None
    paraxial = replace(vector.setup, effects=tuple(e for e in vector.setup.effects if not isinstance(e, ExactAngles)))
    assert GROUPS.get("lens_law").unknowns(paraxial, vector.frame) == ()
