"""Cells are the Voronoi cells of any lattice, however its vectors are chosen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import Voronoi

from lfcal.camera import LensletLattice, LensType
from lfcal.camera.cell import cell_corners, cell_neighbours, cell_size


def voronoi_corners(basis: np.ndarray) -> np.ndarray:
    steps = np.array([(i, j) for i in range(-9, 10) for j in range(-9, 10)])
    found = Voronoi(steps @ basis)
    return found.vertices[found.regions[found.point_region[len(steps) // 2]]]


def by_angle(corners: np.ndarray) -> np.ndarray:
    return corners[np.argsort(np.arctan2(corners[:, 1], corners[:, 0]))]


@pytest.mark.parametrize(
    "basis",
    [
        [[30.0, 0.0], [15.0, 25.98]],
        [[30.0, 0.0], [17.0, 12.0]],
        [[28.0, 9.0], [-7.0, 31.0]],
        [[30.0, 0.0], [75.0, 25.0]],
        [[0.0, 30.0], [25.0, 3.0]],
        [[3e-7, 0.0], [1e-7, 2.5e-7]],
    ],
)
def test_cells_are_those_of_a_voronoi_diagram(basis: list[list[float]]) -> None:
    found, wanted = cell_corners(basis), voronoi_corners(np.array(basis))
    assert np.allclose(by_angle(found), by_angle(wanted), rtol=0, atol=1e-9 * np.abs(wanted).max())
    turn = np.diff(np.unwrap(np.arctan2(found[:, 1], found[:, 0])))
    assert (turn > 0).all() and len(cell_neighbours(basis)) == 3


@pytest.mark.parametrize("basis", [[[30.0, 0.0], [0.0, 25.0]], [[3.0, 4.0], [-8.0, 6.0]], [[30.0, 0.0], [15.0, 15.0]]])
def test_upright_cells_have_four_corners(basis: list[list[float]]) -> None:
    corners = cell_corners(basis)
    assert len(corners) == 4 and np.allclose(corners + np.roll(corners, 2, axis=0), 0)
    assert np.linalg.det(np.diff(corners, axis=0)[:2]) == pytest.approx(abs(np.linalg.det(basis)))


@pytest.mark.parametrize("size", [1e-300, 1e-200, 1.0, 1.7e308])
def test_no_size_is_too_large_or_too_small(size: float) -> None:
    corners = cell_corners(size * np.array([[1.0, 0.0], [0.5, 0.9]]))
    assert np.hypot(*(corners / size).T) == pytest.approx((0.9**2 + 0.25) / (2 * 0.9))


def test_sizes_are_those_of_the_voronoi_cell() -> None:
    a, b = (30.0, 0.0), (17.0, 12.0)
    corners = by_angle(voronoi_corners(np.array([a, b])))
    middles = (corners + np.roll(corners, 1, axis=0)) / 2
    along = corners - np.roll(corners, 1, axis=0)
    # each side is as far from the middle as its line
    far = np.abs(along[:, 0] * middles[:, 1] - along[:, 1] * middles[:, 0]) / np.hypot(*along.T)
    sides, across = cell_size(a, b)
    assert np.sort(np.repeat(sides, 2)) == pytest.approx(np.sort(2 * far))
    assert across == pytest.approx(2 * np.hypot(*corners.T).max())


def test_the_size_of_a_cell_is_worked_out_once() -> None:
    lattice = LensletLattice("hexagonal", 31.25, 300.0, (LensType(600.0),), shear_rad=0.0123)
    turned = replace(lattice, rotation_rad=0.4)
    cell_size.cache_clear()
    assert lattice.cell_um == turned.cell_um and lattice.fill_factor == turned.fill_factor
    assert cell_size.cache_info().misses == 1
