"""Points fitted where they are: the true camera explains them there, and not modulo the period."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfcal.campaign.point_parts import measured_modulo, measured_points
from lfcal.campaign.points import points_of
from lfcal.fit.fit import problem_of
from lfcal.fit.measured import Measured
from lfcal.fit.model import Fineness
from lfcal.fit.normal import Local
from lfcal.fit.setup import Setup, called_for, described_effects
from lfcal.frames import ArraySource, CorrectionRecipe, corrected_view
from lfcal.simulate.effects import Quantisation, ReadNoise, ShotNoise
from lfcal.targets import Pose, TargetCamera
from lfcal.targets.frames import TargetFrames
from tests.campaign.points import SCAN, array_of, plan_of


def misfit(measured: Measured) -> float:
    """Return chi² of the described camera, every point where it is said to be."""
    setup = Setup(SCAN.camera, called_for(SCAN), (0.0,))
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
