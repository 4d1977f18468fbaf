import math

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.psf.aperture import Aperture, working_f_number
from lfcal.psf.aperture.shape import blade_radius, polygon_area


@pytest.mark.parametrize("blades", [5, 8, 11])
@pytest.mark.parametrize("curvature", [0.0, 0.4, 0.9])
def test_every_edge_point_lies_on_the_arc_of_its_blade(blades, curvature):
    rotation, apothem = 0.3, 40.0
    theta = np.linspace(0, 2 * math.pi, 997)
    r = blade_radius(theta, blades, rotation, apothem, curvature)
    step = 2 * math.pi / blades
    middle = rotation + step * (np.floor((theta - rotation) / step) + 0.5)
    x, y = r * np.cos(theta - middle), r * np.sin(theta - middle)
    if curvature == 0:
        assert np.allclose(x, apothem)
    else:
        radius = apothem / curvature
        assert np.allclose(np.hypot(x + radius - apothem, y), radius)


def test_a_curvature_of_one_is_a_circle():
    assert np.allclose(blade_radius(np.linspace(0, 6, 50), 7, 0.1, 3.0, 1.0), 3.0)


@pytest.mark.parametrize(("blades", "curvature"), [(5, 0.0), (6, 0.35), (9, 0.8), (7, 1.0)])
def test_area_equals_its_integral(blades, curvature):
    theta = np.linspace(0, 2 * math.pi, 200_001)[:-1]
    r = blade_radius(theta, blades, 0.2, 12.0, curvature)
    assert polygon_area(blades, 12.0, curvature) == pytest.approx(math.pi * np.mean(r**2), rel=1e-6)


def test_vertices_lie_at_the_stated_rotation_rows_downwards():
    aperture = Aperture(4, (10.0, 20.0), math.radians(30), 5.0, polygon_area(4, 5.0))
    row, column = aperture.vertices()[0]
    reach = 5 / math.cos(math.pi / 4)
    assert (row - 10, column - 20) == pytest.approx((reach * 0.5, reach * math.sqrt(3) / 2))


def test_a_stretched_outline_is_longer_along_its_axis():
    aperture = Aperture(0, (0.0, 0.0), 0.0, 50.0, math.pi * 2500, 1.0, ellipticity=0.1, ellipse_axis_rad=0.7)
    row, column = aperture.outline(3600).T
    reach = np.hypot(row, column)
    assert reach.min() / reach.max() == pytest.approx(0.9, abs=1e-6)
    k = int(np.argmax(reach))
    assert math.atan2(row[k], column[k]) % math.pi == pytest.approx(0.7, abs=2e-3)


@pytest.mark.parametrize("values", [{"blades": 2}, {"refusal": "shy"}, {"refusal": "circle", "confident": True}])
def test_an_aperture_checks_its_values(values):
    with pytest.raises(InputError):
        Aperture(
            **{"blades": 5, "centre": (0.0, 0.0), "rotation_rad": 0.0, "apothem_px": 1.0, "area_px2": 1.0} | values
        )


def test_f_number_is_the_slope_over_both_sides_of_the_native_plane():
    a = np.array([-4000.0, -2500, 1500, 3000, 5000])
    diameters = np.abs(a - 120) / 5.2 / 5.5
    found = working_f_number(diameters, a, 5.5)
    assert found.value == pytest.approx(5.2, rel=1e-9)
    assert found.offset_um == pytest.approx(120)


def test_f_number_withstands_one_wrong_diameter_and_the_edge_blur():
    a = np.linspace(1000, 5000, 9)
    diameters = a / 4.8 / 5.5 + 2.0
    diameters[4] *= 1.3
    assert working_f_number(diameters, a, 5.5).value == pytest.approx(4.8, rel=0.01)
    through_zero = (a @ a) / (a @ diameters) / 5.5  # counter-test: without a constant the blur goes into the slope
    assert abs(through_zero - 4.8) > 0.05


@pytest.mark.parametrize(
    ("shifts", "message"),
    [
        ([1.0], "expected one diameter for each of two or more depths, got 1 diameter and 1 depth"),
        ([2.0, 2.0], "expected two or more different depths, got equal depths"),
        ([1.0, math.nan], "expected finite numbers, got NaN or infinity"),
    ],
)
def test_f_number_needs_two_depths(shifts, message):
    with pytest.raises(InputError, match=message):
        working_f_number([10.0] * len(shifts), shifts, 5.5)


@pytest.mark.parametrize(
    ("diameters", "shifts"), [([10, 10], [264, 528]), ([7.3] * 5, [100, 210, 333, 470, 900]), ([0, 0], [264, 528])]
)
def test_a_constant_diameter_has_no_f_number(diameters, shifts):
    """The slope of equal diameters is a rounding error, not 0; N was 2e16."""
    with pytest.raises(InputError, match="expected diameters that change with depth, got a constant diameter"):
        working_f_number(diameters, shifts, 5.5)
    # on both sides of the native plane, equal diameters determine N
    assert working_f_number([10, 10], [-264, 264], 5.5).value == pytest.approx(4.8)


def test_an_f_number_has_the_error_of_its_diameters():
    a = np.array([1000.0, 3000.0])
    diameters = a / 5.0 / 5.5
    assert math.isnan(working_f_number(diameters, a, 5.5).standard_error)
    # N = (a2 - a1)/(D2 - D1): of independent errors s, dN = sqrt(2) s N²/(a2 - a1)
    found = working_f_number(diameters, a, 5.5, [0.5, 0.5])
    assert found.standard_error == pytest.approx(math.sqrt(2) * 0.5 * 5.5 * 25 / 2000, rel=1e-6)
    with_scatter = working_f_number([40.0, 80.0, 100.0], [1000.0, 2000.0, 3000.0], 5.5, [1e-6] * 3)
    assert with_scatter.standard_error > 0.1
