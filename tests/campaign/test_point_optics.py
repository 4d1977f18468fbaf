"""The optics of each point: its own place and depth, and the size of its hole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfcal.base.progress import drain
from lfcal.campaign.point_fit import PointOptics, _Holes, _placed, _with_hole, iter_with_point_light
from lfcal.campaign.points import Points, measured_modulo, measured_points, points_of
from lfcal.fit.field import Regional
from lfcal.fit.fit import problem_of
from lfcal.fit.measured import Measured
from lfcal.fit.model import Fineness, predict
from lfcal.fit.normal import Local
from lfcal.fit.problem import Problem
from lfcal.fit.setup import Setup, described_effects, starting_effects
from lfcal.frames import ArraySource, CorrectionRecipe, corrected_view
from lfcal.frames.source import FrameSource
from lfcal.simulate.effects import FiniteSource, MechanicalVignetting, Quantisation, ReadNoise, ShotNoise
from lfcal.targets import Pose, TargetCamera
from lfcal.targets.frames import TargetFrames
from tests.campaign.points import SCAN, array_of, frames_of_drawn, plan_of, view_of

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
