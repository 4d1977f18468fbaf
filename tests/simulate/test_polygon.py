"""The iris as a polygon."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from lfcal.simulate.engines._polygon import (
    area,
    clip,
    disc_transform,
    half_planes,
    iris_outline,
    regular,
    spectrum,
    transform,
)
from lfcal.simulate.scene import PupilIris


@pytest.mark.parametrize(
    "iris", [PupilIris(), PupilIris(5), PupilIris(9, 0.3, 0.1), PupilIris(6, 0.9, 1.0), PupilIris(7, 1.0)]
)
def test_every_iris_has_the_area_of_the_disc(iris):
    assert area(iris_outline(iris)) == pytest.approx(math.pi, rel=1e-12)


def test_straight_blades_are_a_polygon_with_its_first_vertex_at_the_rotation():
    outline = iris_outline(PupilIris(9, 0.0, 0.25))
    assert len(outline) == 9
    assert math.atan2(outline[0, 1], outline[0, 0]) == pytest.approx(0.25)


def test_curvature_goes_from_polygon_to_circle():
    def roundness(iris):
        r = np.hypot(*iris_outline(iris).T)
        return r.min() / r.max()

    values = [roundness(PupilIris(6, k, 0.3)) for k in (0.05, 0.3, 0.6, 0.9, 0.99)]
    assert all(a < b for a, b in itertools.pairwise(values))
    assert values[0] < math.cos(math.pi / 6) + 0.02
    assert values[-1] > 0.998


@pytest.mark.parametrize("curvature", [0.2, 0.5, 0.8])
def test_blade_radius_is_the_apothem_over_the_curvature(curvature):
    outline = iris_outline(PupilIris(8, curvature, 0.0), sagitta=1e-5)
    normal, offset = half_planes(outline)
    turned = np.array([math.cos(math.pi / 8), math.sin(math.pi / 8)])
    apothem = (outline @ turned).max()
    # three vertices of the first blade give its circle
    angle = np.arctan2(outline[:, 1], outline[:, 0])
    blade = outline[(angle > 0.02) & (angle < math.pi / 4 - 0.02)]
    a, b, c = blade[0], blade[len(blade) // 2], blade[-1]
    sides = [np.hypot(*(p - q)) for p, q in ((a, b), (b, c), (c, a))]
    radius = math.prod(sides) / (4 * abs(area(np.array([a, b, c]))))
    assert apothem / radius == pytest.approx(curvature, rel=2e-3)
    assert (np.abs(np.hypot(*normal.T) - 1) < 1e-12).all()
    assert (offset > 0).all()


def test_clip_of_overlapping_squares():
    square = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    assert area(clip(square, square + np.array([0.5, 1.25]))) == pytest.approx(1.5 * 0.75)
    assert len(clip(square, square + np.array([3.0, 0.0]))) == 0
    assert area(clip(square * 0.3, square)) == pytest.approx(0.36)


def test_second_stop_takes_a_lens_out_of_the_pupil():
    offset = 0.8
    wanted = 2 * math.acos(offset / 2) - offset / 2 * math.sqrt(4 - offset**2)  # two unit circles
    assert area(iris_outline(PupilIris(stop=(offset, 0.0, 1.0)))) == pytest.approx(wanted, rel=1e-3)
    assert len(iris_outline(PupilIris(9, stop=(5.0, 0.0, 1.0)))) == 0


def test_disc_transform_is_the_limit_of_polygons():
    f = np.array([0.0, 1e-9, 0.1, 0.7, 2.3])
    many = transform(regular(4000), f, np.zeros(5)).real
    assert np.abs(disc_transform(1.0, f) - many).max() < 1e-5
    assert disc_transform(1.0, 0.0) == pytest.approx(math.pi, rel=1e-15)


@pytest.mark.parametrize("offset", [0.0, 0.3, 40.0])
@pytest.mark.parametrize("radius", [1.0, 1e-3])
def test_grid_and_points_have_one_transform_at_any_frequency(offset, radius):
    """The stop of a narrow barrel is small and aside: frequencies of a whole grid are near zero for it."""
    outline = regular(7, 0.4) * radius + np.array([offset, -offset / 3])
    f = np.array([-900.0, -3.0, -0.02, -1e-9, -1e-160, 0.0, 1e-14, 1e-5, 0.4, 7.0, 1e5])
    x, y = f[None, :] + np.zeros((f.size, 1)), f[:, None] + np.zeros(f.size)
    found = spectrum(outline, f, f)
    phase = 4e-16 * 2 * np.pi * offset * (np.abs(x) + np.abs(y))  # what the phase of a pupil aside is rounded to
    assert (np.abs(found - transform(outline, x, y)) <= (1e-14 + phase) * area(outline)).all()
    wanted = np.array([[by_quadrature(outline, a, b) for a in f[1:10]] for b in f[1:10]])
    assert (np.abs(found[1:10, 1:10] - wanted) <= (1e-14 + phase[1:10, 1:10]) * area(outline)).all()


def by_quadrature(outline, fx, fy):
    """Integrate exp(-2 pi i f.x) over triangles about the first vertex, by Gauss-Legendre."""
    t, w = np.polynomial.legendre.leggauss(60)
    u, v = np.meshgrid((t + 1) / 2, (t + 1) / 2, indexing="ij")
    weight = np.outer(w, w) / 4 * u
    total = 0j
    for p, q in itertools.pairwise(outline[1:]):
        e, g = p - outline[0], q - outline[0]
        x, y = (outline[0, i] + u * (e[i] * (1 - v) + g[i] * v) for i in (0, 1))
        total += (e[0] * g[1] - e[1] * g[0]) * (weight * np.exp(-2j * np.pi * (fx * x + fy * y))).sum()
    return total


@pytest.mark.parametrize("n", [3, 4, 9, 64])
def test_rows_that_mirror_each_other_are_what_they_are_by_themselves(n):
    outline = regular(7, 0.3) * 4 + np.array([3.0, -2.0])
    for f in (np.fft.fftfreq(n, 1.3), 0.1 * (np.arange(n) - n // 2), 0.1 * np.arange(n) - 0.03):
        # an equal axis that is another array is not looked at
        assert np.array_equal(spectrum(outline, f, f), spectrum(outline, f, f.copy()))
