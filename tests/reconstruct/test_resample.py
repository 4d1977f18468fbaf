"""Frames on the period of H, and volumes on voxels of one size: light is kept, and places in µm."""

from __future__ import annotations

import itertools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from lfcal.base.errors import InputError
from lfcal.camera import LatticeDistortion, ScanPlan, preset
from lfcal.psf import PSFMatrix, voxel_um
from lfcal.reconstruct.metric_grid import MetricGrid
from lfcal.reconstruct.resample import Resampling, lattice_anchor_of

BASIS = np.array([[7.31, 0.12], [-0.15, 7.42]])  # rows (x, y): along a row, to the next row


def spots(shape, origin, basis, width=1.3):
    """Return Gaussian spots on the lattice: a frame whose micro-images are known."""
    r, c = np.mgrid[: shape[0], : shape[1]].astype(float)
    image = np.zeros(shape)
    for q in range(-20, 21):
        for k in range(-20, 21):
            x, y = q * basis[0] + k * basis[1] + np.array(origin)[::-1]
            image += np.exp(-((r - y) ** 2 + (c - x) ** 2) / (2 * width**2))
    return image


def fit(shape, origin, basis, kind="square"):
    return SimpleNamespace(kind=kind, shape=shape, origin_px=origin, distortion=None, basis_px=lambda: basis)


def test_a_lattice_becomes_periodic():
    shape, origin = (90, 95), (44.3, 47.8)
    view = Resampling.of_fit(fit(shape, origin, BASIS))
    assert view.period == (7, 7)
    out = view.apply(spots(shape, origin, BASIS))
    inner = out[14:-14, 14:-14]
    assert np.abs(inner[7:] - inner[:-7]).max() < 0.01 * out.max()
    assert np.abs(inner[:, 7:] - inner[:, :-7]).max() < 0.01 * out.max()
    unlike = spots(shape, origin, BASIS)[14:-14, 14:-14]  # before, it is not
    assert np.abs(unlike[7:] - unlike[:-7]).max() > 0.1 * unlike.max()


def test_position_zero_of_h_is_on_a_pixel():
    for anchor in ((0.0, 0.0), (-3.5, -3.5), (2.25, -1.4)):
        view = Resampling.of_fit(fit((90, 95), (44.3, 47.8), BASIS), lattice_anchor=anchor)
        row, column = view.anchor(anchor)
        assert np.allclose((row, column), np.add(view.centre, anchor), atol=1e-9)
        place = view.places(np.array(float(row) - anchor[0]), np.array(float(column) - anchor[1]))
        steps = (np.array(place)[::-1] - (47.8, 44.3)) @ np.linalg.inv(BASIS)
        assert np.allclose(steps, np.round(steps), atol=1e-9)  # a lenslet's centre lies where it should


def test_light_and_identity_are_kept():
    rng = np.random.default_rng(0)
    frame = rng.random((33, 30))
    same = Resampling.to_period((33, 30), (5.0, 5.0), (5.0, 0.0), (0.0, 5.0), (5, 5))
    assert same.shape == (33, 30)
    assert np.allclose(same.apply(frame), frame, atol=1e-6)
    blob = spots((91, 91), (45.0, 45.0), 1000 * np.eye(2), width=6)
    finer = Resampling.to_period((91, 91), (45.0, 45.0), (5.3, 0.0), (0.0, 4.9), (6, 5))
    assert finer.scale == pytest.approx((6 / 5.3, 5 / 4.9))
    assert finer.apply(blob).sum() == pytest.approx(blob.sum(), rel=1e-5)


def test_splines_of_every_order_keep_light_and_place():
    """Half a pixel to the right: straight lines stay straight with all splines except the nearest pixel."""
    frame = np.tile(np.arange(30.0), (33, 1))
    moved = Resampling.to_period((33, 30), (5.0, 5.5), (5.0, 0.0), (0.0, 5.0), (5, 5))
    wanted = float(moved.places(np.array(10.0), np.array(10.0))[1]) + np.arange(10.0)
    for order in range(6):
        row = moved.apply(frame, order=order)[10, 10:20]
        assert np.allclose(row, wanted, atol=0.5 if order == 0 else 0.02), order


