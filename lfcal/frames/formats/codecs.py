"""Compression of samples in files: which codecs are lossless, from a list and from the header of the data."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lfcal.base import FileFormatError

__all__ = ["LOSSLESS", "check_tiff_codec", "codec_fact"]

LOSSLESS = {
    1: "none",
    5: "lzw",
    8: "deflate",
    32773: "packbits",
    32946: "deflate",
    34925: "lzma",
    34926: "zstd",
    34933: "png",
    50000: "zstd",
    50013: "deflate",
}
"""Lossless compression schemes of TIFF."""

JPEG = {6, 7, 33007, 34892}
WEBP = {34927, 50001}
LERC = 34887
JPEG_2000 = {33003, 33004, 33005, 34712}
OTHERS = {22610: "JPEG XR", 34934: "JPEG XR", 50002: "JPEG XL", 52546: "JPEG XL", 34676: "LogLuv", 34677: "LogLuv"}
"""Schemes whose header is not read here."""

REMEDY = "record RAW, or TIFF with LZW, deflate or no compression"


def codec_fact(name: str, *, lossless: bool = True) -> dict[str, Any]:
    """Return the metadata entry ``codec``: the ``name`` of a compression scheme, and whether it is ``lossless``."""
    return {"name": name, "lossless": lossless}


def check_tiff_codec(path: Path, compression: int, stored: Callable[[], bytes], *, whole: bool = False) -> str:
    """Return the name of a TIFF file's compression scheme, after checking that it is lossless.

    "lossless " precedes the name of a scheme that may also be lossy.

    Parameters
    ----------
    path
        The file, for messages.
    compression
        Value of the file's tag ``Compression``.
    stored
        Function that returns the first bytes of compressed data; called only for schemes that may be lossless or lossy.
    whole
        Whether samples are integers, so that compression with errors of at most one half is lossless.

    Raises
    ------
    FileFormatError
        If the scheme is unknown, or may be lossy.
    """
    if compression in LOSSLESS:
        return LOSSLESS[compression]
    if compression in JPEG:
        name, lossless = "JPEG", compression != 34892 and _jpeg_frame(stored()) in (0xC3, 0xC7, 0xCB, 0xCF)
    elif compression in WEBP:
        name, lossless = "WebP", stored()[12:16] == b"VP8L"
    elif compression == LERC:
        name, error = "LERC", _lerc_error(stored())
        lossless = error is not None and error <= (0.5 if whole else 0.0)
        name = name if error is None or lossless else f"LERC with errors of up to {error:g}"
    elif compression in JPEG_2000:
        name, lossless = _jpeg_2000(stored()), False
    else:
        name, lossless = OTHERS.get(compression, f"compression scheme {compression}"), False
        name += ", which may be lossy" if compression in OTHERS else " (unknown)"
    if not lossless:
        raise FileFormatError.expected(str(path), "lossless compression", name, REMEDY)
    return "lossless " + name


def _jpeg_frame(data: bytes) -> int:
    """Return the marker of a JPEG's frame header: C3, C7, CB and CF are lossless processes; 0 without one."""
    at = 2
    while data[:2] == b"\xff\xd8" and at + 4 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            return marker
        at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return 0


def _lerc_error(data: bytes) -> float | None:
    """Return the largest error that a LERC header allows; None if it cannot be read."""
    import imagecodecs

    try:
        if data[:4] == b"\x28\xb5\x2f\xfd":
            data = bytes(imagecodecs.zstd_decode(data))
        elif data[:1] == b"\x78":
            data = bytes(imagecodecs.zlib_decode(data))
    except Exception:
        return None
    if data[:6] != b"Lerc2 ":
        return None
    (version,) = struct.unpack_from("<i", data.ljust(90, b"\0"), 6)
    # magic, version, checksum (3), rows, columns, depth (4), valid pixels, block, bytes, type; 6 adds two fields
    fields = 6 + (version >= 3) + (version >= 4) + (version >= 6)
    at = 10 + 4 * fields + (4 if version >= 6 else 0)
    return float(struct.unpack_from("<d", data, at)[0]) if len(data) >= at + 8 and 1 <= version <= 6 else None


def _jpeg_2000(data: bytes) -> str:
    """Return the mode stated in a JPEG 2000 stream; even a reversible one may have been truncated to save bytes."""
    at = data.find(b"\xff\x52") + 13  # the transformation is the last byte of every coding style
    kind = data[at] if 13 <= at < len(data) else None
    words = {0: "irreversible", 1: "reversible, but possibly truncated"}
    return f"JPEG 2000 ({'damaged' if kind is None else words.get(kind, 'unknown')})"
