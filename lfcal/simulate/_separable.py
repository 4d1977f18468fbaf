"""Compiled loops of the microscope's separable path."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.threads import njit

__all__ = ["left_product", "respond"]

Array = NDArray[Any]
_SMALL = 1 << 18  # multiply-adds below which BLAS libraries start no threads
_BLOCK = 32


@njit(fastmath=True)
def left_product(a: Array, field: Array, out: Array) -> None:
    """Write ``out[c] = (a @ field)^T`` for complex a (2, k, n), field (2, n, n), out (2, n, k); parts first."""
    k, n = a.shape[1], a.shape[2]
    rows = max(1, _SMALL // (n * n))
    for i in range(0, k, rows):
        j = min(i + rows, k)
        rr, ii = np.dot(a[0, i:j], field[0]), np.dot(a[1, i:j], field[1])
        ri, ir = np.dot(a[0, i:j], field[1]), np.dot(a[1, i:j], field[0])
        for r in range(j - i):
            for c in range(n):
                out[0, c, i + r] = rr[r, c] - ii[r, c]
                out[1, c, i + r] = ri[r, c] + ir[r, c]


@njit(fastmath=True)
def respond(left: Array, a: Array, weights_y: Array, weights_x: Array, per: int, out: Array) -> None:
    """Fill ``out`` (nt, ns) from ``left`` (2, n, ky), the field by rows, and the columns' matrix ``a`` (2, kx, n).

    The field at node (y, x) is sum_n left[n, y] a[x, n]; its square is summed over pixels by the node weights.
    """
    n, ky = left.shape[1], left.shape[2]
    kx = a.shape[1]
    width = max(1, min(ky, _SMALL // (2 * _BLOCK * n)))
    light = np.empty((kx, ky), left.dtype)
    stack = np.empty((2 * _BLOCK, n), left.dtype)
    for y in range(0, ky, width):
        w = min(width, ky - y)
        right_re, right_im = left[0, :, y : y + w].copy(), left[1, :, y : y + w].copy()
        for x in range(0, kx, _BLOCK):
            b = min(_BLOCK, kx - x)
            stack[:b] = a[0, x : x + b]
            stack[b : 2 * b] = a[1, x : x + b]
            p, q = np.dot(stack[: 2 * b], right_re), np.dot(stack[: 2 * b], right_im)
            for i in range(b):
                for j in range(w):
                    re, im = p[i, j] - q[b + i, j], p[b + i, j] + q[i, j]
                    light[x + i, y + j] = re * re + im * im
    line = np.empty(ky, left.dtype)
    for s in range(out.shape[1]):
        line[:] = 0
        for i in range(weights_x.size):
            for j in range(ky):
                line[j] += weights_x[i] * light[s * per + i, j]
        for t in range(out.shape[0]):
            total = weights_y[0] * line[t * per]
            for j in range(1, weights_y.size):
                total += weights_y[j] * line[t * per + j]
            out[t, s] = total
