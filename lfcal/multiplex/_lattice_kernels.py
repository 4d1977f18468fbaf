"""Compiled inner loops that read the pixels under each lenslet of a lattice of any pitch.

Measurement (v, u) of lenslet q in lattice row r is the frame at corner[r, q] + step * (v, u), between pixels by
convolution with a kernel of 1, 2 or 4 taps: nearest, linear, or cubic (Keys 1981, a = -1/2).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.compiled import njit

__all__ = ["Reading", "Sites", "lattice_rows"]

Float = NDArray[Any]


class Sites(NamedTuple):
    """Where the lenslets of each lattice row begin, and which of them make an output column."""

    corner_y: Float  # (rows, lenslets): first measurement of each lenslet (pixels)
    corner_x: Float
    left: NDArray[np.intp]  # (rows, columns): lenslet at or left of an output column
    share: Float  # (rows, columns): share of the lenslet to its right


class Reading(NamedTuple):
    """How a lenslet's measurements are read from the frame."""

    step_y: float  # distance of measurements (pixels)
    step_x: float
    taps: int  # 1 nearest, 2 linear, 4 cubic


@njit()
def _along(strip: Float, weights: Float, line: Float) -> None:
    """Write the weighted sum of neighbours of ``strip`` to ``line``."""
    n = line.size
    # weights in variables, not in memory: the loops over k then run in vectors
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
    # Keys's kernel by Horner's rule; the four sum to 1 for every t
    weights[0] = ((-0.5 * t + 1) * t - 0.5) * t
    weights[1] = (1.5 * t - 2.5) * t * t + 1
    weights[2] = ((-1.5 * t + 2) * t + 0.5) * t
    weights[3] = (0.5 * t - 0.5) * t * t
    return first


@njit()
def _by_pixel(frame: NDArray[Any], top: int, wy: Float, wx: Float, x0: NDArray[np.intp], line: Float) -> None:
    """Read one row of a lenslet's measurements where they are not a pixel apart, or where the frame's border is near.

    Pixels outside the frame repeat its border. Of measurements a pixel apart only the first has weights ``wx``
    (1, taps) and a first pixel ``x0`` (1,).
    """
    high, wide = frame.shape
    line[:] = 0
    for i in range(wy.size):
        row = frame[min(max(top + i, 0), high - 1)]
        for u in range(line.size):
            m = min(u, x0.size - 1)
            first = x0[m] + u - m
            for s in range(wy.size):
                line[u] += wy[i] * wx[m, s] * row[min(max(first + s, 0), wide - 1)]


@njit()
def lattice_rows(frame: NDArray[Any], sites: Sites, reading: Reading, out: Float, start: int, stop: int) -> None:
    """Write lattice rows ``start … stop`` of ``out`` ``(down, across, rows, columns)``.

    Output column c is ``1 - share[r, c]`` of lenslet ``left[r, c]`` and the rest of the one to its right: the rows of
    a hexagonal lattice are half a pitch apart, a grid's columns fall between its lenslets.
    """
    # arrays out of their records before the loops: inside, each access would count references
    corner_y, corner_x, left, shares = sites.corner_y, sites.corner_x, sites.left, sites.share
    step_y, step_x, taps = reading.step_y, reading.step_x, reading.taps
    (down, across), (high, wide), lenses = out.shape[:2], frame.shape, corner_y.shape[1]
    reach = (taps - 1) // 2
    even = step_x == 1.0  # measurements a pixel apart share their weights
    places = 1 if even else across
    lines, wy = np.empty((lenses, across), out.dtype), np.empty(taps, out.dtype)
    wx, x0 = np.empty((places, taps), out.dtype), np.empty(places, np.intp)
    strip = np.empty(across + taps - 1, out.dtype)
    for r in range(start, stop):
        for v in range(down):
            for q in range(lenses):
                top = _taps(corner_y[r, q] + v * step_y, taps, wy) - reach
                line = lines[q]
                for u in range(places):
                    x0[u] = _taps(corner_x[r, q] + u * step_x, taps, wx[u]) - reach
                inside = even and top >= 0 and top + taps <= high and x0[0] >= 0 and x0[0] + strip.size <= wide
                if not inside:
                    _by_pixel(frame, top, wy, wx, x0, line)
                    continue
                # down first, then along: both reuse what lies next to each other
                for i in range(taps):
                    part = frame[top + i, x0[0] : x0[0] + strip.size]
                    w = wy[i]
                    for k in range(strip.size):
                        strip[k] = w * part[k] if i == 0 else strip[k] + w * part[k]
                _along(strip, wx[0], line)
            for u in range(across):
                target = out[v, u, r]
                for c in range(target.size):
                    k, share = left[r, c], shares[r, c]
                    near = lines[k, u]
                    target[c] = near if share == 0 else near + share * (lines[k + 1, u] - near)
