"""Compiled kernels that read one depth plane of H: a single slice of HT, and sums over positions."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import njit

__all__ = ["add_patterns", "gather_slice"]


@njit()
def gather_slice(plane: NDArray[Any], shape: tuple[int, int, int, int], y: int, x: int, out: NDArray[Any]) -> None:
    """Write the slice HT[y, x] to ``out`` (flat, nt * ns) from the flat ``plane`` of ``shape`` (ny, nx, nt, ns).

    HT[y, x, t, s] = H[(y + t - ct) mod ny, (x + s - cs) mod nx, nt - 1 - t, ns - 1 - s], ct = (nt - 1)/2 and so on.
    From s to s + 1, the address grows by one pattern minus one value, and by a row of patterns less where the column
    passes nx. Additions thus replace a division per value.
    """
    ny, nx, nt, ns = shape
    pattern = nt * ns
    for t in range(nt):
        row = (y + t - (nt - 1) // 2) % ny
        column = (x - (ns - 1) // 2) % nx
        place = ((row * nx + column) * nt + nt - 1 - t) * ns + ns - 1
        for s in range(ns):
            out[t * ns + s] = plane[place]
            column += 1
            place += pattern - 1  # the next column's pattern, one value earlier in it
            if column == nx:
                column = 0
                place -= nx * pattern  # the period closes along x


@njit()
def add_patterns(patterns: NDArray[Any], out: NDArray[np.float64], start: int, stop: int) -> None:
    """Add pixels ``start`` to ``stop`` of all patterns ``(n, pixels)`` to ``out`` in float64, eight at a time.

    Eight patterns are added to each other before the sum is loaded and stored. This needs an eighth of the memory
    traffic, and has the rounding error of a tree: at most n 2^-53 of a sum of n non-negative values.
    """
    n = patterns.shape[0]
    eights = n // 8 * 8  # the remaining patterns are added one by one
    total = out[start:stop]
    for k in range(0, eights, 8):
        a, b = patterns[k, start:stop], patterns[k + 1, start:stop]
        c, d = patterns[k + 2, start:stop], patterns[k + 3, start:stop]
        e, f = patterns[k + 4, start:stop], patterns[k + 5, start:stop]
        g, h = patterns[k + 6, start:stop], patterns[k + 7, start:stop]
        for p in range(total.size):
            first = (np.float64(a[p]) + np.float64(b[p])) + (np.float64(c[p]) + np.float64(d[p]))
            second = (np.float64(e[p]) + np.float64(f[p])) + (np.float64(g[p]) + np.float64(h[p]))
            total[p] += first + second
    for k in range(eights, n):
        a = patterns[k, start:stop]
        for p in range(total.size):
            total[p] += np.float64(a[p])
