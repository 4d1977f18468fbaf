"""Points fitted where they are: the true camera explains them there, and not modulo the period."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfcal.base.progress import drain
from lfcal.campaign.point_fit import PointOptics, _placed
from lfcal.campaign.points import measured_modulo, measured_points, points_of
from lfcal.fit.fit import problem_of
from lfcal.fit.measured import Measured
from lfcal.fit.model import Fineness
from lfcal.fit.normal import Local
from lfcal.fit.setup import Setup, described_effects, starting_effects
from lfcal.frames import ArraySource, CorrectionRecipe, corrected_view
from lfcal.simulate.effects import Quantisation, ReadNoise, ShotNoise
from lfcal.targets import Pose, TargetCamera
from lfcal.targets.frames import TargetFrames
from tests.campaign.points import SCAN, array_of, frames_of_drawn, plan_of, view_of


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
