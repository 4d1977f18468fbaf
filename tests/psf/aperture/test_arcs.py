import math

import numpy as np
import pytest

from lfcal.psf.aperture._arcs import Arcs
from lfcal.psf.aperture.shape import blade_radius

ANGLES = np.linspace(0, 2 * math.pi, 500, endpoint=False)


@pytest.mark.parametrize(("blades", "curvature"), [(5, 0.0), (9, 0.4), (12, 0.9)])
def test_a_regular_iris_has_the_radius_of_its_closed_form(blades, curvature):
    arcs = Arcs(40.0, curvature, blades, 0.3)
    assert np.allclose(arcs.radius(ANGLES), blade_radius(ANGLES, blades, 0.3, 40.0, curvature))


def test_rays_from_elsewhere_end_on_the_same_outline():
    arcs = Arcs(30.0, 0.2, 7, 0.1, stuck=2, stuck_share=-0.1, rim=(4.0, 0.8, 0.5), stretch=0.05, shear=-0.03)
    row, column = 4.0, -6.0
    radius = arcs.radius(ANGLES, row, column)
    y, x = row + radius * np.sin(ANGLES), column + radius * np.cos(ANGLES)
    assert np.allclose(np.hypot(x, y), arcs.radius(np.arctan2(y, x)))


def test_a_stretch_brings_the_outline_onto_the_arcs():
    arcs = Arcs(30.0, stretch=0.1, shear=0.05)
    radius = arcs.radius(ANGLES)
    x, y = radius * np.cos(ANGLES), radius * np.sin(ANGLES)
    assert np.allclose(np.hypot(1.1 * x + 0.05 * y, 0.05 * x + 0.9 * y), 30.0)


@pytest.mark.parametrize("share", [-0.15, 0.1])
def test_a_stuck_blade_is_moved_by_its_share(share):
    arcs = Arcs(30.0, 0.0, 6, 0.2, stuck=4, stuck_share=share)
    middle = np.array([0.2 + 4.5 * math.pi / 3])
    # straight blades of a hexagon meet where a blade has gone a third of the apothem... which 10 % is not
    assert arcs.radius(middle)[0] == pytest.approx(30.0 * (1 + share))
    assert arcs.radius(middle + math.pi)[0] == pytest.approx(30.0)


def test_a_rim_cuts_at_its_distance_with_its_own_circle():
    arcs = Arcs(30.0, rim=(1.0, 0.7, 0.5))
    radius = arcs.radius(ANGLES)
    x, y = radius * np.cos(ANGLES), radius * np.sin(ANGLES)
    # a circle of radius 60, whose nearest point lies 21 from the middle
    behind = 60.0 - 21.0
    away = np.hypot(x + behind * math.cos(1.0), y + behind * math.sin(1.0))
    assert (np.isclose(away, 60.0) | np.isclose(radius, 30.0)).all()
    assert np.isclose(away, 60.0).sum() > 100 and np.isclose(radius, 30.0).sum() > 100
