"""Errors that a fit states: chi², the error of the model, uneven pixels, outliers, and degeneracies."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from benchmarks._fit_cameras import Truth, random_truth, recorded
from lfcal.base.progress import drain
from lfcal.camera import ScanPlan
from lfcal.fit import Fit, Measured, Setup, Unknown, fit_camera
from lfcal.fit._summary import Degeneracies, degeneracies, iter_degeneracies, summarised, unidentified
from lfcal.fit.fit import addable, groups_of, outliers_of, problem_of
from lfcal.fit.model import Fineness, predict
from lfcal.fit.model_error import ModelError, chi_square, covariance, held_out_error
from lfcal.fit.normal import Columns, Local
from lfcal.fit.nuisance import nuisance_steps, response_of, spread_of
from lfcal.fit.problem import Point, Problem
from lfcal.fit.select import choose
from lfcal.fit.setup import starting_effects
from lfcal.psf.cutout import Cutout
from lfcal.simulate.effects import IndexMismatch
from tests.fit.common import measured, setup_of, small_camera, small_plan, some_index, vector_of

PLAN = small_plan(21)
COUNT = 40
NONE = np.zeros(0, np.intp)


@cache
def truth(described: float | None = None) -> Truth:
    """Return a random camera, whose pixels are ``described`` to respond unevenly by a share."""
    plan = PLAN if described is None else with_prnu(PLAN, described)
    return random_truth(plan, np.random.default_rng(4), size=0.0)


def with_prnu(plan: ScanPlan, prnu: float) -> ScanPlan:
    return replace(plan, camera=replace(plan.camera, sensor=replace(plan.camera.sensor, prnu=prnu)))


@cache
def problem(stage_px: float = 0.0, lamp: float = 0.0) -> Problem:
    """Return the problem about the true camera."""
    rng = np.random.default_rng(6)
    measured = recorded(truth(), COUNT, rng, stage_px=stage_px)
    measured.patterns[:] *= (1 + lamp * rng.standard_normal((COUNT, 1, 1))).astype(np.float32)
    return problem_of(measured, truth().setup, ("geometry", "crosstalk"), 1)


def point(one: Problem, off: float = 0.0) -> Point:
    """Return the point whose gap is ``off`` scales wrong."""
    u = np.zeros(len(one.vector))
    u[0] = off
    return one.point(u, Local(np.zeros((len(one.measured), 2))), Fineness.finest)


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
def test_the_stated_error_of_a_wrong_model_is_the_true_error() -> None:
    one = problem()
    for off in (0.5, 1.0):
        error, wanted = stated(one, point(one, off)), true_error(one, off)
        assert wanted > 0.02
        assert error.known and error.value == pytest.approx(wanted, abs=3 * error.sigma + 0.05 * wanted)
        assert "±" in str(error) and error.limit > wanted


def test_the_error_is_less_sure_if_patterns_differ_in_their_errors() -> None:
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


def test_lamp_values_count_only_if_they_may_contain_errors_of_the_model() -> None:
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


def test_a_true_model_has_an_error_limit_and_a_chi_square_of_one() -> None:
    one = problem()
    error = stated(one, point(one))
    assert not error.known and error.value == 0 and 0.001 < error.limit < 0.03
    assert str(error).startswith("below ") and error.patterns == 8
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


def test_displaced_sources_and_an_unsteady_lamp_are_found() -> None:
    for stage, lamp in ((0.0, 0.0), (0.06, 0.0), (0.0, 0.01)):
        one = problem(stage, lamp)
        at = point(one)
        found = spread_of(one, at, derivatives(one, at))
        assert found.stage_px == pytest.approx(stage, rel=0.35, abs=1e-9)
        assert found.lamp == pytest.approx(lamp, rel=0.35, abs=1e-9)


def test_the_displacement_of_each_source_is_found() -> None:
    one = problem(0.06)
    at = point(one)
    columns = derivatives(one, at)
    started = one.weigh(at.u, Local(np.zeros((COUNT, 2)), 0.06), at.model, at.sampling)
    found = nuisance_steps(one, started, columns, np.ones(COUNT, bool))
    rng = np.random.default_rng(6)
    offsets = 0.06 * rng.standard_normal((COUNT, 2))
    # the mean of all is the array's offset
    assert np.abs(found.local.offsets_px - offsets).max() < 0.02
    assert one.cost(found) < one.cost(started)


def test_groups_are_chosen_by_held_out_patterns() -> None:
    one = problem()
    right, wrong = point(one), point(one, 1.0)
    columns = derivatives(one, right)
    assert choose(one, right, columns, ("crosstalk",), ("geometry",)) == ("crosstalk",)
    assert choose(one, wrong, columns, ("crosstalk",), ("geometry",)) == ("crosstalk", "geometry")


def test_one_deviating_pattern_is_an_outlier_but_half_of_all_are_not() -> None:
    one = problem()
    at = point(one)
    assert not outliers_of(one, at)[0].any()
    at.seen.residual[5] *= 3
    far, (found,) = outliers_of(one, at)
    assert far.tolist() == [k == 5 for k in range(COUNT)]
    reason = re.fullmatch(r"chi² ([\d.]+), but ([\d.]+) for the others", found.reason)
    assert reason is not None and [float(one) for one in reason.groups()] == pytest.approx([9, 1], rel=0.1)
    at.seen.residual[::2] *= 3
    assert not outliers_of(one, at)[0][::2].all()


def test_unknowns_that_a_scan_cannot_distinguish_are_named() -> None:
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


def uneven(measured: Measured, prnu: float) -> Measured:
    """Return the patterns as recorded by a sensor whose pixels have different gains."""
    gains = 1 + prnu * np.random.default_rng(8).standard_normal(measured.plan.camera.sensor.shape)
    patterns, cutout = measured.patterns.copy(), Cutout.for_plan(measured.plan)
    places = {(at.z, at.y, at.x): at for at in measured.plan.positions()}
    for one, at in zip(patterns, measured.index.tolist(), strict=True):
        window = cutout.window(places[tuple(at)])
        nt, ns = one.shape
        one *= gains[window.row : window.row + nt, window.column : window.column + ns]
    return replace(measured, patterns=patterns)


@cache
def uneven_problem(prnu: float, described: float = 0.01) -> Problem:
    """Return the problem of pixels that respond unevenly about the true camera, whose gap may be wrong."""
    one = truth(described)
    return problem_of(uneven(recorded(one, COUNT, np.random.default_rng(6)), prnu), one.setup, ("geometry",), 1)


def weighed_again(one: Problem, at: Point) -> Point:
    local = replace(at.local, response=response_of(one, at))
    return one.weigh(at.u, local, at.model, at.sampling)


def test_the_response_of_pixels_is_found_from_what_patterns_share() -> None:
    for prnu in (0.01, 0.02):
        one = uneven_problem(prnu, described=0.05)
        found = response_of(one, point(one))
        assert found.rms == pytest.approx(prnu, rel=0.15) and found.sigma < 0.2 * prnu**2
    even = uneven_problem(0.0)
    found = response_of(even, point(even))
    assert found.squared == 0 and 0 < found.sigma < 2e-5


def test_uneven_pixels_are_no_error_of_the_model() -> None:
    one = uneven_problem(0.02, described=0.02)
    plain = point(one)
    at = weighed_again(one, plain)
    # without it the true model would be 2 % off, surely
    assert stated(one, plain).known and stated(one, plain).value == pytest.approx(0.02, rel=0.25)
    assert not chi_square(plain, one.fitted, 4).complete
    assert not stated(one, at).known and chi_square(at, one.fitted, 4).complete


def test_errors_of_a_model_are_hardly_taken_for_uneven_pixels() -> None:
    one = uneven_problem(0.0)
    for off in (0.5, 1.0):
        wrong = point(one, off)
        error, plain = stated(one, weighed_again(one, wrong)), stated(one, wrong)
        assert error.known and 0.8 * plain.value < error.value <= plain.value


def test_the_response_is_at_most_the_described_one() -> None:
    one = uneven_problem(0.02)
    at = weighed_again(one, point(one))
    assert at.local.response.squared == 0.01**2
    assert stated(one, at).value == pytest.approx(np.sqrt(0.02**2 - 0.01**2), rel=0.25)
    even = uneven_problem(0.02, described=0.0)
    found = response_of(even, point(even))
    assert (found.squared, found.sigma) == (0.0, 0.0)


def test_patterns_that_share_no_pixel_do_not_determine_the_response() -> None:
    whole = uneven_problem(0.0, described=0.02)
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


def test_errors_stated_by_mistake_are_as_rare_as_three_sigma() -> None:
    rng = np.random.default_rng(0)
    # few pixels are bright: squares of their noise scatter farther up than down
    noise = np.concatenate([np.full(30, 1.0), np.full(1000, 0.03)])
    scatter = np.sqrt(2 * (noise**2).sum())
    skew = 8 * (noise**3).sum() / scatter**3
    drawn = np.array([(noise * (rng.standard_normal(noise.size) ** 2 - 1)).sum() for _ in range(20_000)])
    plain, corrected = (np.mean([ModelError(v, scatter, 0.0, 8, 0.0, s).known for v in drawn]) for s in (0.0, skew))
    assert plain > 0.004 and corrected < 0.0025


@pytest.mark.long
def test_a_fit_finds_the_response_and_states_a_limit() -> None:
    plan = truth(0.01).plan
    measured = uneven(recorded(Truth(plan, setup_of(plan), {}), COUNT, np.random.default_rng(6)), 0.01)
    fit = fit_camera(measured, unknowns=["geometry"], stage=0.0, workers=1)
    assert fit.spread.response == pytest.approx(0.01, rel=0.15)
    assert fit.complete and not fit.held_out_error.known


UNKNOWNS = [Unknown(name, "some", "µm", 5.0, 0.5) for name in ("found", "other", "held")]
WHICH, HELD = np.array([0, 1]), np.array([2])
ALIKE = np.array([[100.0, 0, 99.5], [0, 100, 0], [99.5, 0, 100]])


def found_in(data: np.ndarray, slope: np.ndarray | None = None, held: np.ndarray = HELD) -> Degeneracies:
    return degeneracies(UNKNOWNS, WHICH, held, data, np.zeros(3) if slope is None else slope, np.zeros(3))


def test_fixed_parameters_that_matter_much_are_named() -> None:
    # sigma 0.1 scales, or 0.1 / sqrt(1 - 0.995²)
    assert found_in(ALIKE).words == ("held, fixed at 5 µm, with found (± 0.05 would be ± 0.5 µm)",)
    # prior knowledge limits the fixed parameter to less
    assert found_in(ALIKE + np.diag([0.0, 0.0, 40.0])).words == ()
    assert found_in(ALIKE, held=HELD[:0]).words == ()
    # a gap that would be five times less sure is not named, but its variance includes the fixed distance
    less = np.array([[100.0, 0, 98], [0, 100, 0], [98, 0, 100]])
    assert found_in(less).words == ()
    for data in (ALIKE, less):
        wanted = [np.linalg.inv(data)[0, 0], 0.01]
        np.testing.assert_allclose(found_in(data).variances(np.diag([0.01, 0.01])), wanted, rtol=1e-6)


def test_the_variance_includes_the_shift_by_a_fixed_parameter() -> None:
    own = np.diag([0.01, 0.01])
    # the fixed parameter is wrong by 2.5 scales, of which the fit of the others took 0.995
    truth = np.array([0.0, 0.0, 2.5])
    taken = np.array([0.995 * 2.5, 0.0, 0.0])
    shown = found_in(ALIKE, ALIKE @ (truth - taken))
    np.testing.assert_allclose(shown.shift, [-0.995 * 2.5, 0.0], atol=1e-9)
    assert np.sqrt(shown.variances(own)[0]) == pytest.approx(math.hypot(0.995 * 2.5, 1.0), rel=0.01)
    # noise larger than stated increases the variance, but not the shift
    assert shown.variances(own, 2.0)[0] == pytest.approx((0.995 * 2.5) ** 2 + 4.0, rel=0.02)
    # a complete degeneracy is only a matter of what is fixed
    same = np.array([[100.0, 0, 100], [0, 100, 0], [100, 0, 100]])
    assert len(found_in(same).words) == 1 and not found_in(same).spread.any()


def test_defocus_and_lens_law_count_in_sigmas_but_are_never_added() -> None:
    """Defocus would take the place of the distance, and the lens law that of the iris."""
    _, tried = groups_of("auto")
    held = {"defocus", "lens_law"}
    assert held < set(tried) and set(tried) - set(addable(tried)) == held
    microscope = ScanPlan.for_camera(small_camera("lfm_20x05"), depths_um=(5.0, 12.0), cutout=15)
    (lens, law, _), (objective, _) = (
        vector_of(plan, ("defocus", "lens_law", "distance")).unknowns for plan in (small_plan(15), microscope)
    )
    for own in (lens, objective):
        assert own.name == "zernike_2_0" and own.sigma == 0.25 and not own.gauge
    assert law.name == "lens_law" and law.start == 0 and law.sigma == 0.5


def test_an_assumed_lens_law_always_counts() -> None:
    """Of two unknowns that resemble each other a little, the fixed one counts in the other's sigma only if assumed."""
    alike = np.array([[100.0, 10.0], [10.0, 5.0]])
    for name, counts in (("lens_law", True), ("pitch", False)):
        unknowns = [Unknown("f_number", "iris", "", 4.0, 0.1), Unknown(name, name, "", 0.0, 0.5)]
        shown = degeneracies(unknowns, np.array([0]), np.array([1]), alike, np.zeros(2), np.zeros(2))
        assert bool(shown.spread.any()) is counts and not shown.words