def test_hexagonal_period_spans_two_rows_and_three_types():
    a = np.array([11.0, 0.0])
    b = np.array([5.5, 9.526])
    one = Resampling.of_fit(fit((100, 100), (50.0, 50.0), np.array([a, b]), "hexagonal"))
    three = Resampling.of_fit(fit((100, 100), (50.0, 50.0), np.array([a, b]), "hexagonal"), types=3)
    assert one.period == (19, 11) and three.period == (19, 33)
    assert np.allclose(three.down, (19.052, 0.0))


def test_weights_of_pixels_outside_and_bad_pixels_are_0():
    view = Resampling.of_fit(fit((40, 40), (20.0, 20.0), 0.98 * BASIS))
    mask = np.ones((40, 40), bool)
    assert view.inside((40, 40)).mean() > 0.9 and view.inside((40, 40)).shape == view.shape
    mask[20, 20] = False
    lost = view.inside((40, 40)) - view.inside((40, 40), mask)
    assert 1 <= lost.sum() <= 9


def test_a_pixel_without_value_does_not_spread():
    """Splines carry a NaN through the whole frame (roman-corgi/corgidrp#988)."""
    frame = np.random.default_rng(3).uniform(1, 2, (60, 70))
    view = Resampling.to_period((60, 70), (30.3, 35.2), BASIS[1], BASIS[0], (7, 7))
    whole = view.apply(frame)
    lost = np.zeros(frame.shape, bool)
    lost[20, 31] = lost[40, 10] = True
    frame[20, 31], frame[40, 10] = np.nan, np.inf
    found = view.apply(frame)
    bad = np.isnan(found)
    assert 1 <= bad.sum() <= 18
    np.testing.assert_array_equal(bad, (view.inside(frame.shape) > 0) & (view.inside(frame.shape, ~lost) == 0))
    away = ~binary_dilation(bad, iterations=12)
    np.testing.assert_allclose(found[away], whole[away], rtol=1e-4)
    assert np.isnan(view.apply(np.full(frame.shape, np.nan))).all()


def test_lattice_anchor_is_that_of_the_plan():
    for name in ("bench", "r29", "lfm_20x05", "lfm_60x12"):
        camera = preset(name)
        depths = {"depths_um": [0.0]} if name.startswith("lfm") else {"virtual_depths": [4.0]}
        plan = ScanPlan.for_camera(camera, resample=True, **depths)
        H = SimpleNamespace(shape=plan.shape, camera=camera, anchor=plan.anchor)
        expected = np.array(plan.lattice_anchor) * plan.resample_factors
        off = (np.array(lattice_anchor_of(H)) - expected) / np.array(plan.period)
        assert np.allclose(2 * off, np.round(2 * off), atol=1e-6), name


def test_a_camera_states_its_lattice():
    camera = preset("lfm_60x12")
    lattice = camera.lattice
    view = Resampling.of_camera(camera)
    assert view.period == (15, 15)
    assert view.scale == pytest.approx((15 / camera.period_px[0], 15 / camera.period_px[1]))
    centre = view.places(np.array(view.centre[0] + 30), np.array(view.centre[1] - 15))
    expected = camera.pixels(lattice.centres_um(-1, 2))
    assert np.allclose(centre, expected)


def test_bad_lattices_are_refused():
    with pytest.raises(InputError, match="two directions"):
        Resampling.to_period((9, 9), (4, 4), (1.0, 1.0), (2.0, 2.0), (3, 3))
    with pytest.raises(InputError, match="two axes"):
        Resampling.to_period((9, 9), (4, 4), (3.0, 0.0), (0.0, 3.0), (3, 3)).apply(np.ones(9))
    good = Resampling.to_period((9, 9), (4, 4), (3.0, 0.0), (0.0, 3.0), (3, 3))
    for bad in ({"period": (0, 3)}, {"period": (3, 0)}, {"shape": (0, 9)}, {"shape": (9, 0)}):
        with pytest.raises(InputError, match="period and shape: expected positive"):
            replace(good, **bad)


