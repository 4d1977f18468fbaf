"""Series of frames in the folders that acquisition programs write."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lfcal.reconstruct.frame_files import frames_of
from tests.frames.test_containers import FRAMES, write_ndtiff, write_zarr

SERIES = FRAMES.reshape(24, 16, 18)[:3]


@pytest.mark.parametrize("kind", ["zarr", "ndtiff"])
def test_a_series_in_a_folder_with_a_description(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "beads.ome.zarr"
    if kind == "zarr":
        write_zarr(path, SERIES, "tyx", "0.5")
    else:
        write_ndtiff(path, [({"time": k}, frame, {}) for k, frame in enumerate(SERIES)])
    found = frames_of(path)
    assert [frame.name for frame in found] == ["beads_0000", "beads_0001", "beads_0002"]
    for frame, expected in zip(found, SERIES, strict=True):
        np.testing.assert_array_equal(frame.read(), expected)
    # a unit of work is repeated if any of these files changes
    inside = {str(file) for file in path.rglob("*") if file.is_file()}
    assert set(found[0].inputs) == inside and len(inside) > 1
