"""PNG frames: the length and checksum of every chunk are checked before the pixels are decoded."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import FileFormatError, format_pixels, njit, storage_errors
from lfcal.frames.formats._decoder_messages import caught_messages
from lfcal.frames.formats.codecs import codec_fact
from lfcal.frames.formats.image_file import Format, ImageFile, check_declared, check_grey, decoding

__all__ = ["PngImage", "samples_of", "unfilter"]

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_COMPONENTS = {0: 1, 2: 3, 4: 2, 6: 4}
_COLOURS = {"B": 0, "G": 1, "R": 2}  # the order of components in OpenCV

PIXEL_S = 2e-8
"""Additional processor time (s) per pixel of a decoder that does not need `unfilter`."""


class PngImage(ImageFile):
    """A PNG file of one 8- or 16-bit grey frame, or one component of a colour image."""

    def __init__(self, path: Path, colour: str | None = None) -> None:
        self.path = path
        with storage_errors(path):
            stored = path.stat().st_size
            with path.open("rb") as file:
                head = file.read(33)
        if len(head) < 33 or head[:8] != _SIGNATURE or head[12:16] != b"IHDR":
            raise self._damaged("no header")
        columns, rows, bits, kind = struct.unpack(">IIBB", head[16:26])
        self._plain = kind == 0 and head[28] == 0  # grey, rows in order
        if kind not in _COMPONENTS or bits not in (8, 16):
            what = "a palette" if kind == 3 else f"{bits}-bit samples"
            raise FileFormatError.expected(
                str(path), "8- or 16-bit grey samples", what, "record it as 16-bit grey PNG or TIFF"
            )
        check_grey(path, _COMPONENTS[kind], colour, bits)
        check_declared(path, (rows, columns, _COMPONENTS[kind]), bits // 8, stored)
        self.shape = (rows, columns)
        self.dtype = np.dtype(np.uint8 if bits == 8 else np.uint16)
        self._component = _COLOURS[colour] if colour is not None and _COMPONENTS[kind] > 1 else None
        self.metadata = {"codec": codec_fact("png")} | ({"colour": colour} if self._component is not None else {})

    def read(self, page: int = 0) -> NDArray[Any]:
        """Return the frame, ``(rows, columns)``."""
        self.check_page(page)
        with storage_errors(self.path):
            data = self.path.read_bytes()
        stream = self._check_chunks(data)
        image = self._inflate(stream, data) if self._plain else self._decode(data)
        if image.shape != self.shape or image.dtype != self.dtype:
            raise self._damaged(
                f"{image.dtype}, {format_pixels(image.shape)}, where the header says {self.dtype}, "
                f"{format_pixels(self.shape)}"
            )
        return image

    def _inflate(self, stream: bytes, data: bytes) -> NDArray[Any]:
        """Return a grey image, decompressed by libdeflate, which takes half the time of zlib in other decoders.

        If compiling `unfilter` would take longer than it saves, another decoder reads ``data``, the whole file.
        """
        (rows, columns), size = self.shape, self.dtype.itemsize
        need = rows * (1 + columns * size)
        with decoding(self.path, "PNG"):
            import imagecodecs

            raw = imagecodecs.deflate_decode(stream, out=need)
        if len(raw) != need:
            raise self._damaged("missing pixels")
        if unfilter.spared(PIXEL_S * rows * columns):
            with decoding(self.path, "PNG"):
                return np.asarray(imagecodecs.png_decode(data))
        image = np.empty((rows, columns * size), np.uint8)
        bad = unfilter(np.frombuffer(raw, np.uint8), size, image)
        if bad >= 0:
            raise self._damaged(f"an unknown filter in row {bad}")
        return samples_of(image, self.dtype)

    def _decode(self, data: bytes) -> NDArray[Any]:
        """Return one component of a colour image, or an interlaced grey image."""
        from lfcal.base import cv2

        with decoding(self.path, "PNG"), caught_messages():
            image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        if image is None:
            raise self._damaged("pixels that cannot be decoded")
        if self._component is not None and image.ndim == 3:
            image = np.ascontiguousarray(image[..., self._component])
        return np.asarray(image)

    def _check_chunks(self, data: bytes) -> bytes:
        """Check all chunks up to IEND, and return their deflate stream; raise `FileFormatError` for a damaged file."""
        view, at, parts = memoryview(data), 8, []
        while True:
            if at + 12 > len(data):
                raise self._damaged("the end is missing")
            (length,) = struct.unpack_from(">I", data, at)
            stop = at + 8 + length
            if stop + 4 > len(data):
                raise self._damaged("the end is missing")
            if zlib.crc32(view[at + 4 : stop]) != struct.unpack_from(">I", data, stop)[0]:
                raise self._damaged(f"a wrong checksum at byte {at}")
            name = data[at + 4 : at + 8]
            if name == b"IDAT":
                parts.append(view[at + 8 : stop])
            if name == b"IEND":
                return b"".join(parts)
            at = stop + 4

    def _damaged(self, reason: str) -> FileFormatError:
        return FileFormatError.expected(
            str(self.path), "an intact PNG file", f"damaged data ({reason})", "record or copy it again"
        )


FORMAT = Format(
    "PNG",
    frozenset({".png"}),
    lambda head, _: head.startswith(b"\x89PNG\r\n\x1a\n"),
    lambda path, colour, _: PngImage(path, colour),
)


@njit(_nrt=False)
def unfilter(raw: NDArray[np.uint8], pixel_bytes: int, out: NDArray[np.uint8]) -> int:
    """Undo the row filters of a PNG image; return the index of the first invalid row, or -1 if all are valid.

    Let a be the byte one pixel to the left, b the byte above and c the byte above a, each 0 outside the image. The
    first byte of a row selects its filter: each byte x is stored as x minus 0, a, b, floor((a + b) / 2) or Paeth(a, b,
    c), modulo 256. Paeth(a, b, c) is the one of a, b and c that is closest to a + b - c.

    Parameters
    ----------
    raw
        Decompressed stream: for each row, the number of its filter and its bytes.
    pixel_bytes
        Bytes per pixel.
    out
        Array ``(rows, bytes)`` to fill with the image's bytes.
    """
    rows, stride = out.shape
    for r in range(rows):
        start = r * (stride + 1)
        kind = raw[start]
        line = raw[start + 1 : start + 1 + stride]
        here = out[r]
        if kind == 0:
            for i in range(
                stride
            ):  # a loop, because vector operations on arrays of different length take longer to compile
                here[i] = line[i]
        elif kind == 1:
            for i in range(stride):
                left = here[i - pixel_bytes] if i >= pixel_bytes else np.uint8(0)
                here[i] = np.uint8(line[i] + left)
        elif kind == 2:
            for i in range(stride):
                above = out[r - 1, i] if r > 0 else np.uint8(0)
                here[i] = np.uint8(line[i] + above)
        elif kind == 3:
            for i in range(stride):
                # in wider integers: the sum of two bytes must not overflow before it is halved
                left = np.int32(here[i - pixel_bytes]) if i >= pixel_bytes else np.int32(0)
                above = np.int32(out[r - 1, i]) if r > 0 else np.int32(0)
                here[i] = np.uint8(np.int32(line[i]) + ((left + above) >> 1))
        elif kind == 4:
            for i in range(stride):
                a = np.int32(here[i - pixel_bytes]) if i >= pixel_bytes else np.int32(0)
                b = np.int32(out[r - 1, i]) if r > 0 else np.int32(0)
                c = np.int32(out[r - 1, i - pixel_bytes]) if r > 0 and i >= pixel_bytes else np.int32(0)
                # the neighbour closest to a + b - c, in the order a, b, c
                near_a, near_b, near_c = abs(b - c), abs(a - c), abs(a + b - 2 * c)
                best = a if near_a <= near_b and near_a <= near_c else (b if near_b <= near_c else c)
                here[i] = np.uint8(np.int32(line[i]) + best)
        else:
            return r
    return -1


def samples_of(image: NDArray[np.uint8], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return big-endian bytes ``(rows, bytes)`` as samples ``(rows, columns)`` in native byte order."""
    return image.view(dtype.newbyteorder(">")).astype(dtype, copy=False)
