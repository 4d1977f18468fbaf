"""What the tags of image files state: the codec, which must be lossless, colour mosaics, black and white levels."""

from __future__ import annotations

import shutil
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import h5py
import hdf5plugin
import imagecodecs
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from lfcal.base.errors import FileFormatError, UnsafeFileError
from lfcal.frames import open_frames, open_image
from lfcal.frames.formats.raw import codec_of
from tests.frames.scenes import session, write_dng

FRAME = session((2, 32, 48), top=3000)
SMOOTH = cv2.GaussianBlur(FRAME[0], (0, 0), 3).astype(np.uint16)


def tiff(path: Path, frame: NDArray[Any] = SMOOTH, **how: Any) -> Path:
    tifffile.imwrite(path, frame, photometric="minisblack", metadata=None, **how)
    return path


def with_data(path: Path, frame: NDArray[Any], compression: int, data: bytes) -> Path:
    """Write a TIFF of one strip whose compressed bytes are ``data``."""
    bits = 8 * frame.dtype.itemsize
    entries = [
        *((256, 4, frame.shape[1]), (257, 4, frame.shape[0]), (258, 3, bits), (259, 3, compression), (262, 3, 1)),
        *((273, 4, 8), (277, 3, 1), (278, 4, frame.shape[0]), (279, 4, len(data))),
    ]
    table = b"".join(struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in entries)
    where = 8 + len(data)
    path.write_bytes(b"II*\0" + struct.pack("<I", where) + data + struct.pack("<H", len(entries)) + table + bytes(4))
    return path


def codec(path: Path, expected: NDArray[Any] | None = None) -> dict[str, Any]:
    """Return what the file states of its codec, after comparing its first page."""
    image = open_image(path)
    if expected is not None:
        np.testing.assert_array_equal(image.read(), expected)
    image.close()
    return dict(image.metadata["codec"])


def test_codecs_that_lose_nothing_are_named_by_every_reader(tmp_path: Path) -> None:
    same = {name: name for name in ("lzw", "packbits", "lzma", "zstd", "png")}
    for compression, name in {None: "none", "zlib": "deflate", **same}.items():
        found = codec(tiff(tmp_path / "a.tif", compression=compression), SMOOTH)
        assert found == {"name": name, "lossless": True}
    # headers that say that nothing was lost are believed
    lossless_jpeg = with_data(tmp_path / "j.tif", SMOOTH, 7, imagecodecs.ljpeg_encode(SMOOTH, bitspersample=16))
    assert codec(lossless_jpeg, SMOOTH) == {"name": "lossless JPEG", "lossless": True}
    for how in ({}, {"compressionargs": {"compression": "zstd", "level": 0.0}}):
        assert codec(tiff(tmp_path / "l.tif", compression="lerc", **how), SMOOTH)["name"] == "lossless LERC"
    assert cv2.imwrite(str(tmp_path / "a.png"), SMOOTH) and cv2.imwrite(str(tmp_path / "a.pgm"), SMOOTH)
    np.save(tmp_path / "a.npy", FRAME)
    write_dng(tmp_path / "a.dng", session((64, 80), top=900))
    for name, how in (("plain", {}), ("gzip", {"compression": "gzip"}), ("zstd", dict(hdf5plugin.Zstd()))):
        with h5py.File(tmp_path / f"{name}.h5", "w") as file:
            file.create_dataset("frames", data=FRAME, **({"chunks": (1, 32, 48)} | how if how else {}))
    wanted = {"a.png": "png", "plain.h5": "none", "gzip.h5": "deflate", "zstd.h5": "zstd"}
    for name, known in (wanted | dict.fromkeys(("a.pgm", "a.npy", "a.dng"), "none")).items():
        assert codec(tmp_path / name) == {"name": known, "lossless": True}, name


def test_a_folder_of_frames_passes_the_codec_on(tmp_path: Path) -> None:
    for y, x in np.ndindex(2, 2):
        tiff(tmp_path / f"y{y}_x{x}.tif", SMOOTH + np.uint16(y), compression="lzw")
    with open_frames(tmp_path, pattern="y{y}_x{x}.tif") as source:
        assert source.metadata.codec == {"name": "lzw", "lossless": True}


