"""Volumes on voxels of one size: light is kept, and a point lies where it is in µm, whatever its plane."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile

from lfcal.base.errors import InputError
from lfcal.camera import ScanPlan, preset
from lfcal.psf import PSFMatrix
from lfcal.reconstruct.metric_grid import MetricGrid

SIDES = [(10.0, 10.0), (10.7, 10.7), (12.0, 11.5)]


@pytest.mark.parametrize("voxel", [None, 3.0, 10.0, 47.0, 5000.0])
@pytest.mark.parametrize("axis", [(14.5, 19.5), (0.0, 0.0), (-40.3, 100.7)])
def test_all_light_is_kept(voxel: float | None, axis: tuple[float, float]) -> None:
    grid = MetricGrid.of(SIDES, (30, 40), axis, voxel)
    volume = np.random.default_rng(1).random((3, 30, 40))
    made = grid.apply(volume)
    assert made.shape == (3, *grid.shape) and grid.voxel_um == (voxel or 10.0)
    np.testing.assert_allclose(made.sum((1, 2), dtype=float), volume.sum((1, 2)), rtol=1e-6)


@pytest.mark.parametrize("voxel", [None, 2.5, 33.0])
def test_points_lie_where_they_are(voxel: float | None) -> None:
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


def test_planes_of_one_size_stay_as_they_are() -> None:
    volume = np.random.default_rng(1).random((2, 9, 7)).astype(np.float32)
    grid = MetricGrid.of([(4.0, 4.0)] * 2, (9, 7), (3.2, 1.1))
    np.testing.assert_allclose(grid.apply(volume), volume, rtol=1e-6)


def test_only_what_falls_into_a_voxel_is_held() -> None:
    """Where a pixel ends with a voxel, the next one gets nothing of it, not a nought that is multiplied each time."""
    grid = MetricGrid.of([(10.0, 10.0)], (12, 15), (0.0, 0.0), 6.0)
    assert all((shares.data > 0).all() for shares in (*grid.rows, *grid.columns))


def test_a_cone_is_a_cone_again() -> None:
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


def test_what_cannot_be() -> None:
    with pytest.raises(InputError, match="voxel"):
        MetricGrid.of(SIDES, (30, 40), (0, 0), -1.0)
    with pytest.raises(InputError, match="voxel"):
        MetricGrid.of(SIDES, (30, 40), (0, 0), 1e-320)  # so many that they have no number
    with pytest.raises(InputError, match="choose larger voxels"):
        MetricGrid.of(SIDES, (30000, 40000), (0, 0), 0.1)
    with pytest.raises(InputError, match="an H with its camera"):
        MetricGrid.for_matrix(PSFMatrix(np.ones((1, 2, 2, 3, 3))), (10, 10))
    with pytest.raises(InputError, match="shape"):
        MetricGrid.of(SIDES, (30, 40), (0, 0)).apply(np.zeros((2, 30, 40)))


def test_files_say_it(tmp_path: Path) -> None:
    from lfcal.reconstruct.volumes import save_volume

    save_volume(tmp_path / "v.tif", np.ones((3, 4, 5)), depths_um=[1.0, 2.0, 9.0], voxel_um=2.5)
    with tifffile.TiffFile(tmp_path / "v.tif") as file:
        assert file.imagej_metadata is not None
        # ImageJ knows one spacing; uneven planes are told beside it
        assert '"depths_um": [1.0, 2.0, 9.0]' in file.imagej_metadata["lfcal"]