def test_a_distorted_lattice_becomes_straight() -> None:
    """Each pixel of the result is looked up where its place of the straight lattice is seen."""
    bend = LatticeDistortion("radial", (60.0, 40.0), 80.0, ((3.0,),))
    basis = np.array([[11.3, 0.2], [-0.2, 11.4]])
    fit = SimpleNamespace(kind="square", shape=(90, 120), basis_px=lambda: basis, distortion=bend)
    straight = np.array([55.0, 47.0])
    x, y = bend.apply(straight)
    made = Resampling.of_fit(SimpleNamespace(**vars(fit), origin_px=(float(y), float(x))))
    centre = np.array(made.centre)
    for q, r in ((0, 0), (3, -2), (-4, 3)):
        pixel = centre + np.array([r, q]) * made.period
        row, column = made.places(*pixel)
        assert (column, row) == pytest.approx(bend.apply(np.array([q, r]) @ basis + straight), abs=1e-6)


def test_a_camera_states_its_distortion_in_micrometres() -> None:
    """The map takes it in pixels, about the sensor's centre."""
    camera = preset("bench")
    bend = LatticeDistortion("radial", (30.0, -20.0), 300.0, ((2.0,),))
    camera = replace(camera, lattice=replace(camera.lattice, distortion=bend))
    made = Resampling.of_camera(camera).distortion
    pixel, (row, column) = camera.sensor.pixel_um, camera.sensor.centre_px
    places = np.array([[0.0, 10.0], [100.0, -60.0], [-250.0, 200.0]])
    assert made is not None and pixel != 1
    wanted = bend.apply(places) / pixel + (column, row)
    np.testing.assert_allclose(made.apply(places / pixel + (column, row)), wanted, rtol=1e-9)


SIDES = [(10.0, 10.0), (10.7, 10.7), (12.0, 11.5)]


def test_all_light_is_kept() -> None:
    volume = np.random.default_rng(1).random((3, 30, 40))
    for voxel, axis in itertools.product((None, 3.0, 10.0, 47.0, 5000.0), ((14.5, 19.5), (0.0, 0.0), (-40.3, 100.7))):
        grid = MetricGrid.of(SIDES, (30, 40), axis, voxel)
        made = grid.apply(volume)
        assert made.shape == (3, *grid.shape) and grid.voxel_um == (voxel or 10.0)
        np.testing.assert_allclose(made.sum((1, 2), dtype=float), volume.sum((1, 2)), rtol=1e-6)


@pytest.mark.parametrize("voxel", [None, 2.5, 33.0])
def test_points_are_at_their_places(voxel: float | None) -> None:
    """The middle of the light is that of the pixel, in µm from the axis, to a rounding."""
    axis = (12.25, 20.75)
    grid = MetricGrid.of(SIDES, (30, 40), axis, voxel)
    ys, xs = (grid.origin_um[k] + grid.voxel_um * np.arange(grid.shape[k]) for k in range(2))
    for z, (dy, dx) in enumerate(SIDES):
        volume = np.zeros((3, 30, 40))
        volume[z, 7, 31] = 1.0
        made = grid.apply(volume)[z].astype(float)
        found = (made.sum(1) @ ys, made.sum(0) @ xs)
        wanted = ((7 - axis[0]) * dy, (31 - axis[1]) * dx)
        # a voxel's light counts at its middle: by up to half a voxel where one is wider than the pixel
        allowed = 1e-4 if grid.voxel_um < 1e-6 else max(0.0, grid.voxel_um - min(dy, dx)) / 2 + grid.voxel_um / 2
        assert np.hypot(found[0] - wanted[0], found[1] - wanted[1]) <= np.sqrt(2) * allowed
    # many pixels: what voxels round is rounded both ways
    line = np.zeros((3, 30, 40))
    line[2, 5:25, 3:37] = 1.0
    made = grid.apply(line)[2].astype(float)
    assert made.sum(1) @ ys / made.sum() == pytest.approx((14.5 - axis[0]) * 12.0, abs=0.05 * grid.voxel_um + 1e-3)


def test_planes_of_one_size_do_not_change() -> None:
    volume = np.random.default_rng(1).random((2, 9, 7)).astype(np.float32)
    grid = MetricGrid.of([(4.0, 4.0)] * 2, (9, 7), (3.2, 1.1))
    np.testing.assert_allclose(grid.apply(volume), volume, rtol=1e-6)
    # where a pixel ends with a voxel, the next voxel has no entry, not even a zero
    grid = MetricGrid.of([(10.0, 10.0)], (12, 15), (0.0, 0.0), 6.0)
    assert all((shares.data > 0).all() for shares in (*grid.rows, *grid.columns))


