"""Compiled measurements of one frame, for any sample type."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import njit

__all__ = ["COLUMNS", "count_lit", "expect", "learn", "measure", "same_rows"]

COLUMNS = ("level", "energy", "row", "column", "peak", "noise", "total")
"""Values that `measure` computes; the first five are stored in the table of neighbours.

In this order, they are:

- the level of the darkest corner
- the sum of the light above this level
- the row and the column of the centroid of this light, relative to the frame's middle
- the highest sample
- the noise of a pixel in that corner (counts)
- the sum of all samples
"""


@njit()
def measure(frame: NDArray[Any], out: NDArray[np.float64]) -> None:
    """Write the measurements of ``frame`` ``(rows, columns)`` into ``out`` ``(7,)``; see `COLUMNS`.

    The darkest of four corners shows the background: a pattern that fills the frame rarely reaches all of them.
    """
    rows, columns = frame.shape
    side = max(2, min(rows, columns) // 6)
    level, noise = math.inf, 0.0
    for corner in range(4):
        top = 0 if corner < 2 else max(0, rows - side)
        left = 0 if corner % 2 == 0 else max(0, columns - side)
        block = frame[top : top + side, left : left + side]
        mean = block.mean()
        if mean < level:
            level, noise = mean, block.std()
    # column by column, because the compiler can vectorise sums over columns
    sums, moments, tops = np.zeros(columns), np.zeros(columns), np.full(columns, -np.inf)
    for r in range(rows):
        for c in range(columns):
            value = float(frame[r, c])
            sums[c] += value
            moments[c] += value * r
            tops[c] = value if value > tops[c] else tops[c]
    total, down, along, peak = 0.0, 0.0, 0.0, -np.inf
    for c in range(columns):
        total += sums[c]
        down += moments[c]
        along += sums[c] * c
        peak = max(peak, tops[c])
    energy = total - level * rows * columns
    out[0], out[1], out[4], out[5], out[6] = level, energy, peak, noise, total
    # the background is symmetrical about the middle, and adds nothing to moments taken from there
    light = energy if energy != 0.0 else 1.0
    out[2] = (down - total * 0.5 * (rows - 1)) / light
    out[3] = (along - total * 0.5 * (columns - 1)) / light


@njit()
def learn(
    values: NDArray[np.float64], expected: NDArray[np.float64], ceiling: float, usual: NDArray[np.float64]
) -> None:
    """Update the typical differences ``usual`` ``(4,)`` by the differences between ``values`` and ``expected``.

    Units are as in `lfcal.acquire.guard.content.FIRST`. The differences grow quickly and shrink slowly, because a
    pattern with a jump usually has more jumps.
    """
    light = max(abs(expected[1]), 1e-9)
    for k in range(4):
        away = abs(values[k] - expected[k])
        if k == 0:
            away /= ceiling
        elif k == 1:
            away /= light
        usual[k] += (away - usual[k]) * (1 / 8 if away > usual[k] else 1 / 32)


@njit()
def same_rows(a: NDArray[Any], b: NDArray[Any]) -> tuple[int, int]:
    """Count equal rows of ``a`` and ``b`` from the first row downwards, and from the last row upwards."""
    rows, columns = a.shape
    counts = [0, 0]
    for end in range(2):
        for k in range(rows):
            r = k if end == 0 else rows - 1 - k
            for c in range(columns):
                if a[r, c] != b[r, c]:
                    break
            else:
                counts[end] += 1
                continue
            break
    return counts[0], counts[1]


@njit()
def count_lit(frame: NDArray[Any], floor: float, ceiling: float) -> int:
    """Count samples of ``frame`` above ``floor`` and below ``ceiling``."""
    found = 0
    for value in frame.flat:
        if floor < value < ceiling:
            found += 1
    return found


@njit()
def expect(table: NDArray[np.float64], y: int, x: int, pitch: int, out: NDArray[np.float64]) -> int:
    """Predict the measurements at ``(y, x)`` from its neighbours; return the method, or -1 without neighbours.

    Parameters
    ----------
    table
        Measurements of a plane ``(ny, nx, 5)``; NaN where there are none.
    y, x
        Row and column of the position to predict.
    pitch
        Distance of the neighbours (number of positions).
    out
        Array ``(5,)`` for the prediction.

    Returns
    -------
    int
        Method: 0: mean of the neighbours on both sides; 1: from three corners of a square; 2: along a line; 3: nearest
        neighbour.
    """
    ny, nx, n = table.shape
    pairs = 0
    out[:] = 0.0
    for dy, dx in ((0, pitch), (pitch, 0)):
        if y >= dy and x >= dx and y + dy < ny and x + dx < nx:
            a, b = table[y - dy, x - dx], table[y + dy, x + dx]
            if not math.isnan(a[0] + b[0]):
                pairs += 1
                for k in range(n):
                    out[k] += 0.5 * (a[k] + b[k])
    if pairs:
        out /= pairs
        return 0
    for sy in (-pitch, pitch):
        for sx in (-pitch, pitch):
            if 0 <= y + sy < ny and 0 <= x + sx < nx:
                a, b, c = table[y, x + sx], table[y + sy, x], table[y + sy, x + sx]
                if not math.isnan(a[0] + b[0] + c[0]):
                    for k in range(n):
                        out[k] = a[k] + b[k] - c[k]
                    return 1
    for far in (2, 1):
        for dy, dx in ((0, -pitch), (0, pitch), (-pitch, 0), (pitch, 0)):
            if 0 <= y + far * dy < ny and 0 <= x + far * dx < nx:
                a, b = table[y + dy, x + dx], table[y + far * dy, x + far * dx]
                if not math.isnan(a[0] + b[0]):
                    for k in range(n):
                        out[k] = far * a[k] - (far - 1) * b[k]
                    return 2 if far == 2 else 3
    return -1
