"""Colour mosaics, black and white levels are known by the tags of TIFF/EP and DNG, whatever the file is called."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from lfcal.base.errors import FileFormatError
from lfcal.frames import open_frames, open_image
from tests.frames.scenes import session, write_dng

MOSAIC = session((64, 80), top=900)


def write(path: Path, photometric: int, *tags: tuple[Any, ...], frame: Any = MOSAIC) -> Path:
    """Write a TIFF with any interpretation and tags."""
    tifffile.imwrite(path, frame, photometric="minisblack", metadata=None, extratags=[(*tag, True) for tag in tags])
    with tifffile.TiffFile(path, mode="r+") as file:
        file.pages[0].tags[262].overwrite(photometric)
    return path


REPEAT, BLACK_REPEAT = (33421, "H", 2, (2, 2)), (50713, "H", 2, (2, 2))


def pattern(*colours: int) -> tuple[Any, ...]:
    return (33422, "B", len(colours), colours)


def test_a_dng_is_the_same_under_another_name(tmp_path: Path) -> None:
    write_dng(tmp_path / "a.dng", MOSAIC, (0, 1, 1, 2))
    shutil.copy(tmp_path / "a.dng", tmp_path / "a.tif")
    raw, tiff = open_image(tmp_path / "a.dng"), open_image(tmp_path / "a.tif")
    assert tiff.metadata["cfa"] == raw.metadata["cfa"] == "RGGB"
    for key in ("black_level", "saturation", "gains"):
        assert tiff.metadata[key] == pytest.approx(raw.metadata[key]), key
    np.testing.assert_array_equal(tiff.read(), raw.read())
    raw.close()
    tiff.close()


def test_the_active_area_is_that_of_the_dng(tmp_path: Path) -> None:
    """Crops and tables of a DNG are applied by the reader of camera RAW."""
    write_dng(tmp_path / "a.dng", MOSAIC, active=(4, 6, 60, 78))
    shutil.copy(tmp_path / "a.dng", tmp_path / "a.tif")
    image = open_image(tmp_path / "a.tif")
    assert image.shape == (56, 72)
    np.testing.assert_array_equal(image.read(), MOSAIC[4:60, 6:78])
    image.close()


def test_levels_of_each_place_of_the_pattern(tmp_path: Path) -> None:
    black = (50714, "2I", 4, (640, 10, 650, 10, 660, 10, 670, 10))
    path = write(tmp_path / "a.tif", 32803, REPEAT, pattern(1, 0, 2, 1), BLACK_REPEAT, black, (50717, "I", 1, 4000))
    image = open_image(path)
    assert image.metadata["cfa"] == "GRBG" and image.metadata["saturation"] == 4000
    assert image.metadata["black_level"] == (64, 65, 66, 67)
    image.close()


def test_a_monochrome_sensor_has_a_level_and_no_colours(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", 34892, (50714, "H", 1, 64), (50717, "H", 1, 4095))
    image = open_image(path)
    assert image.metadata["black_level"] == 64 and image.metadata["saturation"] == 4095
    assert "cfa" not in image.metadata
    image.close()


@pytest.mark.parametrize(
    ("tags", "words"),
    [
        (
            (),
            r"the pattern of its colour filters .* got a colour mosaic \(photometric interpretation 32803\) without it",
        ),
        ((REPEAT,), "without it; add the tags"),
        ((REPEAT, pattern(0, 1, 2)), "without it; add the tags"),
        ((REPEAT, pattern(0, 1, 2, 1)), "a known colour filter pattern, got 'RGBG'"),
        ((REPEAT, pattern(0, 1, 1, 99)), r"a known colour filter pattern, got 'RGG\?'"),
    ],
)
def test_mosaics_of_unknown_pattern_are_refused(tmp_path: Path, tags: tuple[Any, ...], words: str) -> None:
    with pytest.raises(FileFormatError, match=words):
        open_image(write(tmp_path / "a.tif", 32803, *tags))


def test_tags_that_make_no_sense_say_nothing(tmp_path: Path) -> None:
    tags = ((50714, "2I", 1, (64, 0)), (50717, "I", 1, 0), (50728, "2I", 3, (1, 0, 1, 1, 1, 1)))
    image = open_image(write(tmp_path / "a.tif", 32803, REPEAT, pattern(0, 1, 1, 2), *tags))
    assert not {"black_level", "saturation", "gains"} & set(image.metadata)
    image.close()


def test_frames_of_a_scan_are_a_mosaic(tmp_path: Path) -> None:
    """Greens agree, as in light without colour: a pattern that is wrong is refused by another check."""
    frame = np.full((32, 40), 300, np.uint16) + session((32, 40), top=30)
    for x in range(3):
        write(tmp_path / f"y0_x{x}.tif", 32803, REPEAT, pattern(0, 1, 1, 2), frame=frame + np.uint16(x))
    with open_frames(tmp_path, pattern="y{y}_x{x}.tif") as source:
        assert source.metadata.cfa == "RGGB"
