"""Outlines of pupils whose transforms and blades have a limit."""

from __future__ import annotations

import math

import numpy as np

from lfcal.simulate.engines import _polygon as polygon
from lfcal.simulate.engines._polygon import area, iris_outline, regular
from lfcal.simulate.scene import PupilIris
from tests.hard_cases.record import hard_case, worst


@hard_case(
    "Polygon's transform at zero frequency",
    wrong="the edge formula loses digits as 1/f^2: an error of 6e-6 of the area",
    measure="largest error divided by the area, for f from 0 to 1e-9",
    bound=1e-15,
)
def test_polygon_at_zero():
    outline = regular(9, 0.2)
    f = np.array([0.0, 1e-300, 1e-12, 1e-9])
    return float(np.abs(polygon.transform(outline, f, -f) - area(outline)).max() / area(outline))


@hard_case(
    "Blades that are almost straight, almost round",
    wrong="the radius of a blade is infinite, or its sagitta is zero",
    measure="distance of the outline from the limiting shape (pupil radii)",
    bound=2e-3,
)
def test_blades():
    straight = np.hypot(*iris_outline(PupilIris(6, 1e-9)).T)
    round_ = np.hypot(*iris_outline(PupilIris(6, 1 - 1e-9)).T)
    corner = math.sqrt(2 * math.pi / (6 * math.sin(math.pi / 3)))
    return worst(abs(float(straight.max()) - corner), float(np.abs(round_ - 1).max()))
