"""The lenslet lattice: types and periods, fill factors, and cells compared with a Voronoi diagram."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import Voronoi

from lfcal.base import InputError
from lfcal.camera import LatticeDistortion, LensletLattice, LensType, cell_corners
from lfcal.camera.lattice import cell_neighbours, cell_size

THREE = (LensType(1000.0), LensType(1100.0), LensType(1200.0))


def test_neighbours_differ_and_the_cell_repeats() -> None:
    q, r = (v.ravel() for v in np.meshgrid(np.arange(-9, 10), np.arange(-9, 10)))
    for step in (1, 2):
        for rotation in (0.0, 0.3, math.pi / 2, -2.0):
            lattice = LensletLattice("hexagonal", 31.7, 150.0, THREE, rotation, (3.0, -4.0), type_step=step)
            centres, types = lattice.centres_um(q, r), lattice.type_of(q, r)
            distance = np.hypot(*(centres[:, None] - centres[None]).transpose(2, 0, 1))
            near = (distance > 1e-6) & (distance < 1.01 * 31.7)
            assert near.sum(1).max() == 6 and not np.any(near & (types[:, None] == types[None]))
            assert lattice.type_of(0, 0) == 0 and lattice.type_of(1, 0) == step


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_the_period_maps_lenslets_onto_lenslets_of_their_type(kind: str) -> None:
    types = THREE if kind == "hexagonal" else THREE[:1]
    for turns in (0, 1, 2, -1):
        lattice = LensletLattice(kind, 30.0, 150.0, types, turns * math.pi / 2, (5.0, 2.0), row_pitch_um=27.0)
        centres, kinds = lattice.lenslets_within(400.0, 400.0)
        dy, dx = lattice.period_um
        inner = np.abs(centres).max(1) < 200
        for shift in ((dx, 0.0), (0.0, dy)):
            distance = np.hypot(*(centres[None] - (centres[inner] + shift)[:, None]).transpose(2, 0, 1))
            assert distance.min(1).max() < 1e-9
            assert np.array_equal(kinds[distance.argmin(1)], kinds[inner])
        assert lattice.quarter_turns == turns and abs(lattice.tilt_rad) < 1e-12


def test_no_smaller_rectangle_repeats_the_types() -> None:
    lattice = LensletLattice("hexagonal", 30.0, 150.0, THREE)
    centres, kinds = lattice.lenslets_within(300.0, 300.0)
    zero = centres[kinds == 0]
    dy, dx = lattice.period_um
    on_row = zero[np.abs(zero[:, 1]) < 1e-6][:, 0]
    on_column = zero[np.abs(zero[:, 0]) < 1e-6][:, 1]
    assert np.diff(np.sort(on_row)).min() == pytest.approx(dx)
    assert np.diff(np.sort(on_column)).min() == pytest.approx(dy)


def test_rotation_turns_from_right_to_down() -> None:
    basis = LensletLattice("square", 10.0, 50.0, THREE[:1], rotation_rad=0.1).basis_um()
    assert basis[0] == pytest.approx([10 * math.cos(0.1), 10 * math.sin(0.1)])
    assert basis[1] == pytest.approx([-10 * math.sin(0.1), 10 * math.cos(0.1)])


def test_lenslets_within_a_box_are_all_there() -> None:
    lattice = LensletLattice("hexagonal", 7.0, 50.0, THREE, 0.2, (1.0, 2.0))
    q, r = (v.ravel() for v in np.meshgrid(np.arange(-60, 61), np.arange(-60, 61)))
    every = lattice.centres_um(q, r)
    inside = (np.abs(every[:, 0] - 20) <= 50) & (np.abs(every[:, 1] + 10) <= 30)
    got, types = lattice.lenslets_within(50.0, 30.0, (20.0, -10.0))
    assert np.array_equal(np.sort(got, axis=0), np.sort(every[inside], axis=0))
    assert np.bincount(types).sum() == inside.sum()


BAD: dict[str, tuple[object, ...]] = {
    "kind": ("cubic", "square"),
    "pitch_um": (0.0, math.nan, "31"),
    "gap_um": (-1.0,),
    "types": (THREE[:2],),
    "offset_um": ((1.0,), (1.0, math.inf)),
    "clear_um": (400.0,),
    "row_pitch_um": (0.0, 1e-320, 1e5),
    "type_step": (0, 3),
    "rotation_rad": (math.inf,),
}


def test_bad_values_are_refused_in_one_line() -> None:
    for name, values in BAD.items():
        for value in values:
            with pytest.raises(InputError, match="expected") as caught:
                LensletLattice(**({"types": THREE} | {name: value}))
            assert "\n" not in str(caught.value), (name, value)


def test_focus_depth_inverts_focused_at() -> None:
    for v in (2.0, 5.0, -3.0, math.inf):
        assert LensType.focused_at(v, 870.0).focus_depth(870.0) == pytest.approx(v)
    for v in (0.0, 0.5, 1.0):  # between the lenslet and the sensor
        with pytest.raises(InputError, match="virtual depth in focus"):
            LensType.focused_at(v, 870.0)


def nearest_lenslet_um(lattice: LensletLattice, places: np.ndarray) -> np.ndarray:
    """Return the distance of places (x, y) to the lenslet nearest to each (µm)."""
    q, r = (v.ravel() for v in np.meshgrid(np.arange(-4, 5), np.arange(-4, 5)))
    centres = lattice.centres_um(q, r)
    return np.hypot(*(places[:, None] - centres[None]).transpose(2, 0, 1)).min(1)


@pytest.mark.few(2)
@pytest.mark.parametrize("kind", ["square", "hexagonal"])
@pytest.mark.parametrize("shear", [0.0, 0.15])
def test_lenslets_cover_what_lies_nearer_than_their_radius(kind: str, shear: float) -> None:
    for row, clear in (
        (None, None),
        (27.0, 25.0),
        (15.0, 30.0),
        (12.0, 33.0),
        (None, 36.0),
        (27.0, 45.0),
        (15.0, None),
    ):
        lattice = LensletLattice(kind, 30.0, 150.0, THREE[:1], clear_um=clear, row_pitch_um=row, shear_rad=shear)
        distance = nearest_lenslet_um(lattice, np.random.default_rng(1).random((20000, 2)) @ lattice.basis_um())
        across = math.inf if clear is None and kind == "square" else clear or 30.0
        assert lattice.fill_factor == pytest.approx((distance < across / 2).mean(), abs=0.01), (row, clear)
        assert lattice.gapless == (lattice.fill_factor == 1.0)
        assert lattice.cell_um[1] == pytest.approx(2 * distance.max(), rel=0.02)


def test_a_clear_diameter_from_corner_to_corner_leaves_no_gaps() -> None:
    for kind, diagonal, unstated in (("square", 183.8, 1.0), ("hexagonal", 150.1, math.pi / (2 * math.sqrt(3)))):
        plain, clear, round_one = (
            LensletLattice(kind, 130.0, 2600.0, THREE[:1], clear_um=c) for c in (None, diagonal, 130.0)
        )
        assert clear.gapless and clear.fill_factor == 1.0 and not round_one.gapless
        assert clear.edge_to_edge == (kind == "square")
        # squares that touch have one width, however they are stated
        assert clear.clear_diameter_um == pytest.approx(130.0 if kind == "square" else diagonal)
        assert plain.fill_factor == pytest.approx(unstated), "whole squares, or discs of the pitch"


def test_lenslets_without_gaps_stay_so_where_the_array_is_distorted() -> None:
    wider = LatticeDistortion("radial", (0.0, 0.0), 1000.0, ((60.0,),))
    lattice = LensletLattice("hexagonal", 30.0, 150.0, THREE[:1], clear_um=34.7, distortion=wider)
    there = lattice.local((800.0, 0.0))
    assert there.pitch_um > 1.05 * lattice.pitch_um and there.gapless


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_a_cell_is_what_lies_nearest_to_its_lenslet(kind: str) -> None:
    x, y = np.random.default_rng(0).uniform(-110, 110, (2, 4000))
    q, r = np.meshgrid(np.arange(-4, 5), np.arange(-4, 5))
    for row in (None, 95.0, 48.0):
        for turn, shear in ((0.0, 0.0), (0.3, 0.0), (0.3, 0.15), (0.0, -0.19)):
            lattice = LensletLattice(kind, 100.0, 500.0, THREE[:1], turn, row_pitch_um=row, shear_rad=shear)
            centres = np.stack([q.ravel(), r.ravel()], -1) @ lattice.basis_um()
            nearest = np.hypot(x[:, None] - centres[:, 0], y[:, None] - centres[:, 1]).argmin(1)
            assert np.array_equal(lattice.in_cell(x, y), nearest == len(centres) // 2)
            assert np.hypot(x, y)[lattice.in_cell(x, y)].max() <= lattice.cell_um[1] / 2 + 1e-9


def voronoi_corners(basis: np.ndarray) -> np.ndarray:
    steps = np.array([(i, j) for i in range(-9, 10) for j in range(-9, 10)])
    found = Voronoi(steps @ basis)
    return found.vertices[found.regions[found.point_region[len(steps) // 2]]]


def by_angle(corners: np.ndarray) -> np.ndarray:
    return corners[np.argsort(np.arctan2(corners[:, 1], corners[:, 0]))]


BASES = [
    [[30.0, 0.0], [15.0, 25.98]],
    [[30.0, 0.0], [17.0, 12.0]],
    [[28.0, 9.0], [-7.0, 31.0]],
    [[30.0, 0.0], [75.0, 25.0]],
    [[0.0, 30.0], [25.0, 3.0]],
    [[3e-7, 0.0], [1e-7, 2.5e-7]],
]


def test_cells_are_those_of_a_voronoi_diagram() -> None:
    for basis in BASES:
        found, wanted = cell_corners(basis), by_angle(voronoi_corners(np.array(basis)))
        assert np.allclose(by_angle(found), wanted, rtol=0, atol=1e-9 * np.abs(wanted).max())
        turn = np.diff(np.unwrap(np.arctan2(found[:, 1], found[:, 0])))
        assert (turn > 0).all() and len(cell_neighbours(basis)) == 3
        # each side is as far from the middle as its line
        middles, along = (wanted + np.roll(wanted, 1, 0)) / 2, wanted - np.roll(wanted, 1, 0)
        far = np.abs(along[:, 0] * middles[:, 1] - along[:, 1] * middles[:, 0]) / np.hypot(*along.T)
        sides, across = cell_size(*map(tuple, basis))
        assert np.sort(np.repeat(sides, 2)) == pytest.approx(np.sort(2 * far))
        assert across == pytest.approx(2 * np.hypot(*wanted.T).max())


def test_upright_cells_have_four_corners() -> None:
    for basis in ([[30.0, 0.0], [0.0, 25.0]], [[3.0, 4.0], [-8.0, 6.0]], [[30.0, 0.0], [15.0, 15.0]]):
        corners = cell_corners(basis)
        assert len(corners) == 4 and np.allclose(corners + np.roll(corners, 2, axis=0), 0)
        assert np.linalg.det(np.diff(corners, axis=0)[:2]) == pytest.approx(abs(np.linalg.det(basis)))
    for size in (1e-300, 1e-200, 1.0, 1.7e308):
        corners = cell_corners(size * np.array([[1.0, 0.0], [0.5, 0.9]]))
        assert np.hypot(*(corners / size).T) == pytest.approx((0.9**2 + 0.25) / (2 * 0.9))


def test_the_size_of_a_cell_is_computed_once() -> None:
    lattice = LensletLattice("hexagonal", 31.25, 300.0, (LensType(600.0),), shear_rad=0.0123)
    turned = replace(lattice, rotation_rad=0.4)
    cell_size.cache_clear()
    assert lattice.cell_um == turned.cell_um and lattice.fill_factor == turned.fill_factor
    assert cell_size.cache_info().misses == 1
