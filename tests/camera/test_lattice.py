from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import Voronoi

from lfcal.base.errors import InputError
from lfcal.camera import LensletLattice, LensType
from lfcal.camera.distortion import LatticeDistortion
from lfcal.camera.lattice import cell_corners, cell_neighbours, cell_size

THREE = (LensType(1000.0), LensType(1100.0), LensType(1200.0))


@pytest.mark.parametrize("step", [1, 2])
@pytest.mark.parametrize("rotation", [0.0, 0.3, math.pi / 2, -2.0])
def test_neighbours_differ_and_the_cell_repeats(step: int, rotation: float) -> None:
    lattice = LensletLattice("hexagonal", 31.7, 150.0, THREE, rotation, (3.0, -4.0), type_step=step)
    q, r = (v.ravel() for v in np.meshgrid(np.arange(-9, 10), np.arange(-9, 10)))
    centres, types = lattice.centres_um(q, r), lattice.type_of(q, r)
    distance = np.hypot(*(centres[:, None] - centres[None]).transpose(2, 0, 1))
    near = (distance > 1e-6) & (distance < 1.01 * 31.7)
    assert near.sum(1).max() == 6
    assert not np.any(near & (types[:, None] == types[None]))
    assert lattice.type_of(0, 0) == 0 and lattice.type_of(1, 0) == step


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
@pytest.mark.parametrize("turns", [0, 1, 2, -1])
def test_the_period_maps_lenslets_onto_lenslets_of_their_type(kind: str, turns: int) -> None:
    types = THREE if kind == "hexagonal" else THREE[:1]
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


@pytest.mark.parametrize(
    "values",
    [
        {"kind": "cubic"},
        {"pitch_um": 0.0},
        {"pitch_um": math.nan},
        {"pitch_um": "31"},
        {"gap_um": -1.0},
        {"types": THREE[:2]},
        {"kind": "square", "types": THREE},
        {"offset_um": (1.0,)},
        {"offset_um": (1.0, math.inf)},
        {"clear_um": 400.0},
        {"row_pitch_um": 0.0},
        {"row_pitch_um": 1e-320},
        {"row_pitch_um": 1e5},
        {"type_step": 0},
        {"type_step": 3},
        {"rotation_rad": math.inf},
    ],
)
def test_bad_values_are_refused_in_one_line(values: dict[str, object]) -> None:
    with pytest.raises(InputError) as caught:
        LensletLattice(**values)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value) and "expected" in str(caught.value)


@pytest.mark.parametrize("v", [2.0, 5.0, -3.0, math.inf])
def test_focus_depth_inverts_focused_at(v: float) -> None:
    assert LensType.focused_at(v, 870.0).focus_depth(870.0) == pytest.approx(v)


@pytest.mark.parametrize("v", [0.0, 0.5, 1.0])
def test_no_lenslet_focuses_between_itself_and_the_sensor(v: float) -> None:
    with pytest.raises(InputError, match="virtual depth in focus"):
        LensType.focused_at(v, 870.0)


def nearest_lenslet_um(lattice: LensletLattice, places: np.ndarray) -> np.ndarray:
    """Return the distance of places (x, y) to the lenslet nearest to each (µm)."""
    q, r = (v.ravel() for v in np.meshgrid(np.arange(-4, 5), np.arange(-4, 5)))
    centres = lattice.centres_um(q, r)
    return np.hypot(*(places[:, None] - centres[None]).transpose(2, 0, 1)).min(1)


@pytest.mark.few(16)
@pytest.mark.parametrize("clear", [None, 25.0, 30.0, 33.0, 36.0, 45.0])
@pytest.mark.parametrize("row", [None, 27.0, 15.0, 12.0])
@pytest.mark.parametrize("kind", ["square", "hexagonal"])
@pytest.mark.parametrize("shear", [0.0, 0.15])
def test_lenslets_cover_what_lies_nearer_than_their_radius(
    kind: str, row: float | None, clear: float | None, shear: float
) -> None:
    lattice = LensletLattice(kind, 30.0, 150.0, THREE[:1], clear_um=clear, row_pitch_um=row, shear_rad=shear)
    places = np.random.default_rng(1).random((20000, 2)) @ lattice.basis_um()
    distance = nearest_lenslet_um(lattice, places)
    across = math.inf if clear is None and kind == "square" else clear or 30.0
    assert lattice.fill_factor == pytest.approx((distance < across / 2).mean(), abs=0.01)
    assert lattice.gapless == (lattice.fill_factor == 1.0)
    assert lattice.cell_um[1] == pytest.approx(2 * distance.max(), rel=0.02)


@pytest.mark.parametrize(("kind", "diagonal"), [("square", 183.8), ("hexagonal", 150.1)])
def test_a_clear_diameter_from_corner_to_corner_leaves_no_gaps(kind: str, diagonal: float) -> None:
    lattice = LensletLattice(kind, 130.0, 2600.0, THREE[:1], clear_um=diagonal)
    assert lattice.gapless and lattice.fill_factor == 1.0
    assert lattice.edge_to_edge == (kind == "square")
    # squares that touch have one width, however they are stated
    assert lattice.clear_diameter_um == pytest.approx(130.0 if kind == "square" else diagonal)
    assert not LensletLattice(kind, 130.0, 2600.0, THREE[:1], clear_um=130.0).gapless


def test_unstated_lenslets_are_whole_squares_or_discs_of_the_pitch() -> None:
    square, hexagonal = (LensletLattice(kind, 130.0, 2600.0, THREE[:1]) for kind in ("square", "hexagonal"))
    assert square.fill_factor == 1.0
    assert hexagonal.fill_factor == pytest.approx(math.pi / (2 * math.sqrt(3)))


def test_lenslets_without_gaps_stay_so_where_the_array_is_distorted() -> None:
    wider = LatticeDistortion("radial", (0.0, 0.0), 1000.0, ((60.0,),))
    lattice = LensletLattice("hexagonal", 30.0, 150.0, THREE[:1], clear_um=34.7, distortion=wider)
    there = lattice.local((800.0, 0.0))
    assert there.pitch_um > 1.05 * lattice.pitch_um and there.gapless


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
@pytest.mark.parametrize("row", [None, 95.0, 48.0])
@pytest.mark.parametrize(("turn", "shear"), [(0.0, 0.0), (0.3, 0.0), (0.3, 0.15), (0.0, -0.19)])
def test_a_cell_is_what_lies_nearest_to_its_lenslet(kind: str, row: float | None, turn: float, shear: float) -> None:
    lattice = LensletLattice(
        kind, 100.0, 500.0, (LensType(500.0),), rotation_rad=turn, row_pitch_um=row, shear_rad=shear
    )
    x, y = np.random.default_rng(0).uniform(-110, 110, (2, 4000))
    q, r = np.meshgrid(np.arange(-4, 5), np.arange(-4, 5))
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
