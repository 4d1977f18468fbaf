"""Low-passed apertures and pixel rules."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from lfcal.base.errors import InputError
from lfcal.camera.lattice import cell_corners
from lfcal.simulate.engines import masks
from lfcal.simulate.engines._nodes import fitted_rule
from lfcal.simulate.engines._polygon import area, disc_transform, transform
from lfcal.simulate.engines.masks import (
    FLAT,
    MAX_TABLE,
    RING,
    disc_table,
    disc_values,
    fineness,
    polygon_mask,
    polygon_table,
)

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


def test_table_interpolates_the_function():
    table, step = disc_table(RADIUS, DX, 60.0)
    r = np.linspace(0, 59, 700)
    found = np.interp(r * r, step * np.arange(table.size), table)
    assert np.abs(found - disc_values(RADIUS, DX, r)).max() < 3e-4


@pytest.mark.parametrize(
    ("radius", "reach", "flat"), [(0.4, 5.0, 0.3), (3.3, 1.5, 0.4), (10.3, 20.0, 0.3), (60.2, 70.0, 0.4)]
)
def test_entries_of_the_table_are_the_function(radius, reach, flat):
    table, step = disc_table(radius, 1.0, reach, flat, fine=512)
    assert np.abs(table - disc_values(radius, 1.0, np.sqrt(step * np.arange(table.size)), flat)).max() < 4e-6


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


def test_node_matrix_spreads_a_flat_light_evenly():
    rule = fitted_rule(3, 1.9, fill=0.8)
    matrix = rule.matrix(7)
    assert matrix.shape == (rule.count(7), 7)
    assert matrix.sum(0) == pytest.approx(np.full(7, 0.8))
    assert rule.positions(7)[0] == -rule.positions(7)[-1]


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
    made = []
    own = masks.polygon_mask
    monkeypatch.setattr(masks, "polygon_mask", lambda *given, **named: made.append(given) or own(*given, **named))
    outline = turned_square(31.0, 0.017)
    first, step = polygon_table(outline, 1.5, 24.0)
    assert polygon_table(outline.copy(), 1.5, 24.0)[0] is first and len(made) == 1
    with pytest.raises(ValueError, match="read-only"):
        first[0, 0] = 1.0
    other, finer = polygon_table(outline, 1.2, 24.0)
    assert finer < step and other.shape != first.shape and len(made) == 2
    # one that takes much memory is not held
    monkeypatch.setattr(masks, "MAX_CACHED", 10)
    again = polygon_table(outline, 1.5, 24.0)[0]
    assert again is not first and np.array_equal(again, first) and len(made) == 3
