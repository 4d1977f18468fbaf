"""Compiled inner loops of the spatial route: interpolation of channels and local decorrelation in one pass."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.compiled import njit

__all__ = ["bilateral_rows", "linear_rows"]

Float = NDArray[Any]
Index = NDArray[np.intp]


@njit()
def linear_rows(
    frame: NDArray[Any],
    side: tuple[int, int],
    first_y: Index,
    weight_y: Float,
    first_x: Index,
    weight_x: Float,
    inverse: Float,
    used: NDArray[np.bool_],
    out: Float,
    start: int,
    stop: int,
) -> None:
    """Write output rows ``start … stop`` of all samples: down the columns, across the channels, along the rows.

    The three are linear, so that their order is free; this one touches each sample of the frame least often.
    """
    py, px = side
    my, mx = weight_y.shape[0], weight_x.shape[0]
    cells_y, cells_x = frame.shape[0] // py, frame.shape[1] // px
    width = cells_x * px
    taps_y, taps_x = weight_y.shape[2], weight_x.shape[2]
    margin = max(-first_x.min(), first_x.max() + taps_x - 1, 0)
    g = np.empty((py, width), out.dtype)
    u = np.empty((px, cells_x + 2 * margin), out.dtype)
    acc = np.empty(cells_x, out.dtype)
    for n in range(start, stop):
        cell, phase = n // my, n % my
        for a in range(py):
            g[a] = 0
            for t in range(taps_y):
                w = weight_y[phase, a, t]
                if w != 0:
                    row = frame[min(max(cell + first_y[phase, a] + t, 0), cells_y - 1) * py + a]
                    for x in range(width):
                        g[a, x] += w * row[x]
        for j in range(inverse.shape[0]):
            for b in range(px):
                if not used[j, b]:
                    continue
                line = u[b]
                inner = line[margin : margin + cells_x]
                inner[:] = 0
                for a in range(py):
                    w = inverse[j, a * px + b]
                    if w != 0:
                        channel = g[a]
                        for k in range(cells_x):
                            inner[k] += w * channel[k * px + b]
                line[:margin] = line[margin]
                line[margin + cells_x :] = line[margin + cells_x - 1]
            target = out[j, n]
            for q in range(mx):
                acc[:] = 0
                for b in range(px):
                    if not used[j, b]:
                        continue
                    for t in range(taps_x):
                        w = weight_x[q, b, t]
                        if w != 0:
                            shifted = u[b, margin + first_x[q, b] + t :]
                            for k in range(cells_x):
                                acc[k] += w * shifted[k]
                for k in range(cells_x):
                    target[k * mx + q] = acc[k]


@njit()
def bilateral_rows(
    frame: NDArray[Any],
    guide: Float,
    side: tuple[int, int],
    first_y: Index,
    weight_y: Float,
    first_x: Index,
    weight_x: Float,
    inverse: Float,
    sharpness: float,
    out: Float,
    start: int,
    stop: int,
) -> None:
    """Write output rows of the joint bilateral filter: linear weights times exp(-(guide difference)^2 sharpness)."""
    py, px = side
    my, mx = weight_y.shape[0], weight_x.shape[0]
    cells_y, cells_x = frame.shape[0] // py, frame.shape[1] // px
    channel = np.empty(py * px, out.dtype)
    for n in range(start, stop):
        cell_y, phase = n // my, n % my
        for m in range(cells_x * mx):
            cell_x, q = m // mx, m % mx
            gy = min(max(int((n + 0.5) * py / my), 0), cells_y * py - 1)
            gx = min(max(int((m + 0.5) * px / mx), 0), cells_x * px - 1)
            here = guide[gy, gx]
            for a in range(py):
                for b in range(px):
                    total, norm = 0.0, 0.0
                    for t in range(weight_y.shape[2]):
                        y = min(max(cell_y + first_y[phase, a] + t, 0), cells_y - 1) * py + a
                        for s in range(weight_x.shape[2]):
                            x = min(max(cell_x + first_x[q, b] + s, 0), cells_x - 1) * px + b
                            w = weight_y[phase, a, t] * weight_x[q, b, s]
                            if w != 0:
                                d = guide[y, x] - here
                                w *= np.exp(-d * d * sharpness) + 1e-6
                                total += w * frame[y, x]
                                norm += w
                    channel[a * px + b] = total / norm
            for j in range(inverse.shape[0]):
                value = 0.0
                for k in range(py * px):
                    value += inverse[j, k] * channel[k]
                out[j, n, m] = value
