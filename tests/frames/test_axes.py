"""Stacks whose axes OME or ImageJ metadata name: positions follow from them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from lfcal.base.errors import FileFormatError, InputError
from lfcal.frames import open_frames, scan_positions

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
