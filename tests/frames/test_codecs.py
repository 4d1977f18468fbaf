"""Codecs that lose something are refused, whichever they are; those that lose nothing are named."""

from __future__ import annotations

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


@pytest.mark.parametrize(
    ("compression", "name"),
    [
        (None, "none"),
        ("lzw", "lzw"),
        ("zlib", "deflate"),
        ("packbits", "packbits"),
        ("lzma", "lzma"),
        ("zstd", "zstd"),
        ("png", "png"),
    ],
)
def test_schemes_that_lose_nothing_are_named(tmp_path: Path, compression: str | None, name: str) -> None:
    image = open_image(tiff(tmp_path / "a.tif", compression=compression))
    assert image.metadata["codec"] == {"name": name, "lossless": True}
    np.testing.assert_array_equal(image.read(), SMOOTH)
    image.close()


LOSSY: dict[str, tuple[Callable[[Path], Path], str]] = {
    "JPEG 2000": (
        lambda p: tiff(p, compression="jpeg2000", compressionargs={"level": 40}),
        r"JPEG 2000 \(irreversible\)",
    ),
    # cut short in the reversible transform: the header alone looks as if nothing were lost
    "JPEG 2000, reversible": (
        lambda p: tiff(p, compression="jpeg2000", compressionargs={"level": 40, "reversible": True}),
        r"JPEG 2000 \(reversible, but possibly truncated\)",
    ),
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
    "JPEG": (lambda p: tiff(p, (SMOOTH // 16).astype(np.uint8), compression="jpeg"), "JPEG; record RAW"),
    "WebP": (
        lambda p: with_data(
            p,
            (SMOOTH // 16).astype(np.uint8),
            50001,
            imagecodecs.webp_encode(
                np.repeat((SMOOTH // 16).astype(np.uint8)[..., None], 3, 2), level=80, lossless=False
            ),
        ),
        "WebP; record RAW",
    ),
    "LogLuv": (lambda p: with_data(p, SMOOTH, 34676, bytes(100)), "LogLuv, which may be lossy"),
    "unknown scheme": (lambda p: with_data(p, SMOOTH, 4711, bytes(100)), r"scheme 4711 \(unknown\)"),
}


@pytest.mark.parametrize("kind", LOSSY)
def test_schemes_that_lose_something_are_refused(tmp_path: Path, kind: str) -> None:
    write, words = LOSSY[kind]
    with pytest.raises(FileFormatError, match=f"expected lossless compression, got .*{words}"):
        open_image(write(tmp_path / "a.tif"))


def test_headers_that_say_that_nothing_was_lost_are_believed(tmp_path: Path) -> None:
    lossless_jpeg = imagecodecs.ljpeg_encode(SMOOTH, bitspersample=16)
    kinds = {
        "lossless JPEG": with_data(tmp_path / "j.tif", SMOOTH, 7, lossless_jpeg),
        "lossless LERC": tiff(tmp_path / "l.tif", compression="lerc"),
    }
    for name, path in kinds.items():
        image = open_image(path)
        assert image.metadata["codec"] == {"name": name, "lossless": True}
        np.testing.assert_array_equal(image.read(), SMOOTH)
        image.close()
    squeezed = tiff(tmp_path / "z.tif", compression="lerc", compressionargs={"compression": "zstd", "level": 0.0})
    open_image(squeezed).close()


def test_a_lossy_page_among_lossless_ones_is_found(tmp_path: Path) -> None:
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        file.write(SMOOTH, photometric="minisblack", metadata=None, compression="lzw")
        file.write(
            SMOOTH, photometric="minisblack", metadata=None, compression="jpegxr", compressionargs={"level": 0.5}
        )
    image = open_image(tmp_path / "a.tif")
    np.testing.assert_array_equal(image.read(0), SMOOTH)
    with pytest.raises(FileFormatError, match="expected lossless compression, got JPEG XR"):
        image.read(1)
    image.close()


def test_every_reader_names_its_codec(tmp_path: Path) -> None:
    assert cv2.imwrite(str(tmp_path / "a.png"), SMOOTH) and cv2.imwrite(str(tmp_path / "a.pgm"), SMOOTH)
    np.save(tmp_path / "a.npy", FRAME)
    write_dng(tmp_path / "a.dng", session((64, 80), top=900))
    for name, how in (("plain", {}), ("gzip", {"compression": "gzip"}), ("zstd", dict(hdf5plugin.Zstd()))):
        with h5py.File(tmp_path / f"{name}.h5", "w") as file:
            file.create_dataset("frames", data=FRAME, **({"chunks": (1, 32, 48)} | how if how else {}))
    wanted = {
        **{"a.png": "png", "a.pgm": "none", "a.npy": "none", "a.dng": "none"},
        **{"plain.h5": "none", "gzip.h5": "deflate", "zstd.h5": "zstd"},
    }
    for name, codec in wanted.items():
        image = open_image(tmp_path / name)
        assert image.metadata["codec"] == {"name": codec, "lossless": True}, name
        image.close()


def test_hdf5_filters_that_lose_something_are_refused(tmp_path: Path) -> None:
    for name, how in (("scale-offset", {"scaleoffset": 4}), ("zfp", dict(hdf5plugin.Zfp(rate=4)))):
        with h5py.File(tmp_path / "a.h5", "w") as file:
            data = FRAME if name == "scale-offset" else FRAME.astype(np.float32)
            file.create_dataset("frames", data=data, chunks=(1, 32, 48), **how)
        with pytest.raises(UnsafeFileError, match="HDF5 filter"):
            open_image(tmp_path / "a.h5")


def test_a_folder_of_frames_passes_the_codec_on(tmp_path: Path) -> None:
    for y, x in np.ndindex(2, 2):
        tiff(tmp_path / f"y{y}_x{x}.tif", SMOOTH + np.uint16(y), compression="lzw")
    with open_frames(tmp_path, pattern="y{y}_x{x}.tif") as source:
        assert source.metadata.codec == {"name": "lzw", "lossless": True}


def test_a_dng_of_lossy_samples_is_refused(tmp_path: Path) -> None:
    """Its mosaic was compressed as a picture: LibRaw gives it back without a word."""
    write_dng(tmp_path / "a.dng", session((64, 80), top=900))
    data = bytearray((tmp_path / "a.dng").read_bytes())
    where = data.index(struct.pack("<HHI", 259, 3, 1)) + 8
    struct.pack_into("<H", data, where, 32767)
    (tmp_path / "sony.dng").write_bytes(bytes(data))
    from lfcal.frames.formats.raw import codec_of

    assert codec_of(tmp_path / "sony.dng") == {"codec": {"name": "Sony ARW", "lossless": False}}
    struct.pack_into("<H", data, where, 34892)
    (tmp_path / "lossy.dng").write_bytes(bytes(data))
    with pytest.raises(FileFormatError, match="got JPEG; record RAW"):
        codec_of(tmp_path / "lossy.dng")
    assert codec_of(Path(__file__)) == {}