def test_derivatives_of_a_round_keep_those_by_all_else() -> None:
    before = Columns(np.ones((3, 2, 4), np.float32))
    now = Columns(np.full((3, 2, 4), 2.0, np.float32)).with_others(before, [1])
    assert now.shared[:, 0, 0].tolist() == [1.0, 2.0, 1.0]


@cache
def deep_in_water() -> tuple[ScanPlan, Setup, Measured]:
    """Return four patterns of an oil lens that looks 12 µm deep, without noise."""
    plan = ScanPlan.for_camera(small_camera("lfm_60x12"), depths_um=[-1.0, 2.0], cutout=15)
    setup = Setup(plan.camera, (*starting_effects(plan), IndexMismatch(1.38, 12.0)), (0.0, 0.0))
    index = some_index(plan, 4)
    light = predict(setup, plan, index, np.zeros((4, 2)), Fineness.coarse)
    return plan, setup, measured(plan, 16e3 * light / light.max(), index, (4.0, 1.0))


@pytest.mark.long
def test_distance_and_depth_in_a_specimen_are_named_as_degenerate() -> None:
    """For an oil lens in water, 2 µm of depth look like 0.1 µm of distance and some spherical aberration."""
    _, setup, patterns = deep_in_water()
    rest = ("wavefront", "higher_wavefront")
    names = ("geometry", "distance", *rest, "specimen", "crosstalk")
    problem = problem_of(patterns, setup, names, 1)
    point = problem.point(np.zeros(len(problem.vector)), Local(np.zeros((4, 2))), Fineness.coarse)
    columns = drain(problem.columns(point, range(len(problem.vector)), "", displaced=False))

    def fitted(*groups: str) -> Fit:
        return summarised(problem, point, columns, groups=groups, tried=names, outliers=())[0]

    (deep,) = fitted("geometry", "distance", *rest).unidentified
    assert deep.startswith("specimen_depth_um, fixed at 12 µm, with distance_um (± ")
    # with both of them fitted nothing is fixed, and standard deviations stay
    both = fitted("geometry", "distance", *rest, "specimen")
    assert both.unidentified == ()
    assert all(one.sigma == pytest.approx(one.sigma_held) for one in both.parameters.values())
    # the same if only these groups were asked for, with derivatives made for it
    asked_for = ("geometry", "specimen", *rest)
    asked = problem_of(patterns, setup, asked_for, 1)
    own = Columns(columns.shared[[names_of(problem).index(name) for name in names_of(asked)]])
    at = asked.point(np.zeros(len(asked.vector)), Local(np.zeros((4, 2))), Fineness.coarse)
    untried = drain(iter_degeneracies(asked, at, own, asked_for))
    (alone,) = summarised(asked, at, own, groups=asked_for, tried=(), outliers=(), untried=untried)
    fit = fitted(*asked_for)
    assert len(fit.unidentified) == 1
    for one, words in ((fit, fit.unidentified), (alone, untried.words)):
        assert any(w.startswith("distance_um, fixed at 0 µm, with specimen_depth_um (± ") for w in words)
        wide, sure = one.parameters["specimen_depth_um"], one.parameters["gap_um"]
        assert wide.sigma > 8 * wide.sigma_held and sure.sigma < 2 * sure.sigma_held


def names_of(problem: Problem) -> list[str]:
    return [one.name for one in problem.vector.unknowns]


@pytest.mark.long
def test_degenerate_unknowns_are_not_distinguished_by_curvature_in_derivatives() -> None:
    """Steps to one side contain a few percent of curvature, which would seem to separate defocus from distance."""
    _, setup, patterns = deep_in_water()
    problem = problem_of(patterns, setup, ("distance", "wavefront", "specimen", "defocus"), 1)
    whole, names = range(len(problem.vector)), names_of(problem)
    point = problem.point(np.zeros(len(names)), Local(np.zeros((4, 2))), Fineness.fine)
    by_steps = []
    for u in 0.03 * np.eye(len(names)):
        up, down = (problem.model(side, np.zeros((4, 2)), Fineness.coarse) for side in (u, -u))
        by_steps.append((up - down) / np.float32(0.06))
    true, _ = covariance(problem, point, Columns(np.array(by_steps)), np.array(whole))
    found, _ = covariance(problem, point, drain(problem.columns(point, whole, "", displaced=False)), np.array(whole))
    k = len(names)
    np.testing.assert_allclose(np.sqrt(np.diag(found)[:k]), np.sqrt(np.diag(true)[:k]), rtol=0.1)
