"""The inverse of PNG's row filters (PNG specification, third edition, section 9)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import njit

__all__ = ["samples_of", "unfilter"]


@njit()
def unfilter(raw: NDArray[np.uint8], pixel_bytes: int, out: NDArray[np.uint8]) -> int:
    """Undo the row filters of a PNG image; return the number of the first bad row, or -1.

    With a the byte one pixel to the left, b the byte above and c the byte above a (0 outside the image), each byte
    x of a row was stored as x minus 0, a, b, floor((a + b) / 2) or Paeth(a, b, c), modulo 256, as the row's first
    byte says.

    Parameters
    ----------
    raw
        Inflated stream: per row the filter's number and the row's bytes.
    pixel_bytes
        Bytes per pixel.
    out
        ``(rows, bytes)``, filled with the image's bytes.
    """
    rows, stride = out.shape
    for r in range(rows):
        start = r * (stride + 1)
        kind = raw[start]
        line = raw[start + 1 : start + 1 + stride]
        here = out[r]
        if kind == 0:
            for i in range(stride):  # not at once: for arrays whose lengths may differ far more is compiled
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
                # in wider integers: the sum of two bytes must not wrap before it is halved
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
    """Return the bytes ``(rows, bytes)`` as samples ``(rows, columns)`` in native byte order."""
    return image.view(dtype.newbyteorder(">")).astype(dtype, copy=False)
