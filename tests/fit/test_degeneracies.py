"""What is held as described, though what was found may stand in for it, is named."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

from lfcal.base.progress import drain
from lfcal.camera import ScanPlan
from lfcal.fit import Fit, Measured, Setup, Unknown
from lfcal.fit._summary import Degeneracies, degeneracies, iter_degeneracies, summarised
from lfcal.fit.fit import addable, groups_of, problem_of
from lfcal.fit.model import Fineness, predict
from lfcal.fit.model_error import covariance
from lfcal.fit.normal import Columns, Local
from lfcal.fit.problem import Problem
from lfcal.fit.setup import starting_effects
from lfcal.simulate.effects import IndexMismatch
from tests.fit.common import measured, small_camera, small_plan, some_index, vector_of

UNKNOWNS = [Unknown(name, "some", "µm", 5.0, 0.5) for name in ("found", "other", "held")]
WHICH, HELD = np.array([0, 1]), np.array([2])
ALIKE = np.array([[100.0, 0, 99.5], [0, 100, 0], [99.5, 0, 100]])


def told(data: np.ndarray, slope: np.ndarray | None = None, held: np.ndarray = HELD) -> Degeneracies:
    return degeneracies(UNKNOWNS, WHICH, held, data, np.zeros(3) if slope is None else slope, np.zeros(3))


def test_only_what_would_make_the_others_much_less_sure_is_named() -> None:
    # sigma 0.1 scales, or 0.1 / sqrt(1 - 0.995²)
    assert told(ALIKE).words == ("held, fixed at 5 µm, with found (± 0.05 would be ± 0.5 µm)",)
    # known well beforehand it cannot be otherwise by as much
    assert told(ALIKE + np.diag([0.0, 0.0, 40.0])).words == ()
    apart = np.array([[100.0, 0, 98], [0, 100, 0], [98, 0, 100]])
    assert told(apart).words == () == told(ALIKE, held=HELD[:0]).words


def test_what_is_held_is_part_of_the_standard_deviation() -> None:
    """As it would be, were it found too; and by as much as it is seen to be off, for the value stays as it is."""
    own = np.diag([0.01, 0.01])
    np.testing.assert_allclose(told(ALIKE).variances(own), [np.linalg.inv(ALIKE)[0, 0], 0.01], rtol=1e-6)
    # a change of it by 2.5 scales of which the fit of the others took 0.995
    truth = np.array([0.0, 0.0, 2.5])
    found = np.array([0.995 * 2.5, 0.0, 0.0])
    shown = told(ALIKE, ALIKE @ (truth - found))
    np.testing.assert_allclose(shown.shift, [-0.995 * 2.5, 0.0], atol=1e-9)
    assert np.sqrt(shown.variances(own)[0]) == pytest.approx(math.hypot(0.995 * 2.5, 1.0), rel=0.01)
    # noise larger than stated makes all of it less sure, but not what is seen
    assert shown.variances(own, 2.0)[0] == pytest.approx((0.995 * 2.5) ** 2 + 4.0, rel=0.02)
    # what is not told at all is a matter of what is held
    same = np.array([[100.0, 0, 100], [0, 100, 0], [100, 0, 100]])
    assert len(told(same).words) == 1 and not told(same).spread.any()


def test_what_is_held_counts_before_it_is_named() -> None:
    """A gap that would be five times less sure, were the distance found, is off by more than its own noise."""
    alike = np.array([[100.0, 0, 98], [0, 100, 0], [98, 0, 100]])
    shown = told(alike)
    assert shown.words == ()
    np.testing.assert_allclose(shown.variances(np.diag([0.01, 0.01])), [np.linalg.inv(alike)[0, 0], 0.01], rtol=1e-6)


def test_what_is_held_is_looked_at_but_never_added() -> None:
    """Defocus would take the place of the distance, the lens law that of the iris: held they count in the sigmas."""
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


def test_an_assumed_lens_law_counts_however_little_it_changes() -> None:
    """Of two unknowns that resemble each other a little, the held one counts in the other's sigma only if assumed."""
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
def test_a_planes_distance_is_named_beside_the_depth_in_a_specimen() -> None:
    """Of an oil lens in water 2 µm of depth look as 0.1 µm of distance and some spherical aberration."""
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
    fit = fitted("geometry", "specimen", *rest)
    (near,) = fit.unidentified
    assert near.startswith("distance_um, fixed at 0 µm, with specimen_depth_um (± ")
    wide, sure = fit.parameters["specimen_depth_um"], fit.parameters["gap_um"]
    assert wide.sigma > 8 * wide.sigma_held and sure.sigma < 2 * sure.sigma_held
    # found with both of them nothing is held, and standard deviations are what they are
    both = fitted("geometry", "distance", *rest, "specimen")
    assert both.unidentified == ()
    assert all(one.sigma == pytest.approx(one.sigma_held) for one in both.parameters.values())

    # so it is where nothing but these groups was asked for, by derivatives that are made for it
    asked_for = ("geometry", "specimen", *rest)
    asked = problem_of(patterns, setup, asked_for, 1)
    own = np.array([names_of(problem).index(name) for name in names_of(asked)])
    at = asked.point(np.zeros(len(asked.vector)), Local(np.zeros((4, 2))), Fineness.coarse)
    beside = drain(iter_degeneracies(asked, at, Columns(columns.shared[own]), asked_for))
    assert any(one.startswith("distance_um, fixed at 0 µm, with specimen_depth_um (± ") for one in beside.words)
    (fit,) = summarised(
        asked, at, Columns(columns.shared[own]), groups=asked_for, tried=(), outliers=(), untried=beside
    )
    wide, sure = fit.parameters["specimen_depth_um"], fit.parameters["gap_um"]
    assert wide.sigma > 8 * wide.sigma_held and sure.sigma < 2 * sure.sigma_held


def names_of(problem: Problem) -> list[str]:
    return [one.name for one in problem.vector.unknowns]


@pytest.mark.long
def test_what_stands_in_for_each_other_is_not_told_apart_by_the_curvature_in_derivatives() -> None:
    """By steps to one side a few percent of curvature are in them, which seems to tell defocus from distance."""
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
