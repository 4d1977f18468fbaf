"""The measuring parts against brute force and closed forms."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import preset
from lfcal.judge.quality import _lattice as lattice
from lfcal.judge.quality import _sums as sums
from lfcal.judge.quality import inspect, periodicity
from lfcal.judge.quality._dark import dark_corners
from lfcal.judge.quality._field import split
from lfcal.judge.quality._kernels import FRAME_COLUMNS, spot_pass, step_pass
from lfcal.judge.quality._steps import odd_frames, seam_ratio
from lfcal.judge.quality.pattern_table import PatternTable
from lfcal.psf import PSFMatrix

from .faults import base
from .scenes import Scene, hexagonal, recorded, square

RNG = np.random.default_rng(11)
START = RNG.bit_generator.state


@pytest.fixture(autouse=True)
def same_numbers() -> None:
    """Each test has the same numbers in any order of the tests."""
    RNG.bit_generator.state = START


def test_the_table_of_patterns_equals_numpy():
    plane = RNG.normal(0, 1, (3, 4, 15, 17)).astype(np.float32)
    plane[1, 2, 4:8, 5:9] += 60
    plane[0, 0, 3, 3] = np.nan
    dark = dark_corners(plane)
    frames = PatternTable.of(plane, dark, 1)
    lit = np.where(np.isfinite(plane) & (plane > frames.floor), plane - frames.floor, 0).astype(float)
    t, s = np.meshgrid(np.arange(15) - 7, np.arange(17) - 8, indexing="ij")
    known = {
        "energy": np.nansum(plane, axis=(2, 3), dtype=float),
        "squares": np.nansum(plane.astype(float) ** 2, axis=(2, 3)),
        "top": np.nanmax(plane, axis=(2, 3)),
        "nonfinite": np.isnan(plane).sum((2, 3)),
        "lit": (lit > 0).sum((2, 3)),
        "weight": lit.sum((2, 3)),
        "spread": ((lit > 0) * (t**2 + s**2)).sum((2, 3)),
    }
    for name, values in known.items():
        assert np.allclose(frames.column(name), values, rtol=1e-5), name
    assert frames.column("row")[1, 2] == pytest.approx((lit[1, 2] * t).sum() / lit[1, 2].sum())
    assert frames.column("column")[1, 2] == pytest.approx((lit[1, 2] * s).sum() / lit[1, 2].sum())
    assert np.array_equal(frames.lit, (lit > 0).sum((0, 1)))
    sensor = np.zeros((15 + 2, 17 + 3), int)
    for y, x in np.ndindex(3, 4):
        sensor[y : y + 15, x : x + 17] += lit[y, x] > 0
    assert np.array_equal(frames.sensor, sensor)
    assert set(FRAME_COLUMNS) >= set(known)
    plane = RNG.normal(0, 1, (2, 3, 9, 9)).astype(np.float32)
    plane[1, 2] = plane[0, 1]
    digest = PatternTable.of(plane, dark_corners(plane)).digest
    assert digest[1, 2] == digest[0, 1] and len(np.unique(digest)) == 5, "equal patterns have equal checksums"


def test_sums_against_waves_equal_the_fourier_transform():
    frames = RNG.random((2, 7, 9)).astype(np.float32)
    waves = np.array([[0.3, -0.8], [1.1, 0.2]])
    s, t = np.arange(9) - 4, np.arange(7) - 3
    out = np.empty((2, 2), complex)
    spot_pass(
        frames,
        0.0,
        np.exp(-1j * s[:, None] * waves[:, 0]),
        np.exp(-1j * t[:, None] * waves[:, 1]),
        out,
        np.empty_like(out[0]),
    )
    kernel = np.exp(-1j * (waves[:, 0, None, None] * s + waves[:, 1, None, None] * t[:, None]))
    assert np.allclose(out, np.einsum("nts,qts->nq", frames, kernel))


@pytest.mark.parametrize(("rows", "columns"), [(1, 0), (0, 1)])
def test_a_step_compares_what_the_lenslets_keep_in_place(rows, columns):
    sensor = RNG.random((21, 22)).astype(np.float32)
    a, b = sensor[:20, :20], sensor[rows : rows + 20, columns : columns + 20]
    out = np.empty(3)
    step_pass(np.ascontiguousarray(a), np.ascontiguousarray(b), rows, columns, out)
    assert out[0] == out[1] == out[2] == pytest.approx(float((a[rows:, columns:].astype(float) ** 2).sum()), rel=1e-5)
    step_pass(np.ascontiguousarray(b), np.ascontiguousarray(a), rows, columns, out)  # the wrong way round
    assert out[2] < 0.9 * out[0]


def test_a_field_splits_into_ramp_ripple_and_residual():
    y, x = np.meshgrid(np.arange(19), np.arange(33), indexing="ij")
    ripple = 0.4 * np.cos(2 * np.pi * (2 * x / 33 - y / 19))
    noise = RNG.normal(0, 0.05, y.shape)
    parts = split(3 + ripple + 1.5 * (x + 0.5) / 33 - 0.7 * (y + 0.5) / 19 + noise)
    assert parts.ramp == pytest.approx((-0.7, 1.5), abs=0.06)
    assert np.abs(parts.ripple - ripple).max() < 0.08
    assert parts.rms == pytest.approx(0.05, rel=0.12)
    assert parts.sure_ramp(1) == pytest.approx(1.5, abs=0.06)
    ramps = [split(np.random.default_rng(k).normal(0, 1, (15, 15))).sure_ramp(0) for k in range(20)]
    assert np.mean(np.array(ramps) > 0) < 0.25, "chance makes no sure ramp"
    field = np.where(np.arange(19)[:, None] % 2, 0.4, -0.4) + np.zeros((19, 33))
    assert split(field).alternation == pytest.approx(0.4, rel=0.05)


def test_outliers_and_holes_do_not_pull_the_fit():
    field = RNG.normal(0, 0.1, (19, 33))
    field[4, :3] = 50
    use = np.ones(field.shape, bool)
    use[10:12] = False
    field[10:12] = 1e6
    parts = split(field, use)
    assert parts.residual[4, 0] > 49 and np.isnan(parts.residual[10]).all()
    assert parts.spread == pytest.approx(0.1, rel=0.2)
    assert max(map(abs, parts.ramp)) < 0.1


def test_wave_vectors_are_those_of_the_camera_or_of_the_period():
    camera = preset("r29")
    known = lattice.wave_vectors(camera, (55, 95))
    assert known.shape == (3, 2)
    assert np.hypot(*known.T) == pytest.approx([2 * math.pi / (31.7 * math.sqrt(3) / 2)] * 3)
    assert lattice.wave_vectors(None, (55, 95)) == pytest.approx(known, rel=0.01)
    assert lattice.wave_vectors(None, (15, 15)) == pytest.approx(2 * math.pi / 15 * np.eye(2))


def test_spacing_and_order_of_the_spots_are_found():
    scene = square()
    plane = recorded(scene.planes[:1], 0, 3.0)[0]
    waves = lattice.wave_vectors(scene.camera, scene.period)
    use = np.ones(scene.period, bool)
    for turned, order in (
        (plane, "as planned"),
        (plane[:, ::-1], "x reversed"),
        (plane[::-1], "y reversed"),
        (plane.transpose(1, 0, 2, 3), "axes swapped"),
    ):
        spots = lattice.find_spots(np.ascontiguousarray(turned), use, 12.0, waves, 70.0)
        assert spots is not None and spots.order == order
    assert lattice.find_spots(plane, use, 12.0, waves, 70.0).virtual_depth == pytest.approx(-3.8, rel=0.03)


def test_a_displaced_lattice_is_measured_with_its_direction():
    scene = square()
    cutouts = np.zeros((*scene.period, 2))
    cutouts[3, 5] = 1.0, 2.0  # stage and cutout both one row and two columns ahead: the pattern belongs there
    plane = scene.plane(0, stage=cutouts, cutouts=cutouts).astype(np.float32)
    waves = lattice.wave_vectors(scene.camera, scene.period)
    spots = lattice.find_spots(plane, np.ones(scene.period, bool), 0.0, waves, 70.0)
    shift = lattice.displacements(plane, spots, 0.0)
    assert shift[:, 3, 5] - np.median(shift, axis=(1, 2)) == pytest.approx((1.0, 2.0), abs=0.15)


def test_the_spread_of_a_disc_is_that_of_its_radius():
    rows, columns = np.mgrid[:81, :81]
    disc = np.clip(25.5 - np.hypot(rows - 40, columns - 40), 0, 1)
    assert sums.diameter(disc) == pytest.approx(50, rel=0.005)
    assert sums.diameter(np.zeros((9, 9))) == 0


def test_coverage_counts_the_cutouts_over_each_sensor_pixel():
    counts = np.zeros((5 + 2, 7 + 3), int)
    for y, x in np.ndindex(3, 4):
        counts[y : y + 5, x : x + 7] += 1
    assert np.array_equal(sums.coverage((3, 4), (5, 7)), counts)


def test_a_seam_and_an_odd_frame_stand_out():
    steps = RNG.uniform(0.009, 0.011, (2, 12, 14))
    steps[1, :, -1] = 0.09
    use = np.ones((12, 14), bool)
    assert seam_ratio(steps, use) == pytest.approx(3, rel=0.1)
    steps[0, 4:6, 7] = steps[1, 5, 6:8] = 0.2
    odd = odd_frames(steps, use)
    assert np.unravel_index(int(np.nanargmax(odd)), odd.shape) == (5, 7) and odd[5, 7] > 15


def test_dark_corners_know_noise_background_and_clipping():
    plane = RNG.normal(2, 3, (6, 7, 41, 41)).astype(np.float32)
    dark = dark_corners(plane)
    assert dark.noise == pytest.approx(3, rel=0.07) and dark.background == pytest.approx(2, abs=0.3)
    assert dark.clipped == 0
    assert dark_corners(np.maximum(plane - 2, 0)).clipped == pytest.approx(0.5, abs=0.05)
    smooth = np.maximum(plane[:1, :1] * 0 + np.linspace(-1, 1, 41, dtype=np.float32), 0)
    assert dark_corners(smooth).clipped == 0  # zeros that lie together are no noise cut off


def test_planes_out_of_order_are_found_without_a_camera():
    scene = hexagonal()
    values = np.roll(base(scene), 1, axis=0)
    assert inspect(PSFMatrix(values, depths=scene.depths))["depth_order"].merit == "bad"
    assert inspect(PSFMatrix(base(scene), depths=scene.depths))["depth_order"].merit == "good"


def test_a_field_of_no_known_value_is_unknown_without_a_warning():
    for field, use in ((np.full((3, 4), np.nan), None), (np.ones((3, 4)), np.zeros((3, 4), bool))):
        parts = split(field, use)
        assert all(math.isnan(value) for value in (parts.rms, parts.spread, parts.alternation))
    half = np.ones((4, 5))
    half[1] = np.nan
    assert split(half).alternation == 0


# -- frames whole periods away ---------------------------------------------------------------------------
def at(scene: Scene, places: np.ndarray, z: int = 0) -> np.ndarray:
    """Return the patterns of a source at sensor ``places (n, 2)`` (row, column)."""
    ny, nx = scene.period
    frames = []
    for row, column in places:
        offset = np.zeros((ny, nx, 2))
        offset[0, 0] = row, column
        frames.append(scene.plane(z, stage=offset, cutouts=offset)[0, 0])
    return np.stack(frames)


def stretched(scene: Scene, factor: float) -> Scene:
    """Return the scene with lenslets ``factor`` farther apart: what the edge of a field looks like."""
    lattice = scene.camera.lattice
    wider = dataclasses.replace(
        lattice,
        pitch_um=lattice.pitch_um * factor,
        row_pitch_um=lattice.row_step_um * factor,
        offset_um=tuple(v * factor for v in lattice.offset_um),
    )
    return Scene(dataclasses.replace(scene.camera, lattice=wider), scene.virtual_depths, scene.cutout, scene.blur_px)


def test_frames_one_period_away_agree_where_the_lattice_is_regular():
    scene = square()
    ny, nx = scene.period
    places = np.array([[3 + ny, 4], [3, 4 - nx], [7 + 2 * ny, 2 + nx]])
    found = periodicity(at(scene, places), places, scene.planes[0])
    assert found.away.tolist() == [[1, 0], [0, -1], [2, 1]]
    assert found.difference.max() < 0.01 and np.abs(found.shift).max() < 0.05


def test_the_period_of_a_wider_or_narrower_lattice_is_found():
    scene = square()
    ny, nx = scene.period
    wide, narrow = stretched(scene, 1.01), stretched(scene, 0.99)
    places = np.array([[3 + 4 * ny, 4], [3, 4 - 5 * nx], [3 + 3 * ny, 4 + 6 * nx]])
    found = periodicity(at(wide, places), places, wide.planes[0])
    assert found.fitting_period == pytest.approx((15.15, 15.15), abs=0.03)
    assert (found.best < found.difference).all()
    places = np.array([[3 + 5 * ny, 4]])
    found = periodicity(at(narrow, places), places, narrow.planes[0])
    assert found.period[0, 0] == pytest.approx(14.85, abs=0.03) and np.isnan(found.period[0, 1])


def test_another_pattern_is_no_match_and_a_wrong_shape_is_refused():
    scene = square()
    places = np.array([[3 + 15, 4]])
    assert periodicity(at(scene, places, z=1), places, scene.planes[0]).difference[0] > 0.3
    with pytest.raises(InputError, match="control frames"):
        periodicity(np.zeros((2, 5, 5)), np.zeros((2, 2)), np.zeros((3, 3, 7, 7)))


def test_a_cell_of_unequal_sides_and_an_anchor():
    scene = hexagonal()
    ny, nx = scene.period
    places = np.array([[2 + ny, 5 + nx]])
    found = periodicity(at(scene, places), places + 100.0, scene.planes[0], anchor=(100.0, 100.0))
    assert found.away.tolist() == [[1, 1]]
    assert found.difference[0] < 0.1


def test_the_inspection_takes_control_frames_along():
    scene = square()
    places = np.array([[3 + 15, 4], [3, 4 + 30]])
    values = recorded(scene.planes, 0, 3.0)
    far = at(stretched(scene, 1.02), places) * scene.scale
    H = PSFMatrix(values, depths=scene.depths, camera=scene.camera)
    good = inspect(H, controls={0: (at(scene, places) * scene.scale, places)})
    bad = inspect(H, controls={0: (far, places)})
    assert good["tiling"].merit == "good" and good.tilings[0] is not None
    assert bad["tiling"].merit == "bad"
    assert "fits best" in bad["tiling"].detail
