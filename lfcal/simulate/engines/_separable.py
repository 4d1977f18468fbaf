"""Compiled loops of the microscope's separable path: V = A_y U A_x^T on the sensor's nodes (see `microscope.py`).

Complex products use three real ones (Gauss): with parts stored as real, imaginary and their sum, re = p - q and
im = s - p - q for p, q, s the products of like parts. Every product stays below 2^18 multiply-adds, below which BLAS
libraries do not start threads.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import njit

__all__ = ["fold_rows", "in_blocks", "node_light", "pixel_sums", "product"]

Array = NDArray[Any]
_SMALL = 1 << 18  # multiply-adds
_ROWS = 64  # rows of a block of a product, such that the output stays in the first-level cache


@njit(fastmath=True)
def product(a: Array, b: Array) -> Array:
    """Return a @ b for complex a (3, k, n) and b (3, n, w), parts (3, k, w).

    With p = Re Re, q = Im Im and s = (Re + Im)(Re + Im): Re = p - q, Im = s - p - q.
    """
    k, n, w = a.shape[1], a.shape[2], b.shape[2]
    out = np.empty((3, k, w), a.dtype)
    rows = max(1, _SMALL // (n * w))
    for i in range(0, k, rows):
        j = min(i + rows, k)
        # the third part is computed here, for the next product
        p, q, s = np.dot(a[0, i:j], b[0]), np.dot(a[1, i:j], b[1]), np.dot(a[2, i:j], b[2])
        for r in range(j - i):
            for c in range(w):
                re, im = p[r, c] - q[r, c], s[r, c] - p[r, c] - q[r, c]
                out[0, i + r, c], out[1, i + r, c], out[2, i + r, c] = re, im, re + im
    return out


@njit()
def fold_rows(wide: Array, first: int, per_node: int, start: int, per_sample: int, out: Array) -> None:
    """Fill rows ``first``, ``first + per_sample`` ... of the matrices for even and, if there are any, odd fields.

    ``wide`` (3, rows, distances) has row r's response to sample k at ``start + per_node r -+ k``. A sample and its
    mirror image share one column of A, in ``out`` (parities, 3, nodes, n): out[0, :, r, k] = wide(-k) + wide(+k) for
    an even field, out[1, :, r, k] = wide(-k) - wide(+k) for an odd one; the middle one counts once, and an odd field
    is 0 there.
    """
    for part in range(3):
        for r in range(wide.shape[1]):
            middle, row = start + per_node * r, first + per_sample * r
            out[0, part, row, 0] = wide[part, r, middle]
            for k in range(1, out.shape[3]):
                out[0, part, row, k] = wide[part, r, middle - k] + wide[part, r, middle + k]
            if out.shape[0] == 1:
                continue
            out[1, part, row, 0] = 0
            for k in range(1, out.shape[3]):
                out[1, part, row, k] = wide[part, r, middle - k] - wide[part, r, middle + k]


@njit()
def in_blocks(value: Array) -> Array:
    """Return ``value`` (3, k, n) transposed and cut into blocks of columns: ``(3, blocks, n, w)``.

    Each block is contiguous and small enough for one product; the last one is padded with zeros.
    """
    k, n = value.shape[1], value.shape[2]
    width = max(1, _SMALL // (_ROWS * n))
    out = np.zeros((3, (k + width - 1) // width, n, width), value.dtype)
    for part in range(3):
        for i in range(k):
            for c in range(n):
                out[part, i // width, c, i % width] = value[part, i, c]
    return out


@njit(fastmath=True)
def node_light(left: Array, a: Array, light: Array) -> None:
    """Add |sum_n a[x, n] left[n, y]|^2 to ``light`` (kx, >= ky); ``left`` from `in_blocks`, a (3, kx, n).

    Blocks are squared while the product is in the caches; the field itself is never stored.
    """
    blocks, width = left.shape[1], left.shape[3]
    kx = a.shape[1]
    p = np.empty((_ROWS, width), a.dtype)
    q, s = np.empty_like(p), np.empty_like(p)
    for y in range(blocks):
        for x in range(0, kx, _ROWS):
            b = min(_ROWS, kx - x)
            np.dot(a[0, x : x + b], left[0, y], p[:b])
            np.dot(a[1, x : x + b], left[1, y], q[:b])
            np.dot(a[2, x : x + b], left[2, y], s[:b])
            for i in range(b):
                for j in range(width):
                    re, im = p[i, j] - q[i, j], s[i, j] - p[i, j] - q[i, j]
                    light[x + i, y * width + j] += re * re + im * im


@njit(fastmath=True)
def pixel_sums(light: Array, weights: Array, per: int, out: Array) -> None:
    """Fill ``out`` (nt, ns) with the weighted sums of ``light`` (nodes along x, along y) over each pixel.

    Pixel (t, s) is sum_ij weights[i] weights[j] light[s per + i, t per + j] (see `nodes.py`).
    """
    taps = weights.size
    line = np.empty(light.shape[1], light.dtype)
    for s in range(out.shape[1]):
        line[:] = 0  # first along the memory order, vectorized: the pixels of a column share these sums
        for i in range(taps):
            for j in range(line.size):
                line[j] += weights[i] * light[s * per + i, j]
        for t in range(out.shape[0]):
            total = weights[0] * line[t * per]
            for j in range(1, taps):
                total += weights[j] * line[t * per + j]
            out[t, s] = total
