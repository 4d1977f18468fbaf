"""Frames, files and folders that the tests of this package share."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

SHARED = Path(__file__).parents[3] / "shared" / "data"
"""Measured files that are not part of the project."""


def shared(name: str) -> Path:
    """Return a measured file, or skip the test where the folder is absent."""
    path = SHARED / name
    if not path.exists():
        pytest.skip(f"needs the measured file {name} in ../shared/data")
    return path


def session(shape: tuple[int, ...] = (2, 3, 4, 20, 30), seed: int = 1, top: int = 4000) -> NDArray[np.uint16]:
    """Return frames ``(z, y, x, row, column)`` of noise, each another one."""
    return np.random.default_rng(seed).integers(10, top, shape).astype(np.uint16)


def write_pngs(folder: Path, frames: NDArray[np.uint16]) -> list[str]:
    """Write one PNG per position and return the names."""
    names = []
    for z, y, x in np.ndindex(*frames.shape[:3]):
        names.append(f"z{z}_y{y}_x{x}.png")
        assert cv2.imwrite(str(folder / names[-1]), frames[z, y, x])
    return names


def write_dng(
    path: Path,
    mosaic: NDArray[np.uint16],
    pattern: tuple[int, int, int, int] = (1, 0, 2, 1),
    active: tuple[int, int, int, int] | None = None,
    orientation: int = 1,
) -> None:
    """Write a minimal DNG; ``pattern`` counts red, green and blue as 0, 1 and 2."""
    tags = [
        (33421, "H", 2, (2, 2), True),
        (33422, "B", 4, pattern, True),
        (50706, "B", 4, (1, 4, 0, 0), True),
        (50707, "B", 4, (1, 1, 0, 0), True),
        (50708, "s", 0, "Test", True),
        (50714, "H", 1, 64, True),
        (50717, "H", 1, 1023, True),
        (50721, "2i", 9, (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1), True),
        (50728, "2I", 3, (1, 2, 1, 1, 1, 4), True),
        (50778, "H", 1, 21, True),
    ]
    if orientation != 1:
        tags.append((274, "H", 1, orientation, True))
    if active is not None:
        tags.append((50829, "H", 4, active, True))
    tifffile.imwrite(path, mosaic, photometric=32803, extratags=tags, metadata=None, subfiletype=0)


def png_chunk(kind: bytes, data: bytes) -> bytes:
    """Return one PNG chunk with its checksum."""
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png_bytes(rows: int, columns: int, bits: int, kind: int, pixels: bytes) -> bytes:
    """Return a PNG file with any header."""
    head = struct.pack(">IIBBBBB", columns, rows, bits, kind, 0, 0, 0)
    body = png_chunk(b"IHDR", head) + png_chunk(b"IDAT", zlib.compress(pixels)) + png_chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body
