"""Windows of light at their places on an image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.base import centre

__all__ = ["joined", "place", "sum_of"]


def joined(windows: list[tuple[int, int, NDArray[np.float32]]]) -> tuple[int, int, NDArray[np.float32]]:
    """Return the sum of windows at their places, on an image that holds them all, with its first row and column."""
    rows, columns = [row for row, _, _ in windows], [column for _, column, _ in windows]
    nt, ns = windows[0][2].shape
    out = np.zeros((max(rows) - min(rows) + nt, max(columns) - min(columns) + ns), np.float32)
    for row, column, values in windows:
        place(out, values, row - min(rows) + centre(nt), column - min(columns) + centre(ns))
    return min(rows) - centre(nt), min(columns) - centre(ns), out


def sum_of(windows: list[tuple[int, int, NDArray[np.float32]]]) -> NDArray[np.float32]:
    """Return the sum of windows at their places, on an image that holds them all."""
    return joined(windows)[2]


def place(out: NDArray[np.float32], values: NDArray[np.float32], row: int, column: int) -> None:
    """Add a window centred on ``(row, column)``; what lies beyond the sensor is lost."""
    top, left = row - centre(values.shape[0]), column - centre(values.shape[1])
    r0, c0 = max(0, top), max(0, left)
    r1, c1 = min(out.shape[0], top + values.shape[0]), min(out.shape[1], left + values.shape[1])
    if r0 < r1 and c0 < c1:
        out[r0:r1, c0:c1] += values[r0 - top : r1 - top, c0 - left : c1 - left]
