"""Frames of a folder that cannot be read: named with their position, left out where that is asked for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile

from lfcal.base.errors import FileFormatError
from lfcal.base.progress import drain
from lfcal.frames import iter_undamaged, open_frames
from lfcal.frames.damage import frame_errors
from lfcal.frames.source import Position

FRAMES = np.random.default_rng(1).integers(100, 900, (2, 3, 12, 14), dtype=np.uint16)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for y, x in np.ndindex(2, 3):
        tifffile.imwrite(tmp_path / f"y{y}_x{x}.tif", FRAMES[y, x], photometric="minisblack")
    return tmp_path


def spoil(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-20])


def test_a_damaged_frame_is_named_with_its_position_and_the_way_on(folder: Path) -> None:
    spoil(folder / "y1_x2.tif")
    with open_frames(folder, pattern="y{y}_x{x}.tif") as source:
        bad = next(k for k in range(6) if source.info(k).position == Position(0, 1, 2))
        with pytest.raises(
            FileFormatError, match=r"y1_x2\.tif, \(z, y, x\) = \(0, 1, 2\): .*--skip-damaged\)$"
        ) as caught:
            source.read(bad)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("remedy", "said"),
    [
        ("copy it again", "copy it again, or leave it out (--skip-damaged)"),
        ("copy it again, or leave it out", "copy it again, or leave it out (--skip-damaged)"),
        ("leave it out", "leave it out (--skip-damaged)"),
    ],
)
def test_the_way_on_is_said_once(remedy: str, said: str) -> None:
    wrong = FileFormatError.expected("a.tif", "16 bits", "8", remedy)
    with pytest.raises(FileFormatError) as caught, frame_errors("a.tif", Position(0, 1, 2)):
        raise wrong
    assert str(caught.value) == f"a.tif, (z, y, x) = (0, 1, 2): expected 16 bits, got 8; {said}"


@pytest.mark.parametrize("names", [("y1_x2",), ("y0_x0",), ("y0_x0", "y0_x1", "y1_x0")])
def test_damaged_frames_are_left_out_and_listed(folder: Path, names: tuple[str, ...]) -> None:
    for name in names:
        spoil(folder / f"{name}.tif")
    with open_frames(folder, pattern="y{y}_x{x}.tif", skip_damaged=True) as source:
        work = iter_undamaged(source, workers=2)
        part = drain(work)
        assert [found.label for found in part.metadata.left_out] == [f"{name}.tif" for name in names]
        assert len(part) == 6 - len(names)
        for k in range(len(part)):
            _, y, x = part.info(k).position
            assert np.array_equal(part.read(k), FRAMES[y, x])
            assert np.array_equal(part.samples(k, (slice(2, 5), slice(3, 9))).values, FRAMES[y, x, 2:5, 3:9])


def test_nothing_left_is_an_error(folder: Path) -> None:
    for path in folder.glob("*.tif"):
        spoil(path)
    with (
        open_frames(folder, pattern="y{y}_x{x}.tif", skip_damaged=True) as source,
        pytest.raises(FileFormatError, match="expected at least one readable frame, got only damaged ones"),
    ):
        drain(iter_undamaged(source))


def test_whole_frames_are_all_taken(folder: Path) -> None:
    with open_frames(folder, pattern="y{y}_x{x}.tif") as source:
        part = drain(iter_undamaged(source))
        assert len(part) == 6 and part.metadata.left_out == ()
        assert [p.done for p in iter_undamaged(source)] == [0, 6]