BYTES = (SMOOTH // 16).astype(np.uint8)
WEBP = imagecodecs.webp_encode(np.repeat(BYTES[..., None], 3, 2), level=80, lossless=False)


def jpeg2000(path: Path, **how: Any) -> Path:
    return tiff(path, compression="jpeg2000", compressionargs={"level": 40, **how})


LOSSY: dict[str, tuple[Callable[[Path], Path], str]] = {
    "JPEG 2000": (lambda p: jpeg2000(p), r"JPEG 2000 \(irreversible\)"),
    # cut short in the reversible transform: the header alone looks as if nothing were lost
    "JPEG 2000, reversible": (lambda p: jpeg2000(p, reversible=True), r"JPEG 2000 \(reversible, but possibly trunc"),
    "JPEG XL": (
        lambda p: tiff(p, compression="jpegxl", compressionargs={"lossless": False, "distance": 3.0}),
        "JPEG XL, which may be lossy",
    ),
    "JPEG XR": (lambda p: tiff(p, compression="jpegxr", compressionargs={"level": 0.7}), "JPEG XR, which may be lossy"),
    "LERC": (lambda p: tiff(p, compression="lerc", compressionargs={"level": 2}), "LERC with errors of up to 2"),
    "LERC of floats": (
        lambda p: tiff(p, SMOOTH.astype(np.float32) / 7, compression="lerc", compressionargs={"level": 0.25}),
        "LERC with errors of up to 0.25",
    ),
    "JPEG": (lambda p: tiff(p, BYTES, compression="jpeg"), "JPEG; record RAW"),
    "WebP": (lambda p: with_data(p, BYTES, 50001, WEBP), "WebP; record RAW"),
    "LogLuv": (lambda p: with_data(p, SMOOTH, 34676, bytes(100)), "LogLuv, which may be lossy"),
    "unknown scheme": (lambda p: with_data(p, SMOOTH, 4711, bytes(100)), r"scheme 4711 \(unknown\)"),
}


def test_codecs_that_lose_something_are_refused(tmp_path: Path) -> None:
    for write, words in LOSSY.values():
        with pytest.raises(FileFormatError, match=f"expected lossless compression, got .*{words}"):
            open_image(write(tmp_path / "a.tif"))
    for data, how in ((FRAME, {"scaleoffset": 4}), (FRAME.astype(np.float32), dict(hdf5plugin.Zfp(rate=4)))):
        with h5py.File(tmp_path / "a.h5", "w") as file:
            file.create_dataset("frames", data=data, chunks=(1, 32, 48), **how)
        with pytest.raises(UnsafeFileError, match="HDF5 filter"):
            open_image(tmp_path / "a.h5")


def test_a_lossy_page_among_lossless_ones_is_found(tmp_path: Path) -> None:
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        for how in ({"compression": "lzw"}, {"compression": "jpegxr", "compressionargs": {"level": 0.5}}):
            file.write(SMOOTH, photometric="minisblack", metadata=None, **how)
    image = open_image(tmp_path / "a.tif")
    np.testing.assert_array_equal(image.read(0), SMOOTH)
    with pytest.raises(FileFormatError, match="expected lossless compression, got JPEG XR"):
        image.read(1)
    image.close()


def test_a_dng_of_lossy_samples_is_refused(tmp_path: Path) -> None:
    """Its mosaic was compressed as a picture: LibRaw gives it back without a word."""
    write_dng(tmp_path / "a.dng", session((64, 80), top=900))
    data = bytearray((tmp_path / "a.dng").read_bytes())
    where = data.index(struct.pack("<HHI", 259, 3, 1)) + 8
    struct.pack_into("<H", data, where, 32767)
    (tmp_path / "sony.dng").write_bytes(bytes(data))
    assert codec_of(tmp_path / "sony.dng") == {"codec": {"name": "Sony ARW", "lossless": False}}
    struct.pack_into("<H", data, where, 34892)
    (tmp_path / "lossy.dng").write_bytes(bytes(data))
    with pytest.raises(FileFormatError, match="got JPEG; record RAW"):
        codec_of(tmp_path / "lossy.dng")
    assert codec_of(Path(__file__)) == {}


# -- colour mosaics and levels -----------------------------------------------------------------------------------------


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
    """Crops and tables of a DNG are applied by the reader of camera RAW."""
    for active, mosaic in ((None, MOSAIC), ((4, 6, 60, 78), MOSAIC[4:60, 6:78])):
        write_dng(tmp_path / "a.dng", MOSAIC, (0, 1, 1, 2), active=active)
        shutil.copy(tmp_path / "a.dng", tmp_path / "a.tif")
        raw, tagged = open_image(tmp_path / "a.dng"), open_image(tmp_path / "a.tif")
        assert tagged.metadata["cfa"] == raw.metadata["cfa"] == "RGGB"
        for key in ("black_level", "saturation", "gains"):
            assert tagged.metadata[key] == pytest.approx(raw.metadata[key]), key
        np.testing.assert_array_equal(tagged.read(), mosaic)
        np.testing.assert_array_equal(raw.read(), mosaic)
        raw.close()
        tagged.close()


BLACK = (50714, "2I", 4, (640, 10, 650, 10, 660, 10, 670, 10))
NONSENSE = ((50714, "2I", 1, (64, 0)), (50717, "I", 1, 0), (50728, "2I", 3, (1, 0, 1, 1, 1, 1)))
TAGS: list[tuple[int, tuple[Any, ...], dict[str, Any]]] = [
    (
        32803,
        (REPEAT, pattern(1, 0, 2, 1), BLACK_REPEAT, BLACK, (50717, "I", 1, 4000)),
        {"cfa": "GRBG", "saturation": 4000, "black_level": (64, 65, 66, 67)},
    ),
    # a monochrome sensor has a level and no colours
    (34892, ((50714, "H", 1, 64), (50717, "H", 1, 4095)), {"black_level": 64, "saturation": 4095}),
    (32803, (REPEAT, pattern(0, 1, 1, 2), *NONSENSE), {"cfa": "RGGB"}),
]


def test_tags_state_pattern_and_levels_as_far_as_they_make_sense(tmp_path: Path) -> None:
    for photometric, tags, known in TAGS:
        image = open_image(write(tmp_path / "a.tif", photometric, *tags))
        stated = {key: image.metadata.get(key) for key in ("cfa", "black_level", "saturation", "gains")}
        assert stated == dict.fromkeys(stated) | known
        image.close()


def test_mosaics_of_unknown_pattern_are_refused(tmp_path: Path) -> None:
    missing = (
        r"the pattern of its colour filters .* got a colour mosaic \(photometric interpretation 32803\) without it"
    )
    for tags, words in (
        ((), missing),
        ((REPEAT,), "without it; add the tags"),
        ((REPEAT, pattern(0, 1, 2)), "without it; add the tags"),
        ((REPEAT, pattern(0, 1, 2, 1)), "a known colour filter pattern, got 'RGBG'"),
        ((REPEAT, pattern(0, 1, 1, 99)), r"a known colour filter pattern, got 'RGG\?'"),
    ):
        with pytest.raises(FileFormatError, match=words):
            open_image(write(tmp_path / "a.tif", 32803, *tags))


def test_frames_of_a_scan_are_a_mosaic(tmp_path: Path) -> None:
    """Greens agree, as in light without colour: a pattern that is wrong is refused by another check."""
    frame = np.full((32, 40), 300, np.uint16) + session((32, 40), top=30)
    for x in range(3):
        write(tmp_path / f"y0_x{x}.tif", 32803, REPEAT, pattern(0, 1, 1, 2), frame=frame + np.uint16(x))
    with open_frames(tmp_path, pattern="y{y}_x{x}.tif") as source:
        assert source.metadata.cfa == "RGGB"
