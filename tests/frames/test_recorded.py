"""Times of recording, from the pages of TIFF files or from the files."""

from __future__ import annotations

import os
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import tifffile

from lfcal.frames import open_unplaced, recorded_times

PAGE = np.arange(400, dtype=np.uint16).reshape(20, 20)


def test_pages_state_their_times(tmp_path: Path) -> None:
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        for minute in (1, 2):
            file.write(PAGE, datetime=f"2026:05:01 10:0{minute}:00", metadata=None)
    with open_unplaced(tmp_path / "a.tif") as source:
        found = recorded_times(source)
    assert [f"{one:%Y-%m-%d %H:%M}" for one in found if one] == ["2026-05-01 10:01", "2026-05-01 10:02"]


def test_files_without_times_have_those_of_the_system(tmp_path: Path) -> None:
    for k in range(2):
        tifffile.imwrite(tmp_path / f"{k}.tif", PAGE, datetime="2026:05:01 10:00:00" if k else None)
        os.utime(tmp_path / f"{k}.tif", (1e9 + k, 1e9 + k))
    with open_unplaced(tmp_path) as source:
        assert recorded_times(source) == [datetime.fromtimestamp(1e9 + k, UTC) for k in range(2)]
    tifffile.imwrite(tmp_path / "0.tif", np.stack([PAGE, PAGE + 1]))
    with open_unplaced(tmp_path) as source:
        assert recorded_times(source) == [None, None, None]
