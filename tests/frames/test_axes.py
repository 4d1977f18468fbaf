"""Stacks whose axes OME or ImageJ metadata name: positions follow from them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tifffile

from lfcal.base.errors import FileFormatError, InputError
from lfcal.camera import ScanPlan
from lfcal.frames import open_frames, scan_positions
from tests.frames.lists.scans import small_camera

STACK = np.random.default_rng(0).integers(0, 4000, (2, 3, 4, 12, 15)).astype(np.uint16)  # z, y, x, row, column


def write(path: Path, stack: np.ndarray, axes: str, **how: Any) -> Path:
    tifffile.imwrite(path, stack, photometric="minisblack", metadata={"axes": axes}, **how)
    return path


@pytest.mark.parametrize(
    ("axes", "order", "how"),
    [
        ("ZTCYX", (0, 1, 2, 3, 4), {"ome": True}),
        ("TZCYX", (1, 0, 2, 3, 4), {"ome": True}),
        ("TCZYX", (1, 2, 0, 3, 4), {"ome": True}),
        ("TZCYX", (1, 0, 2, 3, 4), {"imagej": True}),
    ],
)
def test_three_axes_are_depth_row_and_column(
    tmp_path: Path, axes: str, order: tuple[int, ...], how: dict[str, bool]
) -> None:
    name = "stack.ome.tif" if "ome" in how else "stack.tif"
    path = write(tmp_path / name, np.ascontiguousarray(STACK.transpose(order)), axes, **how)
    with open_frames(path) as source:
        assert len(source) == 24
        for k in range(24):
            np.testing.assert_array_equal(source.read(k), STACK[source.info(k).position])


def test_two_axes_of_one_plane(tmp_path: Path) -> None:
    path = write(tmp_path / "plane.ome.tif", STACK[0], "TCYX", ome=True)
    with open_frames(path, plan_shape=(1, 3, 4)) as source:
        for k in range(12):
            np.testing.assert_array_equal(source.read(k), STACK[(0, *source.info(k).position[1:])])


def test_planes_of_positions_need_their_order(tmp_path: Path) -> None:
    """Micro-Manager's way: time runs over the positions, within each over the depths."""
    scan = scan_positions((2, 3, 4), "serpentine")
    stack = np.stack([STACK[p] for p in scan]).reshape(2, 12, 12, 15).transpose(1, 0, 2, 3)
    path = write(tmp_path / "scan.ome.tif", np.ascontiguousarray(stack), "TZYX", ome=True)
    with pytest.raises(InputError, match=r"positions of the frames in .*scan\.ome\.tif: expected a manifest"):
        open_frames(path)
    with open_frames(path, order="serpentine", plan_shape=(2, 3, 4)) as source:
        for k in range(24):
            np.testing.assert_array_equal(source.read(k), STACK[source.info(k).position])


def test_more_axes_are_refused(tmp_path: Path) -> None:
    stack = np.zeros((2, 2, 3, 2, 8, 9), np.uint16)
    stack += np.arange(stack.size, dtype=np.uint16).reshape(stack.shape)
    path = write(tmp_path / "many.ome.tif", stack, "TZCAYX", ome=True)
    with pytest.raises(FileFormatError, match="axes of the pages: expected three or fewer, got TZCA"):
        open_frames(path)


LAST: dict[str, Callable[[Path, Any], object]] = {
    "last.npy": lambda path, stack: np.save(path, stack),
    "last.h5": lambda path, stack: h5py.File(path, "w").create_dataset("frames", data=stack).file.close(),
    "last.tif": lambda path, stack: tifffile.imwrite(path, stack, photometric="minisblack"),
}


@pytest.mark.parametrize("name", LAST)
def test_frames_along_the_last_axis(tmp_path: Path, name: str) -> None:
    """Programs that store (row, column, frame), after gms_plugin_hdf5#2."""
    plan = ScanPlan(small_camera(), (3, 4), (9, 11), (-4e4, -2e4, 0.0, 1e4, 2e4), (20, 20))
    frames = np.random.default_rng(2).integers(0, 4000, (60, *plan.camera.sensor.shape)).astype(np.uint16)
    LAST[name](tmp_path / name, np.ascontiguousarray(np.moveaxis(frames, 0, -1)))
    with open_frames(tmp_path / name, order="raster", plan=plan) as source:
        assert any("60 along the last axis" in note for note in source.metadata.notes)
        for k in (59, 0, 7):
            np.testing.assert_array_equal(source.read(k), frames[k])
            region = (slice(2, 9), slice(1, 4))
            np.testing.assert_array_equal(source.read(k, region), frames[k][region])
    # there are fewer rows than positions: without a sensor it may also be a scan that stopped early
    with pytest.raises(
        FileFormatError, match=("60 frames along one axis, got 40 along the first axis and 60 along the last")
    ):
        open_frames(tmp_path / name, order="raster", plan_shape=plan.shape[:3])


def test_the_first_axis_wins_where_both_fit_and_a_large_stack_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    np.save(tmp_path / "both.npy", STACK.reshape(24, 12, 15)[:12, :, :12])
    with open_frames(tmp_path / "both.npy", order="raster", plan_shape=(1, 3, 4)) as source:
        np.testing.assert_array_equal(source.read(3), STACK.reshape(24, 12, 15)[3, :, :12])
    np.save(tmp_path / "last.npy", np.moveaxis(STACK.reshape(24, 12, 15)[:6], 0, -1))
    monkeypatch.setattr("lfcal.frames.formats._axes.LARGEST", 1000)
    with pytest.raises(InputError, match=r"frames along the last axis: expected at most .*numpy\.moveaxis"):
        open_frames(tmp_path / "last.npy", order="raster", plan_shape=(1, 2, 3))


@pytest.mark.parametrize("shape", [(12, 1, 12, 15), (1, 12, 12, 15), (12, 12, 15, 1)])
@pytest.mark.parametrize("name", ["a.npy", "a.h5"])
def test_one_axis_of_length_1_is_left_out(tmp_path: Path, name: str, shape: tuple[int, ...]) -> None:
    """Deep-learning code stores (frame, channel, row, column), after dipy#3112 and MouseLand/suite2p#701."""
    frames = STACK[0].reshape(12, 12, 15)
    LAST[name.replace("a.", "last.")](tmp_path / name, frames.reshape(shape))
    with open_frames(tmp_path / name, order="raster", plan_shape=(1, 3, 4)) as source:
        for k in (0, 5, 11):
            np.testing.assert_array_equal(source.read(k), frames[k])
            np.testing.assert_array_equal(source.read(k, (slice(1, 5), slice(3, 9))), frames[k, 1:5, 3:9])
