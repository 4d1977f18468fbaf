"""Grey PNG against libpng (through OpenCV), for every row filter, size and depth."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfcal.base.errors import FileFormatError
from lfcal.frames import read_image


def chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def png(image: np.ndarray, filters: list[int], *, rows: bytes | None = None, parts: int = 1) -> bytes:
    """Write a grey PNG with the given filter of each row; the bytes of filtered rows may be given instead."""
    size = image.dtype.itemsize
    raw = image.astype(image.dtype.newbyteorder(">")).view(np.uint8).reshape(len(image), -1).astype(int)
    stream = b""
    for r, line in enumerate(raw):
        above = raw[r - 1] if r else np.zeros_like(line)
        left = np.concatenate([np.zeros(size, int), line[:-size]])
        corner = np.concatenate([np.zeros(size, int), above[:-size]])
        p = left + above - corner
        near = [np.abs(p - left), np.abs(p - above), np.abs(p - corner)]
        paeth = np.where((near[0] <= near[1]) & (near[0] <= near[2]), left, np.where(near[1] <= near[2], above, corner))
        guess = [0, left, above, (left + above) // 2, paeth][filters[r]]
        stream += bytes([filters[r]]) + ((line - guess) % 256).astype(np.uint8).tobytes()
    packed = zlib.compress(stream if rows is None else rows)
    header = struct.pack(">IIBBBBB", image.shape[1], image.shape[0], 8 * size, 0, 0, 0, 0)
    step = -(-len(packed) // parts)
    idat = b"".join(chunk(b"IDAT", packed[k : k + step]) for k in range(0, len(packed), step))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + idat + chunk(b"IEND", b"")


@given(st.data())
@settings(derandomize=True, deadline=None, max_examples=80)
def test_every_filter_against_libpng(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    rows, columns = data.draw(st.integers(1, 9)), data.draw(st.integers(1, 17))
    dtype = data.draw(st.sampled_from([np.uint8, np.uint16]))
    filters = data.draw(st.lists(st.integers(0, 4), min_size=rows, max_size=rows))
    rng = np.random.default_rng(data.draw(st.integers(0, 1000)))
    image = rng.integers(0, np.iinfo(dtype).max, (rows, columns), dtype, endpoint=True)
    path = tmp_path_factory.mktemp("png") / "a.png"
    path.write_bytes(png(image, filters, parts=data.draw(st.integers(1, 3))))
    np.testing.assert_array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), image, err_msg="the test's writer")
    found = read_image(path)
    np.testing.assert_array_equal(found, image)
    assert found.dtype == dtype and found.dtype.isnative


def test_streams_that_lie(tmp_path: Path) -> None:
    image = np.arange(12, dtype=np.uint16).reshape(3, 4)
    cases = {
        "an unknown filter in row 1": b"\x00" + bytes(8) + b"\x07" + bytes(8) + b"\x00" + bytes(8),
        "missing pixels": b"\x00" + bytes(8),
    }
    for word, rows in cases.items():
        (tmp_path / "a.png").write_bytes(png(image, [0, 0, 0], rows=rows))
        with pytest.raises(FileFormatError, match=f"a.png: expected an intact PNG file, got damaged data .*{word}"):
            read_image(tmp_path / "a.png")
    (tmp_path / "b.png").write_bytes(png(image, [0, 0, 0], rows=bytes(1000)))
    with pytest.raises(FileFormatError, match="intact PNG file"):
        read_image(tmp_path / "b.png")


def test_interlaced_images_still_open(tmp_path: Path) -> None:
    """One pixel is the same interlaced or not."""
    data = bytearray(png(np.array([[513]], np.uint16), [0]))
    data[28] = 1
    data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    (tmp_path / "a.png").write_bytes(data)
    assert read_image(tmp_path / "a.png").tolist() == [[513]]
