"""Apertures: the iris as a polygon and its transform, low-passed masks of lenslets, and the nodes of pixels."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from lfcal.base import InputError
from lfcal.camera import cell_corners
from lfcal.simulate.engines import MAX_TABLE, RING, fineness, masks
from lfcal.simulate.engines._nodes import WindowNodes, fitted_rule
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
from lfcal.simulate.engines._separable import pixel_sums
from lfcal.simulate.engines.masks import FLAT, disc_table, disc_values, polygon_mask, polygon_table
from lfcal.simulate.scene import PupilIris


def test_every_iris_has_the_area_of_the_disc():
    for iris in (PupilIris(), PupilIris(5), PupilIris(9, 0.3, 0.1), PupilIris(6, 0.9, 1.0), PupilIris(7, 1.0)):
        assert area(iris_outline(iris)) == pytest.approx(math.pi, rel=1e-12)
    outline = iris_outline(PupilIris(9, 0.0, 0.25))
    assert len(outline) == 9 and math.atan2(outline[0, 1], outline[0, 0]) == pytest.approx(0.25)


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


def test_clipped_squares_and_a_second_stop_have_their_areas():
    square = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    assert area(clip(square, square + np.array([0.5, 1.25]))) == pytest.approx(1.5 * 0.75)
    assert len(clip(square, square + np.array([3.0, 0.0]))) == 0
    assert area(clip(square * 0.3, square)) == pytest.approx(0.36)
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
    """The stop of a narrow barrel is small and off the axis: frequencies of a whole grid are near zero for it."""
    outline = regular(7, 0.4) * radius + np.array([offset, -offset / 3])
    f = np.array([-900.0, -3.0, -0.02, -1e-9, -1e-160, 0.0, 1e-14, 1e-5, 0.4, 7.0, 1e5])
    x, y = f[None, :] + np.zeros((f.size, 1)), f[:, None] + np.zeros(f.size)
    found = spectrum(outline, f, f)
    phase = (
        4e-16 * 2 * np.pi * offset * (np.abs(x) + np.abs(y))
    )  # the rounding error of the phase of a pupil off the axis
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


def test_rows_that_mirror_each_other_are_what_they_are_alone():
    outline = regular(7, 0.3) * 4 + np.array([3.0, -2.0])
    for n in (3, 4, 9, 64):
        for f in (np.fft.fftfreq(n, 1.3), 0.1 * (np.arange(n) - n // 2), 0.1 * np.arange(n) - 0.03):
            # an equal axis that is another array is not looked at
            assert np.array_equal(spectrum(outline, f, f), spectrum(outline, f, f.copy()))


RADIUS, DX = 40.0, 2.75


def grid(centre, dx=DX, radius=RADIUS):
    half = math.ceil(radius / dx) + RING
    x = np.arange(-half, half + 1) * dx
    return x[None, :] - centre[0], x[:, None] - centre[1]


@pytest.mark.parametrize("centre", [(0.0, 0.0), (1.3, -0.7), (0.5 * DX, 0.5 * DX)])
def test_low_passed_disc_integrates_band_limited_waves(centre):
    x, y = grid(centre)
    table, step = disc_table(RADIUS, DX, float(np.hypot(x, y).max()))
    mask = np.interp(x**2 + y**2, step * np.arange(table.size), table)
    hard = (np.hypot(x, y) <= RADIUS).astype(float)
    for f in (0.0, 0.5 * FLAT / DX, 0.9 * FLAT / DX):
        wave, wanted = np.exp(2j * np.pi * f * x) * np.ones_like(y), disc_transform(RADIUS, f)
        error = abs((mask * wave).sum() * DX**2 - wanted) / (math.pi * RADIUS**2)
        assert error < 2e-4
        if f == 0:
            assert error < 1e-4 < abs(hard.sum() * DX**2 - wanted) / wanted


def test_tables_of_discs_are_the_function_at_their_entries_and_between():
    table, step = disc_table(RADIUS, DX, 60.0)
    r = np.linspace(0, 59, 700)
    found = np.interp(r * r, step * np.arange(table.size), table)
    assert np.abs(found - disc_values(RADIUS, DX, r)).max() < 3e-4
    for radius, reach, flat in ((0.4, 5.0, 0.3), (3.3, 1.5, 0.4), (10.3, 20.0, 0.3), (60.2, 70.0, 0.4)):
        table, step = disc_table(radius, 1.0, reach, flat, fine=512)
        wanted = disc_values(radius, 1.0, np.sqrt(step * np.arange(table.size)), flat)
        assert np.abs(table - wanted).max() < 4e-6, radius


def turned_square(side: float, turn: float) -> np.ndarray:
    """Return the corners of a square about the origin."""
    c, s = side * math.cos(turn), side * math.sin(turn)
    return cell_corners([[c, s], [-s, c]])


@pytest.mark.parametrize("hexagonal", [False, True])
def test_cells_tile_the_plane_and_their_masks_sum_to_one(hexagonal):
    pitch, row = 30.0, 30.0 * (math.sqrt(3) / 2 if hexagonal else 1.0)
    outline = cell_corners([[pitch, 0.0], [pitch / 2 if hexagonal else 0.0, row]])
    assert area(outline) == pytest.approx(pitch * row)
    n, dx = 129, 1.5
    total = np.zeros((n, n))
    for r in range(-2, 3):
        for q in range(-3, 4):
            place = ((q + (r % 2) / 2 if hexagonal else q) * pitch, r * row)
            if max(np.abs(place)) < 70:
                total += polygon_mask(outline, dx, place, n)
    middle = total[52:77, 52:77]
    assert np.abs(middle - 1).max() < 2e-2
    assert abs(middle.mean() - 1) < 1e-3


def test_fine_polygon_table_is_the_mask_between_its_samples():
    outline = turned_square(30.0, 0.2)
    table, step = polygon_table(outline, 2.0, 26.0)
    mask = polygon_mask(outline, 2.0, (0.5, -0.25), 21)
    middle, ratio = table.shape[0] // 2, round(2.0 / step)
    rows = middle + (np.arange(21) - 10) * ratio + round(0.25 / step)
    columns = middle + (np.arange(21) - 10) * ratio - round(0.5 / step)
    assert np.abs(table[np.ix_(rows, columns)] - mask).max() < 3e-4
    f = 0.4 * FLAT / 2.0
    x = (np.arange(21) - 10) * 2.0
    seen = (mask * np.exp(-2j * np.pi * f * x)[None, :]).sum() * 4.0
    wanted = transform(outline, f, 0.0) * np.exp(-2j * np.pi * f * 0.5)
    assert abs(seen - wanted) < 3e-3 * area(outline)


@pytest.mark.parametrize("per_px", [2, 3, 4, 5])
def test_fitted_nodes_beat_gauss_legendre_inside_the_pixel(per_px):
    band = 1.96  # a lenslet of 31 px at f/5, in focus
    rule = fitted_rule(per_px, band)
    f = np.linspace(0, band, 300)
    otf = 2 / np.pi * (np.arccos(f / band) - f / band * np.sqrt(1 - (f / band) ** 2))

    def error(x, w):
        found = (np.cos(2 * np.pi * np.outer(f, x)) * w).sum(1)
        return math.sqrt((((found - np.sinc(f)) * otf) ** 2 * f).sum() / ((np.sinc(f) * otf) ** 2 * f).sum())

    x, w = np.polynomial.legendre.leggauss(per_px)
    own = (np.arange(rule.weights.size) - (rule.weights.size - 1) / 2) / per_px
    assert error(own, rule.weights) < error(x / 2, w / 2)
    assert (rule.weights >= 0).all()
    assert rule.weights.sum() == pytest.approx(1.0, rel=1e-14)


def edge_error(half: int, fine: int) -> float:
    """Return how far a square cell of ``2 half`` samples, by its table between samples, is from its mask (over both).

    The cell is turned, and a wave of half the exact band is summed over it, at places between the table's samples.
    """
    dx, f = 1.0, 0.5 * FLAT
    outline = turned_square(2.0 * half, 0.2)
    table, step = polygon_table(outline, dx, 1.3 * half, fine)
    x = np.arange(-math.ceil(1.25 * half), math.ceil(1.25 * half) + 1) * dx
    wrong = []
    for shift in (0.03, 0.11, 0.47):
        at = np.stack(np.meshgrid((x + shift) / step, (x + shift) / step, indexing="ij")) + table.shape[0] // 2
        mask = map_coordinates(table, at, order=1)
        wave = np.exp(-2j * np.pi * f * (x + shift))
        wrong.append(abs((mask * wave[None, :]).sum() * dx**2 - transform(outline, f, 0.0)) / area(outline))
    return max(wrong)


@pytest.mark.long
def test_a_larger_cell_needs_no_finer_table():
    assert fineness(20.0) == 16 == fineness(40.0)
    assert fineness(363.0) <= 6
    fine = edge_error(25, 16)
    assert edge_error(200, fineness(260.0)) < fine < 2e-4
    assert edge_error(25, 2) > 5 * fine


def test_tables_of_cells_have_a_size_that_memory_holds():
    # cells of 126 µm on samples of 0.25 µm: 16632 a side with a fineness fixed at 16, 4 GB
    assert 2 * 363 * math.sqrt(2) * fineness(363 * math.sqrt(2)) < MAX_TABLE
    with pytest.raises(InputError, match=r"sampled transmission of a lenslet.*at most 6000 samples on each side"):
        polygon_table(turned_square(30.0, 0.2), 0.01, 21.0)


def test_a_table_is_made_once_for_all_planes_of_a_lattice(monkeypatch):
    outline = turned_square(31.0, 0.017)
    first, step = polygon_table(outline, 1.5, 24.0)
    assert polygon_table(outline.copy(), 1.5, 24.0)[0] is first and not first.flags.writeable
    other, finer = polygon_table(outline, 1.2, 24.0)
    assert finer < step and other.shape != first.shape
    monkeypatch.setattr(masks, "MAX_CACHED", 10)  # a table that takes much memory is not kept
    again = polygon_table(outline, 1.5, 24.0)[0]
    assert again is not first and np.array_equal(again, first)


@pytest.mark.parametrize(("pixels", "middle"), [(11, 5), (11, 4), (11, 11), (12, 20), (9, 0)])
def test_pixels_take_the_light_at_their_own_nodes(pixels: int, middle: int) -> None:
    """A wave within the band has a known integral over each pixel, also from half the nodes outside the middle."""
    fine, coarse = fitted_rule(4, 1.5, 0.9), fitted_rule(2, 1.5, 0.9)
    nodes = WindowNodes.of(fine, coarse, pixels, middle)
    half = min(pixels, middle + (pixels - middle) % 2) / 2
    centres = np.arange(pixels) - (pixels - 1) / 2
    places, weights = nodes.pixels()
    for f, phase in ((0.0, 0.0), (0.3, 0.4), (0.6, 1.1)):
        wanted = 0.9 * np.sinc(0.9 * f) * np.cos(2 * np.pi * f * centres + phase)
        seen = np.cos(2 * np.pi * f * nodes.positions + phase)
        by_node = np.zeros(pixels)
        for at, weight, light in zip(places, weights, seen, strict=True):
            np.add.at(by_node, at[at >= 0], weight[at >= 0] * light)
        assert np.abs(by_node - wanted).max() < 5e-3
        by_runs = np.empty((1, pixels), np.float32)
        pixel_sums(seen[None].astype(np.float32), nodes.runs, nodes.weights, by_runs)
        assert np.abs(by_runs[0] - by_node).max() < 1e-6
    inside = np.count_nonzero(np.abs(nodes.positions) < half)
    assert inside >= 4 * 2 * half
    assert nodes.positions.size <= 4 * 2 * half + 2 * (pixels - 2 * half) + 6
