"""Compiled inner loops that read the pixels under each lenslet of a lattice of any pitch."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.compiled import njit

__all__ = ["lattice_rows"]

Float = NDArray[Any]


@njit()
def _along(strip: Float, weights: Float, line: Float) -> None:
    """Write the weighted sum of neighbours of ``strip`` to ``line``."""
    n = line.size
    if weights.size == 4:
        a, b, c, d = weights[0], weights[1], weights[2], weights[3]
        for k in range(n):
            line[k] = a * strip[k] + b * strip[k + 1] + c * strip[k + 2] + d * strip[k + 3]
    elif weights.size == 2:
        a, b = weights[0], weights[1]
        for k in range(n):
            line[k] = a * strip[k] + b * strip[k + 1]
    else:
        line[:] = strip


@njit()
def _taps(place: float, taps: int, weights: Float) -> int:
    """Fill the weights of the samples about ``place`` and return the sample at or before it."""
    if taps == 1:
        weights[0] = 1
        return int(np.floor(place + 0.5))
    first = int(np.floor(place))
    t = place - first
    if taps == 2:
        weights[0] = 1 - t
        weights[1] = t
        return first
    weights[0] = ((-0.5 * t + 1) * t - 0.5) * t
    weights[1] = (1.5 * t - 2.5) * t * t + 1
    weights[2] = ((-1.5 * t + 2) * t + 0.5) * t
    weights[3] = (0.5 * t - 0.5) * t * t
    return first


@njit()
def lattice_rows(
    frame: NDArray[Any],
    corner_y: Float,
    corner_x: Float,
    left: NDArray[np.intp],
    share: Float,
    size: tuple[int, int],
    step: tuple[float, float],
    taps: int,
    out: Float,
    start: int,
    stop: int,
) -> None:
    """Write lattice rows ``start … stop`` of ``out`` ``(size, size, rows, columns)``.

    Lenslet q of row r is read at ``corner[r, q] + step * (v, u)`` with ``taps`` 1 (nearest), 2 (linear) or 4 (cubic);
    output column c is ``1 - share[r, c]`` of lenslet ``left[r, c]`` and the rest of the one to its right.
    """
    lenses = corner_y.shape[1]
    high, wide = frame.shape
    reach = (taps - 1) // 2
    lines = np.empty((lenses, size[1]), out.dtype)
    wy = np.empty(taps, out.dtype)
    wx = np.empty((size[1], taps), out.dtype)
    x0 = np.empty(size[1], np.intp)
    wide_part = size[1] + taps - 1
    strip = np.empty(wide_part, out.dtype)
    even = step[1] == 1.0
    for r in range(start, stop):
        for v in range(size[0]):
            for q in range(lenses):
                y = corner_y[r, q] + v * step[0]
                top = _taps(y, taps, wy) - reach
                line = lines[q]
                for u in range(1 if even else size[1]):
                    x0[u] = _taps(corner_x[r, q] + u * step[1], taps, wx[u]) - reach
                inside = top >= 0 and top + taps <= high and x0[0] >= 0 and x0[0] + wide_part <= wide and even
                if inside:
                    # down first, then along: both reuse what lies next to each other
                    part = frame[top, x0[0] : x0[0] + wide_part]
                    w = wy[0]
                    for k in range(wide_part):
                        strip[k] = w * part[k]
                    for i in range(1, taps):
                        part = frame[top + i, x0[0] : x0[0] + wide_part]
                        w = wy[i]
                        for k in range(wide_part):
                            strip[k] += w * part[k]
                    _along(strip, wx[0], line)
                    continue
                line[:] = 0
                for i in range(taps):
                    row = frame[min(max(top + i, 0), high - 1)]
                    for u in range(size[1]):
                        m = 0 if even else u
                        first = x0[m] + (u if even else 0)
                        for s in range(taps):
                            line[u] += wy[i] * wx[m, s] * row[min(max(first + s, 0), wide - 1)]
            for u in range(size[1]):
                target = out[v, u, r]
                for c in range(target.size):
                    k = left[r, c]
                    target[c] = (
                        lines[k, u]
                        if share[r, c] == 0
                        else (lines[k, u] + share[r, c] * (lines[k + 1, u] - lines[k, u]))
                    )
