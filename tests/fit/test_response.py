"""Pixels that respond unevenly: told by what patterns share at a pixel, and taken for no error of the model."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from benchmarks._fit_cameras import Truth, random_truth, recorded
from lfcal.camera import ScanPlan
from lfcal.fit import Fit, Measured, fit_camera
from lfcal.fit.fit import problem_of
from lfcal.fit.model import Fineness
from lfcal.fit.model_error import ModelError, chi_square, held_out_error
from lfcal.fit.normal import Columns, Local
from lfcal.fit.nuisance import response_of
from lfcal.fit.problem import Point, Problem
from lfcal.psf.cutout import Cutout
from tests.fit.common import setup_of, small_plan

COUNT = 40


def with_prnu(plan: ScanPlan, prnu: float) -> ScanPlan:
    return replace(plan, camera=replace(plan.camera, sensor=replace(plan.camera.sensor, prnu=prnu)))


def uneven(measured: Measured, prnu: float) -> Measured:
    """Return the patterns as a sensor whose pixels have gains of their own records them."""
    gains = 1 + prnu * np.random.default_rng(8).standard_normal(measured.plan.camera.sensor.shape)
    patterns, cutout = measured.patterns.copy(), Cutout.for_plan(measured.plan)
    places = {(at.z, at.y, at.x): at for at in measured.plan.positions()}
    for one, at in zip(patterns, measured.index.tolist(), strict=True):
        window = cutout.window(places[tuple(at)])
        nt, ns = one.shape
        one *= gains[window.row : window.row + nt, window.column : window.column + ns]
    return replace(measured, patterns=patterns)


@cache
def truth(described: float = 0.01) -> Truth:
    return random_truth(with_prnu(small_plan(21), described), np.random.default_rng(4), size=0.0)


@cache
def problem(prnu: float, described: float = 0.01, count: int = COUNT) -> Problem:
    """Return the problem about the true camera, whose gap may be wrong."""
    one = truth(described)
    return problem_of(uneven(recorded(one, count, np.random.default_rng(6)), prnu), one.setup, ("geometry",), 1)


def point(one: Problem, off: float = 0.0) -> Point:
    u = np.zeros(len(one.vector))
    u[0] = off
    return one.point(u, Local(np.zeros((len(one.measured), 2))), Fineness.finest)


def weighed_again(one: Problem, at: Point) -> Point:
    local = replace(at.local, response=response_of(one, at))
    return one.weigh(at.u, local, at.model, at.sampling)


def stated(one: Problem, at: Point) -> ModelError:
    columns = Columns(np.zeros((len(one.vector), *at.model.shape), np.float32))
    return held_out_error(one, at, columns, np.zeros(0, np.intp), np.zeros((4, 4)))


@pytest.mark.parametrize("prnu", [0.01, 0.02])
def test_it_is_told_by_what_patterns_share_at_a_pixel(prnu: float) -> None:
    one = problem(prnu, described=0.05)
    found = response_of(one, point(one))
    assert found.rms == pytest.approx(prnu, rel=0.15)
    assert found.sigma < 0.2 * prnu**2


def test_it_is_no_error_of_the_model() -> None:
    one = problem(0.02, described=0.02)
    plain = point(one)
    at = weighed_again(one, plain)
    # without it the true model would be 2 % off, surely
    assert stated(one, plain).known and stated(one, plain).value == pytest.approx(0.02, rel=0.25)
    assert not chi_square(plain, one.fitted, 4).complete
    assert not stated(one, at).known and chi_square(at, one.fitted, 4).complete


def test_even_pixels_have_none() -> None:
    one = problem(0.0)
    found = response_of(one, point(one))
    assert found.squared == 0 and 0 < found.sigma < 2e-5


def test_errors_of_a_model_are_hardly_taken_for_it() -> None:
    one = problem(0.0)
    for off in (0.5, 1.0):
        wrong = point(one, off)
        error, plain = stated(one, weighed_again(one, wrong)), stated(one, wrong)
        assert error.known and 0.8 * plain.value < error.value <= plain.value


def test_no_more_is_taken_than_the_camera_is_described_with() -> None:
    one = problem(0.02)
    at = weighed_again(one, point(one))
    assert at.local.response.squared == 0.01**2
    assert stated(one, at).value == pytest.approx(np.sqrt(0.02**2 - 0.01**2), rel=0.25)
    even = problem(0.02, described=0.0)
    found = response_of(even, point(even))
    assert (found.squared, found.sigma) == (0.0, 0.0)


def test_patterns_that_share_no_pixel_leave_it_open() -> None:
    whole = problem(0.0, described=0.02)
    far = np.argsort(whole.measured.index[:, 1:].sum(1))[[0, -1, 1]]
    valid = whole.measured.valid.copy()
    # each shows pixels that none of the others has
    for k, p in enumerate(far.tolist()):
        row = whole.measured.index[p, 1]
        keep = np.arange(row, row + valid.shape[1]) % 3 == k
        valid[p] &= keep[:, None]
    some = np.isin(np.arange(COUNT), far)
    one = whole.with_measured(replace(whole.measured, valid=valid).of(some))
    found = response_of(one, point(one))
    assert (found.squared, found.sigma) == (0.0, 0.02**2)


def test_a_value_is_as_rare_without_an_error_as_three_sigma_of_a_gaussian() -> None:
    rng = np.random.default_rng(0)
    # few pixels are bright: squares of their noise scatter farther up than down
    noise = np.concatenate([np.full(30, 1.0), np.full(1000, 0.03)])
    scatter = np.sqrt(2 * (noise**2).sum())
    skew = 8 * (noise**3).sum() / scatter**3
    drawn = np.array([(noise * (rng.standard_normal(noise.size) ** 2 - 1)).sum() for _ in range(20_000)])
    plain, corrected = (np.mean([ModelError(v, scatter, 0.0, 8, 0.0, s).known for v in drawn]) for s in (0.0, skew))
    assert plain > 0.004 and corrected < 0.0025


@cache
def fitted() -> Fit:
    plan = truth().plan
    as_described = Truth(plan, setup_of(plan), {})
    measured = uneven(recorded(as_described, COUNT, np.random.default_rng(6)), 0.01)
    return fit_camera(measured, unknowns=["geometry"], stage=0.0, workers=1)


@pytest.mark.long
def test_a_fit_finds_it_and_says_a_limit() -> None:
    fit = fitted()
    assert fit.spread.response == pytest.approx(0.01, rel=0.15)
    assert fit.complete and not fit.held_out_error.known
