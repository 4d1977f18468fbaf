"""Compiled inner loops of demosaicing by estimation: windows weighted by phase, two estimates blended by direction."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import njit

__all__ = ["Mosaic", "blend_rows", "estimate_rows"]

Float = NDArray[Any]
Index = NDArray[np.intp]


class Mosaic(NamedTuple):
    """A frame, continued beyond its borders by pixels with the same position in the super-pixel."""

    frame: NDArray[Any]  # (rows, columns)
    rows: Index  # (margin + rows + margin,): row of the frame used for each
    columns: Index  # (px, cells): column of the frame; column b of super-pixel k, from the left margin on
    side_y: int  # pixels of a super-pixel
    margin: int  # super-pixels of columns before the frame's first


@njit()
def estimate_rows(mosaic: Mosaic, weights: Float, out: Float, start: int) -> None:
    """Write the estimates of rows ``start …`` to ``out`` ``(samples, rows, columns)``.

    ``weights`` are those of ``estimation_weights``. The columns of each position in the super-pixel are stored next to
    each other, so that the inner loops run over contiguous memory.
    """
    side_x, cells = mosaic.columns.shape
    window, samples = weights.shape[2], out.shape[0]
    reach = window // 2
    width = out.shape[2]
    rows = np.empty((window, side_x, cells), out.dtype)
    whole = (width + side_x - 1) // side_x
    acc = np.empty(whole, out.dtype)
    for y in range(out.shape[1]):
        # the window moves down by one row: the other rows are already stored, at their index modulo the height
        for i in range(0 if y == 0 else window - 1, window):
            _deal(mosaic, start + y + i, rows[(y + i) % window])
        phase = (start + y) % mosaic.side_y
        for b in range(side_x):
            kernel = weights[phase * side_x + b]
            for n in range(samples):
                _weigh(rows, kernel[n], y, mosaic.margin * side_x + b - reach, acc)
                target = out[n, y]
                for k in range((width - b + side_x - 1) // side_x):
                    target[k * side_x + b] = acc[k]


@njit()
def _deal(mosaic: Mosaic, row: int, target: Float) -> None:
    """Sort one row of the frame, with its margins, by position in the super-pixel into ``target`` ``(px, cells)``."""
    line = mosaic.frame[mosaic.rows[row]]
    for b in range(target.shape[0]):
        columns = mosaic.columns[b]
        for k in range(columns.size):
            target[b, k] = line[columns[k]]


@njit()
def _weigh(rows: Float, kernel: Float, y: int, first: int, acc: Float) -> None:
    """Write to ``acc`` the weighted sums of windows in row ``y``, at column ``first`` and at later super-pixels."""
    window, side_x = kernel.shape[0], rows.shape[1]
    acc[:] = 0
    for i in range(window):
        dealt = rows[(y + i) % window]
        for j in range(window):
            w = kernel[i, j]
            if w != 0:
                column = first + j
                line = dealt[column % side_x, column // side_x :]
                for k in range(acc.size):
                    acc[k] += w * line[k]


@njit()
def blend_rows(one: Float, two: Float, half: int, out: Float, skip: int) -> None:
    """Blend two estimates according to how their colours change along the rows (``one``) and the columns (``two``).

    The colours of an estimate along an edge change little in that direction. Each estimate is therefore weighted by the
    change of the other one, summed over a window of ``2 half + 1`` pixels, to the fourth power. ``out`` ``(samples,
    rows, columns)`` begins ``skip`` rows into the estimates.
    """
    samples, height, width = one.shape
    change = np.zeros((2, height, width), out.dtype)
    _changes(one, 0, 1, change[0])
    _changes(two, 1, 0, change[1])
    columns = np.zeros((2, width), out.dtype)
    for y in range(out.shape[1]):
        here = y + skip
        columns[:] = 0
        for d in range(2):
            for r in range(max(here - half - d, 0), min(here + half + 1, height)):
                line = change[d, r]
                for x in range(width):  # one by one, because array operations here compile to much more code
                    columns[d, x] += line[x]
        for x in range(width):
            along, down = _window(columns[0], x - half - 1, x + half), _window(columns[1], x - half, x + half)
            share = 0.5
            if along + down > 0:
                # as shares, because the fourth power would overflow
                p = along / (along + down)
                share = p**4 / (p**4 + (1 - p) ** 4)
            for n in range(samples):
                out[n, y, x] = one[n, here, x] + share * (two[n, here, x] - one[n, here, x])


@njit()
def _changes(estimate: Float, step_y: int, step_x: int, change: Float) -> None:
    """Write the sum over samples of the change of colour (sample minus mean) from each pixel to the next."""
    samples, height, width = estimate.shape
    for y in range(height - step_y):
        for x in range(width - step_x):
            mean = 0.0
            for n in range(samples):
                mean += estimate[n, y + step_y, x + step_x] - estimate[n, y, x]
            mean /= samples
            total = 0.0
            for n in range(samples):
                total += abs(estimate[n, y + step_y, x + step_x] - estimate[n, y, x] - mean)
            change[y, x] = total


@njit()
def _window(values: Float, first: int, last: int) -> float:
    """Return the sum of ``values[first … last]``, limited to existing values."""
    total = 0.0
    for k in range(max(first, 0), min(last + 1, values.size)):
        total += values[k]
    return total
