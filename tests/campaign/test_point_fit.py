"""Fits of the points of a target: the optics of each point, and the size of the holes as an unknown."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.base.progress import drain
from lfcal.campaign.point_fit import (
    HOLE,
    PointOptics,
    _Holes,
    _placed,
    _with_hole,
    fit_points,
    hole_is_determined,
    hole_words,
    iter_hole_is_needed,
    iter_with_point_light,
    without_hole,
)
from lfcal.campaign.points import Points, measured_modulo, measured_points, points_of
from lfcal.fit.field import Regional
from lfcal.fit.fit import problem_of
from lfcal.fit.measured import Measured
from lfcal.fit.model import Fineness, predict
from lfcal.fit.normal import Local
from lfcal.fit.parameters import check_groups
from lfcal.fit.problem import Point, Problem
from lfcal.fit.result import Parameter
from lfcal.fit.setup import Setup, described_effects, starting_effects
from lfcal.fit.solver import descend
from lfcal.fit.spread import spread_out
from lfcal.frames import ArraySource, CorrectionRecipe, corrected_view
from lfcal.frames.source import FrameSource
from lfcal.simulate.effects import FiniteSource, MechanicalVignetting, Quantisation, ReadNoise, ShotNoise
from lfcal.simulate.engines.base import Sampling
from lfcal.targets import Pose, TargetCamera, uneven
from lfcal.targets.frames import TargetFrames
from tests.campaign.points import SCAN, array_of, frames_of_drawn, plan_of, view_of

PLAIN = described_effects(SCAN.camera)
DESCRIBED, REAL = 20.0, 28.0
"""Holes 40 % larger than described (µm): 0.8 and 1.1 pixels in the image."""


@pytest.fixture(scope="module")
def flat_view() -> FrameSource:
    plan = plan_of([(0.0, 0.0)], array_of())
    return view_of(plan, frames_of_drawn(plan))


@pytest.fixture(scope="module")
def flat_points(flat_view: FrameSource) -> Points:
    return points_of(flat_view, plan_of([(0.0, 0.0)], array_of(hole_um=DESCRIBED)))


def problem_with(flat_view: FrameSource, flat_points: Points, described: float, really: float, noise: float) -> Problem:
    """Return the problem of points described with holes of one size, in whose patterns they have another."""
    measured = measured_points(flat_view, flat_points, (1, 2), most=4)
    own = replace(PointOptics.of(flat_points, measured), hole_um=described)
    setup = Setup(SCAN.camera, PLAIN, (0.0,), regions=own.regions, hole_um=described)
    problem = problem_of(measured, setup, ("iris", HOLE), 1)
    still = np.zeros((len(measured), 2))
    true = problem_of(measured, replace(setup, hole_um=really), ("iris", HOLE), 1)
    work = iter_with_point_light(true, own, np.zeros(len(true.vector)), still, Fineness.coarse, "true")
    light = drain(work).model(np.zeros(len(true.vector)), still, Fineness.coarse).reshape(measured.patterns.shape)
    rng, sigma = np.random.default_rng(0), noise * float(light.max())
    recorded = replace(
        measured,
        patterns=(light + sigma * rng.standard_normal(light.shape)).astype(np.float32),
        noise=np.tile([sigma**2, 0.0], (len(measured), 1)),
        valid=np.ones(light.shape, np.bool_),
    )
    begun = problem.with_measured(recorded)
    return drain(iter_with_point_light(begun, own, np.zeros(len(begun.vector)), still, Fineness.coarse, "described"))


def fitted(problem: Problem, groups: tuple[str, ...]) -> tuple[Problem, Point, tuple[str, ...], Any, tuple[()]]:
    start = problem.point(np.zeros(len(problem.vector)), Local(np.zeros((len(problem.measured), 2))), Fineness.coarse)
    which = problem.vector.of_groups(groups).tolist()
    point, columns = drain(descend(problem, start, which, "fit", most=4))
    return problem, point, groups, columns, ()


def hole_of(problem: Problem, point: Point) -> float:
    return problem.vector.values(point.u)["hole_um"]


@pytest.mark.long
def test_light_changes_with_the_square_of_the_diameter(flat_view: FrameSource, flat_points: Points) -> None:
    problem = problem_with(flat_view, flat_points, DESCRIBED, DESCRIBED, 1e-3)
    measured = problem.measured
    assert measured.blurred_um == DESCRIBED and measured.blur is not None
    more = measured.more_light(REAL) - measured.more_light(DESCRIBED)
    plan, which, k = next(iter(measured.parts()))
    j = int(which[0])
    alone = replace(plan, period=(1, 1), anchor=tuple((np.array(plan.anchor) + measured.index[j, 1:]).tolist()))
    own, at = problem.vector.setup.of_region(k), np.zeros((1, 3), int)
    small, large = (
        predict(own.with_effect(FiniteSource(size)), alone, at, measured.places_px[j : j + 1], Fineness.coarse)[0]
        for size in (DESCRIBED, REAL)
    )
    assert np.linalg.norm(more[j] - (large - small)) < 0.15 * np.linalg.norm(large - small)
    assert measured.more_light(None) is measured.extra_light
    assert np.array_equal(measured.of(np.arange(len(measured)) > 0).blur, measured.blur[1:])


@pytest.mark.long
def test_holes_larger_than_described_are_found(flat_view: FrameSource, flat_points: Points) -> None:
    problem = problem_with(flat_view, flat_points, DESCRIBED, REAL, 1e-3)
    held = fitted(problem, ("iris",))
    assert drain(iter_hole_is_needed(held)), "by chi² of the fit"
    found = fitted(problem, ("iris", HOLE))
    assert hole_of(*found[:2]) == pytest.approx(REAL, rel=0.04)
    assert hole_is_determined(found)
    assert problem.cost(found[1], held[1]) < 0.95 * problem.cost(held[1])


def test_holes_as_described_need_no_fit(flat_view: FrameSource, flat_points: Points) -> None:
    problem = problem_with(flat_view, flat_points, DESCRIBED, DESCRIBED, 1e-3)
    assert not drain(iter_hole_is_needed(fitted(problem, ("iris",))))
    found = fitted(problem, ("iris", HOLE))
    assert hole_is_determined(found) and hole_of(*found[:2]) == pytest.approx(DESCRIBED, rel=0.04)


@pytest.mark.long
def test_holes_far_smaller_than_details_of_the_light_are_undetermined(
    flat_view: FrameSource, flat_points: Points
) -> None:
    problem = problem_with(flat_view, flat_points, 2.0, 2.8, 0.02)
    found = fitted(problem, ("iris", HOLE))
    assert not hole_is_determined(found)
    problem, point, groups, _, _ = without_hole(found)
    assert groups == ("iris",) and hole_of(problem, point) == 2.0


@pytest.mark.long
def test_noise_stated_too_low_determines_no_hole(flat_view: FrameSource, flat_points: Points) -> None:
    """What the model leaves, by chi², counts as noise."""
    problem = problem_with(flat_view, flat_points, 8.0, 8.0, 0.02)
    assert not hole_is_determined(fitted(problem, ("iris", HOLE)))
    sure = problem.with_measured(replace(problem.measured, noise=problem.measured.noise / 400))
    assert not hole_is_determined(fitted(sure, ("iris", HOLE)))


def test_the_size_of_the_holes_is_reported_with_its_description() -> None:
    def words(described: float, found: tuple[float, float] | None, unhelpful: tuple[str, ...] = ()) -> str:
        given = {} if found is None else {"hole_um": Parameter("hole_um", HOLE, "µm", *found, described, found[1])}
        setup = Setup(SCAN.camera, PLAIN, (0.0,), hole_um=described)
        return hole_words(SimpleNamespace(parameters=given, unhelpful=unhelpful, setup=setup))

    assert words(20.0, None) == words(20.0, (20.2, 0.3)) == ""
    assert words(20.0, (28.3, 0.29)) == "size of the holes: 28.3 ± 0.29 µm measured, 20 µm described"
    assert words(0.0, (28.3, 0.29)).endswith("points described")
    fixed = "size of the holes: undetermined, because their images are too small; fixed at the described size of 2 µm"
    assert words(2.0, None, (HOLE,)) == fixed
    # with all groups tried, a group that did not help is not reported
    assert hole_words(SimpleNamespace(parameters={}, unhelpful=(HOLE,), setup=None), asked=False) == ""
    with pytest.raises(InputError, match="frames of a target"):  # a scan of single points has no holes
        check_groups(Setup(SCAN.camera, PLAIN, (0.0,)), SCAN, (HOLE,))


@pytest.mark.long
def test_holes_forty_percent_larger_than_described_cost_nothing_once_they_are_found() -> None:
    from benchmarks._target_scene import predicted
    from benchmarks.target import error_of
    from lfcal.campaign import point_fit

    offsets = [(0.0, 0.0), (7.3, -11.2)]
    plan = plan_of(offsets, array_of(hole_um=20.0))
    really = array_of(hole_um=28.0, pose=Pose(rotation_rad=0.01))
    lattice = SCAN.camera.lattice
    true = replace(SCAN.camera, lattice=replace(lattice, gap_um=1.01 * lattice.gap_um))
    effects = (*described_effects(true), ShotNoise(), ReadNoise(), Quantisation())
    camera = TargetCamera(
        replace(plan, scan=replace(SCAN, camera=true)),
        effects,
        really=really,
        brightness=uneven(really, 0.1),
        level="grid",
        sampling=Sampling(6.0, margin_px=24),
    )
    seen = view_of(plan, np.stack([camera.read(k).astype(np.uint16) for k in range(len(offsets))]))
    points = points_of(seen, plan)
    every = np.argwhere(np.ones(SCAN.shape[:3], np.bool_))
    at = every[spread_out(every, 16, SCAN.period)]
    right = predicted(Setup(true, described_effects(true), (0.0,)), SCAN, at)

    def error(*, called_for: bool) -> tuple[float, Any]:
        with pytest.MonkeyPatch.context() as patch:
            if not called_for:
                patch.setattr(point_fit, "iter_hole_is_needed", lambda _: _no())
            fit = fit_points(seen, points, ("geometry", "focal_lengths", "iris"), parts=(2, 2), most=24, workers=1)
        own = fit.fit_at(SCAN)
        return error_of(predicted(own.ideal_places, own.planned, at), right), fit.first

    wrong, held = error(called_for=False)
    corrected, found = error(called_for=True)
    assert HOLE not in held.groups and HOLE in found.groups
    one = found.parameters["hole_um"]
    # frames are computed otherwise than the fit computes them, which its deviation does not hold
    assert one.value == pytest.approx(28.0, abs=1.6) and one.sigma < 1.0
    assert found.chi2 < held.chi2 and corrected < 0.6 * wrong
    assert "20 µm described" in hole_words(found)


def _no() -> Any:
    yield from ()
    return False


# -- the optics of each point: its own place and depth ---------------------------------------------------
EFFECTS = (*described_effects(SCAN.camera), MechanicalVignetting(40e3, 0.9))
TILTED = Pose(tilt_right_rad=0.1)


@pytest.fixture(scope="module")
def view() -> FrameSource:
    plan = plan_of([(0.0, 0.0)], array_of(pose=TILTED))
    return view_of(plan, frames_of_drawn(plan))


@pytest.fixture(scope="module")
def points(view: FrameSource) -> Points:
    return points_of(view, plan_of([(0.0, 0.0)], array_of(pose=TILTED)))


def problem_at(measured: Regional, own: PointOptics) -> Problem:
    return problem_of(measured, Setup(SCAN.camera, EFFECTS, (0.0,), regions=own.regions), ("iris", "plane_tilt"), 1)


def with_own(problem: Problem, own: PointOptics) -> np.ndarray:
    still = np.zeros((len(problem.measured), 2))
    found = drain(iter_with_point_light(problem, own, np.zeros(len(problem.vector)), still, Fineness.coarse, "points"))
    return found.model(np.zeros(len(problem.vector)), still, Fineness.coarse)


@pytest.mark.long
def test_a_pattern_is_that_of_its_own_place_depth_and_hole(view: FrameSource, points: Points) -> None:
    measured = measured_points(view, points, (1, 2), most=4)
    own = replace(PointOptics.of(points, measured), hole_um=60.0)
    # the target is tilted to the right: what lies there is farther away
    assert own.parts_um[1] > own.parts_um[0] + 300
    assert np.corrcoef(own.farther_um, own.middles[:, 1])[0, 1] > 0.99
    found = with_own(problem_at(measured, own), own).reshape(-1, *SCAN.cutout)
    places = [plan.anchor + measured.index[which, 1:] for plan, which, _ in measured.parts()]
    for k, place in enumerate(np.concatenate(places)):
        j = np.concatenate([which for _, which, _ in measured.parts()])[k]
        alone = replace(SCAN, period=(1, 1), anchor=tuple(place.tolist()))
        setup = Setup(SCAN.camera, (*EFFECTS, FiniteSource(60.0)), (float(own.farther_um[j]),))
        still = measured.places_px[j : j + 1]
        wanted = predict(setup, alone, np.zeros((1, 3), np.intp), still, Fineness.coarse)[0]
        np.testing.assert_allclose(found[j], wanted, atol=2e-5 * wanted.max())


def test_the_extra_light_of_points_is_kept_while_the_unknowns_change(view: FrameSource, points: Points) -> None:
    measured = measured_points(view, points, (1, 2), most=4)
    extra = np.random.default_rng(0).normal(0, 1e-5, measured.patterns.shape).astype(np.float32)
    own = PointOptics.of(points, measured)
    plain, held = problem_at(measured, own), problem_at(replace(measured, extra_light=extra), own)
    still = np.zeros((len(measured), 2))
    for u in (np.zeros(len(plain.vector)), np.full(len(plain.vector), 0.3)):
        less = held.model(u, still, Fineness.coarse) - plain.model(u, still, Fineness.coarse)
        np.testing.assert_allclose(less, extra.reshape(less.shape), atol=1e-8)
    keep = np.arange(len(measured)) > 0
    assert np.array_equal(held.measured.of(keep).extra_light, extra[keep])
    assert np.array_equal(replace(measured, extra_light=extra).of_region(1).extra_light, extra[measured.region == 1])


def test_the_size_of_a_source_among_the_effects_is_that_of_the_holes(points: Points) -> None:
    found, effects = _with_hole(points, (*EFFECTS, FiniteSource(35.0)))
    assert found.plan.target.hole_um == 35.0 and effects == EFFECTS
    assert _with_hole(points, EFFECTS) == (points, EFFECTS)
    setup, holes = Setup(SCAN.camera, EFFECTS, (0.0,)), _Holes(60.0, 0.0, fitted=True)
    assert holes.put(setup).effects == (*EFFECTS, FiniteSource(60.0))
    assert holes.put(setup, 35.0).effects == (*EFFECTS, FiniteSource(35.0))
    assert holes.put(setup, 0.0) is setup, "holes of no size are points"


# -- fits of points where they are -----------------------------------------------------------------------
def misfit(measured: Measured) -> float:
    """Return chi² of the described camera, every point where it is said to be."""
    setup = Setup(SCAN.camera, starting_effects(SCAN), (0.0,))
    problem = problem_of(measured, setup, ("iris",), 1)
    start = np.zeros(len(problem.vector))
    point = problem.point(start, Local(np.zeros((len(measured), 2))), Fineness.coarse)
    return float(np.square(point.seen.residual, dtype=np.float64).mean())


@pytest.mark.long
def test_points_are_explained_where_they_are_and_not_modulo_the_period() -> None:
    plan = plan_of([(0.0, 0.0)], replace(array_of(), pose=Pose(rotation_rad=0.017)))
    camera = TargetCamera(plan, (*described_effects(SCAN.camera), ShotNoise(), ReadNoise(), Quantisation()))
    source = ArraySource(camera.read(0)[None], [(0, 0, 0)])
    view = corrected_view(TargetFrames(source, plan), CorrectionRecipe(), SCAN)
    points = points_of(view, plan)
    assert len(points) == 22
    true = camera.points(0)
    assert np.array_equal(points.holes, true.holes) and np.abs(points.pixels - true.pixels).max() < 0.35
    real, modulo = misfit(measured_points(view, points, (2, 2))), misfit(measured_modulo(view, points))
    assert modulo > 4 * real


def test_points_of_other_brightness_keep_what_their_noise_means() -> None:
    """Patterns are put to one brightness, and the variance of their noise to that brightness."""
    plan = plan_of([(0.0, 0.0)])
    view = view_of(plan, frames_of_drawn(plan))
    points = points_of(view, plan)
    drawn = measured_points(view, points, (1, 1), most=4)
    bright = np.array([0.8, 1.0, 1.3, 0.9], np.float32)
    # a brighter lamp: more light, its photons' variance with it
    seen = replace(drawn, patterns=drawn.patterns * bright[:, None, None], noise=drawn.noise.copy())
    own = PointOptics.of(points, seen)
    setup = Setup(SCAN.camera, starting_effects(SCAN), (0.0,), regions=own.regions)
    placed, _ = drain(_placed(problem_of(seen, setup, ("iris",), 1), own, ("iris",), 1))
    new: Measured = placed.measured
    factor = seen.patterns.max((1, 2)) / new.patterns.max((1, 2))
    assert np.ptp(factor) > 0.1 and factor.argmax() == bright.argmax()
    peak = new.patterns.max((1, 2))
    variance = seen.noise[:, 0] + seen.noise[:, 1] * seen.patterns.max((1, 2))
    np.testing.assert_allclose(new.noise[:, 0] + new.noise[:, 1] * peak, variance / factor**2, rtol=1e-5)
