"""What a fit says of itself, at points whose error is known: chi², the model's error, what single patterns show."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from benchmarks._fit_cameras import Truth, random_truth, recorded
from lfcal.base.progress import drain
from lfcal.fit._summary import unidentified
from lfcal.fit.fit import outliers_of, problem_of
from lfcal.fit.model import Fineness
from lfcal.fit.model_error import ModelError, chi_square, covariance, held_out_error
from lfcal.fit.normal import Columns, Local
from lfcal.fit.nuisance import nuisance_steps, spread_of
from lfcal.fit.problem import Point, Problem
from lfcal.fit.select import choose
from tests.fit.common import small_plan

PLAN = small_plan(21)
COUNT = 40
NONE = np.zeros(0, np.intp)


@cache
def truth() -> Truth:
    return random_truth(PLAN, np.random.default_rng(4), size=0.0)


@cache
def problem(stage_px: float = 0.0, lamp: float = 0.0, groups: tuple[str, ...] = ("geometry", "crosstalk")) -> Problem:
    """Return the problem about the true camera."""
    rng = np.random.default_rng(6)
    measured = recorded(truth(), COUNT, rng, stage_px=stage_px)
    measured.patterns[:] *= (1 + lamp * rng.standard_normal((COUNT, 1, 1))).astype(np.float32)
    return problem_of(measured, truth().setup, groups, 1)


def point(one: Problem, off: float = 0.0) -> Point:
    """Return the point whose gap is ``off`` scales wrong."""
    u = np.zeros(len(one.vector))
    u[0] = off
    return one.point(u, Local(np.zeros((COUNT, 2))), Fineness.finest)


def true_error(one: Problem, off: float) -> float:
    """Return the relative L2 error at the left-out positions, gains and backgrounds as found."""
    right, wrong, aside = point(one), point(one, off), one.measured.held_out
    wanted, found = (at.model[aside] * at.levels.factors(one.planes)[aside, None] for at in (right, wrong))
    found = found + wrong.levels.backgrounds[one.planes[aside], None]
    return float(np.sqrt(np.square(found - wanted).sum() / np.square(wanted).sum()))


def stated(one: Problem, at: Point) -> ModelError:
    columns = Columns(np.zeros((len(one.vector), *at.model.shape), np.float32))
    return held_out_error(one, at, columns, NONE, np.zeros((4, 4)))


@pytest.mark.long
def test_the_error_of_a_wrong_model_is_what_is_stated() -> None:
    one = problem()
    for off in (0.5, 1.0):
        error, wanted = stated(one, point(one, off)), true_error(one, off)
        assert wanted > 0.02
        assert error.known and error.value == pytest.approx(wanted, abs=3 * error.sigma + 0.05 * wanted)
        assert "±" in str(error) and error.limit > wanted


def test_it_is_less_sure_where_some_patterns_are_predicted_worse_than_others() -> None:
    one = problem()
    at = point(one, 1.0)
    error = stated(one, at)
    aside = one.measured.held_out
    light = (at.model * at.levels.factors(one.planes)[:, None])[aside].astype(float)
    data = one.measured.patterns.reshape(COUNT, -1)[aside] - at.levels.backgrounds[one.planes[aside], None]
    squares = (np.square(data - light) - (64 + np.maximum(light, 0))).sum(1)
    power = np.square(light).sum(1)
    assert error.squared == pytest.approx(squares.sum() / power.sum(), rel=1e-3)
    # the same by leaving out one pattern at a time
    without = (squares.sum() - squares) / (power.sum() - power)
    jackknife = np.sqrt(7 / 8 * np.square(without - without.mean()).sum())
    assert np.hypot(error.squared_sigma, error.among) == pytest.approx(jackknife, rel=0.25)
    assert error.among > error.squared_sigma and error.limit > error.value + error.sigma


def test_what_each_pattern_has_to_itself_counts_where_it_may_be_a_part_of_the_error() -> None:
    one = problem()
    for off, size in ((1.0, 0.01), (0.0, 0.02)):
        plain = point(one, off)
        # an unsteady lamp that no pattern has
        lamps = size * (1.0 - 2.0 * (np.arange(COUNT) % 2))
        at = replace(plain, local=replace(plain.local, lamp=size), levels=replace(plain.levels, lamps=lamps))
        without, with_them = stated(one, plain).squared, stated(one, at).squared
        if off:
            assert without > 4 * size**2 and with_them == pytest.approx(without, rel=5e-3)
        else:
            assert with_them > without + 0.5 * size**2


def test_of_a_true_model_a_limit_is_stated() -> None:
    error = stated(problem(), point(problem()))
    assert not error.known and error.value == 0 and 0.001 < error.limit < 0.03
    assert str(error).startswith("below ") and error.patterns == 8


def test_chi_square_lies_about_one_and_shows_a_wrong_model() -> None:
    one = problem()
    right, wrong = (chi_square(point(one, off), one.fitted, 4) for off in (0.0, 1.0))
    assert right.complete and abs(right.excess) < 4 and right.all_pixels == pytest.approx(1.0, abs=0.03)
    assert not wrong.complete and wrong.excess > 20
    # dark pixels dilute it
    assert wrong.lit - 1 > 1.5 * (wrong.all_pixels - 1)


def test_a_hot_pixel_is_no_fault_of_the_model() -> None:
    one = problem()
    hot = one.measured.patterns.copy()
    hot[:, 5, 7] += 5000
    spoilt = one.with_measured(replace(one.measured, patterns=hot))
    at = point(spoilt)
    assert at.seen.outlying.sum() == COUNT and chi_square(at, spoilt.fitted, 4).complete
    assert stated(spoilt, at).squared == pytest.approx(stated(one, point(one)).squared, abs=3e-4)


def derivatives(one: Problem, at: Point) -> Columns:
    return drain(one.columns(at, range(len(one.vector)), "", displaced=True))


def test_sources_beside_their_places_and_an_unsteady_lamp_are_seen() -> None:
    for stage, lamp in ((0.0, 0.0), (0.06, 0.0), (0.0, 0.01)):
        one = problem(stage, lamp)
        at = point(one)
        found = spread_of(one, at, derivatives(one, at))
        assert found.stage_px == pytest.approx(stage, rel=0.35, abs=1e-9)
        assert found.lamp == pytest.approx(lamp, rel=0.35, abs=1e-9)


def test_displacements_are_found_one_by_one() -> None:
    one = problem(0.06)
    at = point(one)
    columns = derivatives(one, at)
    started = one.weigh(at.u, Local(np.zeros((COUNT, 2)), 0.06), at.model, at.sampling)
    found = nuisance_steps(one, started, columns, np.ones(COUNT, bool))
    rng = np.random.default_rng(6)
    beside = 0.06 * rng.standard_normal((COUNT, 2))
    # the mean of all is the array's offset
    assert np.abs(found.local.offsets_px - beside).max() < 0.02
    assert one.cost(found) < one.cost(started)


def test_groups_are_chosen_by_patterns_left_out() -> None:
    one = problem()
    right, wrong = point(one), point(one, 1.0)
    columns = derivatives(one, right)
    assert choose(one, right, columns, ("crosstalk",), ("geometry",)) == ("crosstalk",)
    assert choose(one, wrong, columns, ("crosstalk",), ("geometry",)) == ("crosstalk", "geometry")


def test_a_pattern_unlike_the_others_is_an_outlier_and_half_of_them_are_not() -> None:
    one = problem()
    at = point(one)
    assert not outliers_of(one, at)[0].any()
    at.seen.residual[5] *= 3
    far, (found,) = outliers_of(one, at)
    assert far.tolist() == [k == 5 for k in range(COUNT)]
    told = re.fullmatch(r"chi² ([\d.]+), but ([\d.]+) for the others", found.reason)
    assert (
        told is not None and float(told[1]) == pytest.approx(9, rel=0.1) and float(told[2]) == pytest.approx(1, rel=0.1)
    )
    at.seen.residual[::2] *= 3
    assert not outliers_of(one, at)[0][::2].all()


def test_what_a_scan_does_not_tell_apart_is_named() -> None:
    one = problem()
    unknowns = one.vector.unknowns
    at = point(one)
    spread, data = covariance(one, at, derivatives(one, at), np.arange(len(unknowns)))
    assert unidentified(unknowns, data) == () and (np.diag(spread) > 0).all()
    # gap and one offset act alike: only their sum is known
    blind = np.diag([50.0, 100.0, 50.0, 100.0, 100.0])
    blind[0, 2] = blind[2, 0] = 50.0
    (found,) = unidentified(unknowns, blind)
    assert set(found.split(" with ")) == {"gap_um", "offset_y_um"}
    assert unidentified(unknowns, np.diag([100.0, 1e-3, 100.0, 100.0, 100.0])) == ("rotation_rad",)
