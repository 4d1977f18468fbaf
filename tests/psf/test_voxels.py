"""Pixels and voxels of resampled matrices have sides of their own along each axis, in every file that states them."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
import tifffile

from lfcal.camera import preset
from lfcal.psf import PSFMatrix
from lfcal.psf._export import export
from lfcal.psf.voxels import pixel_um, voxel_um
from lfcal.reconstruct.volumes import save_volume

SCALE = (0.8, 0.5)


def resampled() -> PSFMatrix:
    values = np.random.default_rng(1).random((2, 3, 3, 9, 9), np.float32)
    about = {"cutout": {"interpolation": "cubic", "scale": SCALE}}
    return PSFMatrix(values, depths=[-2.0, 2.0], camera=preset("lfm_60x12"), provenance=about)


def test_sides_follow_the_scale_of_each_axis() -> None:
    H = resampled()
    assert pixel_um(H) == pytest.approx((6.5 / 0.8, 6.5 / 0.5))
    assert voxel_um(H) == pytest.approx((6.5 / 60 / 0.8, 6.5 / 60 / 0.5))
    assert pixel_um(PSFMatrix(H.plane(0)[None])) is None


def resolution(path: Path) -> tuple[float, float]:
    """Return (rows, columns) in µm as the TIFF's tags state them."""
    with tifffile.TiffFile(path) as file:
        tags = file.pages.first.tags
        y, x = (tags[name].value for name in ("YResolution", "XResolution"))
    return y[1] / y[0], x[1] / x[0]


def test_volumes_and_exports_state_both_sides(tmp_path: Path) -> None:
    H = resampled()
    save_volume(tmp_path / "v.tif", np.ones((2, 9, 9)), depths_um=H.depths, voxel_um=voxel_um(H))
    assert resolution(tmp_path / "v.tif") == pytest.approx(voxel_um(H), rel=1e-4)
    export(H, tmp_path / "h.tif")
    assert resolution(next(p for p in [tmp_path / "h.tif", *tmp_path.glob("h*.tif")] if p.is_file())) == pytest.approx(
        pixel_um(H), rel=1e-4
    )
    export(H, tmp_path / "h.mat")
    with h5py.File(tmp_path / "h.mat") as file:
        columns, rows = file["voxelSize"][()].ravel() * 1e6
    assert (rows, columns) == pytest.approx(voxel_um(H))
