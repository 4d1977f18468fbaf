"""Compiled loops of the microscope's separable path: V = A_y U A_x^T on the sensor's nodes (see `microscope.py`).

Complex products use three real ones (Gauss). Parts are stored as real, imaginary and their sum; with the products p, q,
s of like parts, re = p - q and im = s - p - q. Every product stays below 2^18 multiply-adds, below which BLAS libraries
do not start threads. The largest products are in `_tile_llvm.py`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import njit

__all__ = ["fold_rows", "in_blocks", "pixel_sums", "product"]

Array = NDArray[Any]
_SMALL = 1 << 18  # multiply-adds


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
def fold_rows(wide: Array, row_of: Array, middle: Array, out: Array) -> None:
    """Fill the matrices for even and, if there are any, odd fields.

    Node r responds to a sample k on either side as ``wide[row_of[r], middle[r] -+ k]``. A sample and its mirror image
    share one column of A, in ``out`` (parities, 3, nodes, n): the sum of both for an even field in out[0], their
    difference for an odd one in out[1]. The middle sample counts once, and an odd field is 0 there.
    """
    for r in range(row_of.size):
        line, m = wide[row_of[r]], middle[r]
        for parity in range(out.shape[0]):
            sign = np.float32(1 - 2 * parity)
            re, im, both = out[parity, 0, r], out[parity, 1, r], out[parity, 2, r]
            re[0], im[0] = (1 - parity) * line[m].real, (1 - parity) * line[m].imag
            for k in range(1, out.shape[3]):
                re[k] = line[m - k].real + sign * line[m + k].real
                im[k] = line[m - k].imag + sign * line[m + k].imag
            for k in range(out.shape[3]):
                both[k] = re[k] + im[k]


@njit()
def in_blocks(value: Array, across: int) -> Array:
    """Return ``value`` (3, k, n) transposed and in blocks of columns ``(3, blocks, n, across)``, padded with zeros."""
    k, n = value.shape[1], value.shape[2]
    out = np.zeros((3, (k + across - 1) // across, n, across), value.dtype)
    for part in range(3):
        for i in range(k):
            for c in range(n):
                out[part, i // across, c, i % across] = value[part, i, c]
    return out


@njit(fastmath=True)
def pixel_sums(lines: Array, runs: Array, weights: Array, out: Array) -> None:
    """Fill ``out`` (nt, ns) with the light of ``lines`` (nt, nodes along x) on each pixel.

    ``runs`` has first node, first pixel and number of each run of neighbouring pixels whose nodes are neighbours too;
    all have the same weight.
    """
    for t in range(out.shape[0]):
        line, sums = lines[t], out[t]
        sums[:] = 0
        for k in range(weights.size):
            node, pixel, count = runs[k]
            taken, found = line[node : node + count], sums[pixel : pixel + count]
            for i in range(count):
                found[i] += weights[k] * taken[i]
