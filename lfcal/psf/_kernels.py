"""Compiled kernels over one depth plane ``(ny, nx, nt, ns)`` of H; they release the GIL.

Values are moved as they are, so every dtype is handled through the unsigned integers of its size.
"""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from lfcal.threads import njit

__all__ = ["depth_sum_block", "ht_slice", "transpose_rows"]


@njit()
def transpose_rows(plane: NDArray[Any], out: NDArray[Any], start: int, stop: int) -> None:
    """Write rows ``start`` to ``stop`` of HT: out[y, x, t, s] = H[y+t-ct, x+s-cs, nt-1-t, ns-1-s], wrapped."""
    ny, nx, nt, ns = plane.shape
    ct, cs = (nt - 1) // 2, (ns - 1) // 2
    for y in range(start, stop):
        for t in range(nt):
            row = (y + t - ct) % ny
            for x in range(nx):
                column = (x - cs) % nx
                for s in range(ns):
                    out[y, x, t, s] = plane[row, column, nt - 1 - t, ns - 1 - s]
                    column += 1
                    if column == nx:
                        column = 0


@njit()
def ht_slice(plane: NDArray[Any], y: int, x: int, out: NDArray[Any]) -> None:
    """Write the slice HT[y, x] ``(nt, ns)`` of the transposed plane."""
    ny, nx, nt, ns = plane.shape
    ct, cs = (nt - 1) // 2, (ns - 1) // 2
    for t in range(nt):
        row = (y + t - ct) % ny
        column = (x - cs) % nx
        for s in range(ns):
            out[t, s] = plane[row, column, nt - 1 - t, ns - 1 - s]
            column += 1
            if column == nx:
                column = 0


@njit()
def depth_sum_block(patterns: NDArray[Any], out: NDArray[Any], start: int, stop: int) -> None:
    """Add pixels ``start`` to ``stop`` of all patterns ``(n, nt * ns)`` to ``out``, in its precision."""
    for k in range(patterns.shape[0]):
        for p in range(start, stop):
            out[p] += patterns[k, p]