def test_a_rod_parallel_to_the_axis_is_straight() -> None:
    """A rod parallel to the axis: its image moves from plane to plane, its place in µm does not."""
    camera = preset("bench")
    plan = ScanPlan.for_camera(camera, virtual_depths=[3.0, 4.0, 6.0], cutout=11)
    H = PSFMatrix(np.ones((3, 2, 2, 11, 11), np.float32), depths=plan.depths_um, camera=camera, anchor=(3.0, 5.0))
    shape = camera.sensor.shape
    grid = MetricGrid.for_matrix(H, shape)
    rod_um = (400.0, -650.0)
    volume = np.zeros((3, *shape))
    for z, depth in enumerate(plan.depths_um):
        step = camera.step_um(float(depth))
        row, column = (camera.pixels((0.0, 0.0))[k] + rod_um[k] / step for k in range(2))
        volume[z, round(row), round(column)] = 1.0
    made = grid.apply(volume)
    ys, xs = (grid.origin_um[k] + grid.voxel_um * np.arange(grid.shape[k]) for k in range(2))
    for z in range(3):
        found = made[z].sum(1) @ ys, made[z].sum(0) @ xs
        assert np.abs(np.subtract(found, rod_um)).max() < grid.voxel_um
    # an image that is cut from the sensor has its axis elsewhere; another anchor a period on is the same place
    cut = MetricGrid.for_matrix(H, (60, 50), (3.0 - 20, 5.0 - 10))
    widest = max(camera.step_um(float(z)) for z in plan.depths_um)
    assert cut.origin_um[0] - grid.origin_um[0] == pytest.approx(20 * widest)
    assert MetricGrid.for_matrix(H, shape, (3.0 - 20, 5.0 - 10)).origin_um == pytest.approx(grid.origin_um)
    # with a row less it is a part of the sensor
    part = (shape[0] - 1, shape[1])
    here, there = (MetricGrid.for_matrix(H, part, anchor) for anchor in (None, (3.0 - 20, 5.0)))
    assert there.origin_um[0] - here.origin_um[0] == pytest.approx(20 * widest)


@pytest.mark.parametrize("rotation", [0.0, 0.01])
def test_the_axis_of_resampled_images_is_that_of_the_camera(rotation: float) -> None:
    """It was displaced by up to half a period if the anchor of H was far from the axis, or the lattice was rotated."""
    camera = preset("lfm_60x12")
    camera = replace(camera, lattice=replace(camera.lattice, rotation_rad=rotation))
    H = PSFMatrix(np.ones((1, 15, 15, 3, 3)), depths=[50.0], camera=camera, anchor=(1000, 1000))
    view = Resampling.of_camera(camera, H.period, lattice_anchor_of(H))
    grid = MetricGrid.for_matrix(H, view.shape, view.anchor(lattice_anchor_of(H)), view=view)
    axis = (grid.voxel_um / 2 - np.array(grid.origin_um)) / voxel_um(H) - 0.5
    np.testing.assert_allclose(view.places(*axis), camera.pixels((0.0, 0.0)), atol=1e-6)
    bend = LatticeDistortion("radial", (900.0, 1100.0), 1000.0, ((2.0,),))
    bent = replace(view, distortion=bend)
    np.testing.assert_allclose(bent.places(*np.array(bent.pixel((300.0, 1700.0)))), (300.0, 1700.0), atol=1e-6)


def test_wrong_metric_grids_are_refused() -> None:
    for call, what in (
        (lambda: MetricGrid.of(SIDES, (30, 40), (0, 0), -1.0), "voxel"),
        (lambda: MetricGrid.of(SIDES, (30, 40), (0, 0), 1e-320), "voxel"),  # too many to count
        (lambda: MetricGrid.of(SIDES, (30000, 40000), (0, 0), 0.1), "choose larger voxels"),
        (lambda: MetricGrid.for_matrix(PSFMatrix(np.ones((1, 2, 2, 3, 3))), (10, 10)), "an H with its camera"),
        (lambda: MetricGrid.of(SIDES, (30, 40), (0, 0)).apply(np.zeros((2, 30, 40))), "expected"),
    ):
        with pytest.raises(InputError, match=what):
            call()
