"""Compiled inner loops of views and rendering.

A view takes the pixels under each lenslet of any lattice. Measurement (v, u) of lenslet m is the frame at corner[m] +
step * (v, u). It is interpolated by convolution with a kernel of 1, 2 or 4 taps: nearest, linear, or cubic (Keys 1981,
a = -1/2). In rendering, every lenslet adds its light to the points that it sees.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import njit

__all__ = ["RefocusPlane", "Sites", "ViewReading", "largest_box", "render_rows", "sample_rows"]

Float = NDArray[Any]

BLOCK_ROWS = 8
"""Number of rows of samples processed at a time."""

BLOCK_SAMPLES = 1 << 15
"""Number of measurements kept at a time, so that they stay in the processor's cache."""


class Sites(NamedTuple):
    """First measurements of the lenslets, and their weights in the samples."""

    corner: Float  # (lenslets, 2): first measurement (row, column) of each lenslet (pixels)
    near: NDArray[np.int32]  # (rows, columns, k): lenslets of a sample, numbered about in the order of the rows
    share: Float  # (rows, columns, k): fraction of each of them


class ViewReading(NamedTuple):
    """Sampling and interpolation of a lenslet's measurements."""

    step_y: float  # distance of measurements (pixels)
    step_x: float
    taps: int  # 1 nearest, 2 linear, 4 cubic


@njit()
def _along(strip: Float, weights: Float, line: Float) -> None:
    """Write the weighted sum of neighbours of ``strip`` to ``line``."""
    n = line.size
    # weights in variables, not in memory, so that the loops over k are vectorised
    if weights.size == 4:
        a, b, c, d = weights[0], weights[1], weights[2], weights[3]
        for k in range(n):
            line[k] = a * strip[k] + b * strip[k + 1] + c * strip[k + 2] + d * strip[k + 3]
    elif weights.size == 2:
        a, b = weights[0], weights[1]
        for k in range(n):
            line[k] = a * strip[k] + b * strip[k + 1]
    else:
        for k in range(n):
            line[k] = strip[k]


@njit()
def _taps(place: float, taps: int, weights: Float) -> int:
    """Compute the weights of the samples about ``place``, and return the first sample (cubic: the second one)."""
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
    """Read one row of a lenslet's measurements that are not a pixel apart, or are near the frame's border.

    Pixels outside the frame repeat its border. For measurements a pixel apart, only the first has weights ``wx`` (1,
    taps) and a first pixel ``x0`` (1,).
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
def _mix(lines: Float, near: NDArray[np.int32], share: Float, mixed: Float) -> None:
    """Write to ``mixed`` ``(columns, across)`` the rows of each sample's one to four lenslets, weighted by shares."""
    most, across = near.shape[1], mixed.shape[1]
    for c in range(near.shape[0]):
        row, one, a = mixed[c], lines[near[c, 0]], share[c, 0]
        if most == 1 or a == 1:
            for u in range(across):
                row[u] = a * one[u]
            continue
        # all lenslets in one loop, which is vectorised; rows are short
        two, b = lines[near[c, 1]], share[c, 1]
        if most == 2:
            for u in range(across):
                row[u] = a * one[u] + b * two[u]
            continue
        three, d = lines[near[c, 2]], share[c, 2]
        four, e = lines[near[c, most - 1]], share[c, 3] if most == 4 else share.dtype.type(0)
        for u in range(across):
            row[u] = a * one[u] + b * two[u] + d * three[u] + e * four[u]


@njit()
def _used(near: NDArray[np.int32], share: Float, place: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the numbers of the lenslets with a share, sorted and unique; fill in each one's ``place`` there."""
    low, high = 2**31 - 1, -1
    for r, c, k in np.ndindex(near.shape):
        if share[r, c, k] != 0:
            low, high = min(low, int(near[r, c, k])), max(high, int(near[r, c, k]))
    table = np.zeros(max(high - low + 1, 0), np.int32)
    for r, c, k in np.ndindex(near.shape):
        if share[r, c, k] != 0:
            table[near[r, c, k] - low] = 1
    used, count = np.empty(table.size, np.int32), 0
    for m in range(table.size):
        if table[m]:
            table[m], used[count] = count, low + m
            count += 1
    for r, c, k in np.ndindex(near.shape):
        place[r, c, k] = table[near[r, c, k] - low] if share[r, c, k] != 0 else 0
    return used[:count]


@njit()
def _read(frame: NDArray[Any], corner: Float, first: int, reading: ViewReading, lines: Float) -> None:
    """Read rows ``first …`` of the measurements of lenslets ``corner`` ``(n, 2)`` to ``lines`` ``(n, v, across)``."""
    step_x, taps = reading.step_x, reading.taps
    (high, wide), across = frame.shape, lines.shape[2]
    reach = (taps - 1) // 2
    even = step_x == 1.0  # measurements a pixel apart have the same weights
    places = 1 if even else across
    wy = np.empty(taps, lines.dtype)
    wx, x0 = np.empty((places, taps), lines.dtype), np.empty(places, np.intp)
    strip = np.empty(across + taps - 1, lines.dtype)
    for m in range(len(corner)):
        for u in range(places):
            x0[u] = _taps(corner[m, 1] + u * step_x, taps, wx[u]) - reach
        for v in range(lines.shape[1]):
            top = _taps(corner[m, 0] + (first + v) * reading.step_y, taps, wy) - reach
            inside = even and top >= 0 and top + taps <= high and x0[0] >= 0 and x0[0] + strip.size <= wide
            if not inside:
                _by_pixel(frame, top, wy, wx, x0, lines[m, v])
                continue
            # first down, then along: both reuse adjacent values
            for i in range(taps):
                part = frame[top + i, x0[0] : x0[0] + strip.size]
                w = wy[i]
                for k in range(strip.size):
                    strip[k] = w * part[k] if i == 0 else strip[k] + w * part[k]
            _along(strip, wx[0], lines[m, v])


@njit()
def sample_rows(frame: NDArray[Any], sites: Sites, reading: ViewReading, out: Float, start: int, stop: int) -> None:
    """Write rows ``start … stop`` of the samples to ``out`` ``(down, across, rows, columns)``.

    A sample is the sum of its lenslets' measurements weighted by their shares. Rows are processed in groups, because
    neighbouring rows need the same lenslets, each of which is then read once.
    """
    # arrays are taken from their records before the loops, where each access would count references
    near, share = sites.near, sites.share
    (down, across), columns = out.shape[:2], out.shape[3]
    for first in range(start, stop, BLOCK_ROWS):
        last = min(first + BLOCK_ROWS, stop)
        place = np.empty(near[first:last].shape, np.int32)
        used = _used(near[first:last], share[first:last], place)
        # at least one line, which samples without lenslets do not use
        corner, lenses = sites.corner[used], max(len(used), 1)
        group = min(down, max(1, BLOCK_SAMPLES // (lenses * across)))
        for v in range(0, down, group):
            count = min(group, down - v)
            lines = np.zeros((lenses, count, across), out.dtype)
            _read(frame, corner, v, reading, lines)
            flat, mixed = lines.reshape(lenses, count * across), np.empty((columns, count * across), out.dtype)
            for r in range(first, last):
                # the lenslets of a sample are added along v and u, where memory is contiguous
                _mix(flat, place[r - first], share[r], mixed)
                for k in range(count * across):
                    target = out[v + k // across, k % across, r]
                    for c in range(columns):
                        target[c] = mixed[c, k]


@njit()
def largest_box(good: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """Return the largest box ``top, bottom, left, right`` of only true values, ends excluded; zeros without one.

    For each row, the heights of true values in the columns form a histogram; a stack holds boxes that may still widen.
    """
    rows, columns = good.shape
    height, starts = np.zeros(columns, np.intp), np.empty(columns + 1, np.intp)
    levels = np.empty(columns + 1, np.intp)
    best, box = 0, (0, 0, 0, 0)
    for r in range(rows):
        count = 0
        for c in range(columns + 1):
            now = 0
            if c < columns:
                height[c] = height[c] + 1 if good[r, c] else 0
                now = height[c]
            start = c
            while count > 0 and levels[count - 1] >= now:
                count -= 1
                start = starts[count]
                area = levels[count] * (c - start)
                if area > best:
                    best, box = area, (r + 1 - levels[count], r + 1, start, c)
            starts[count], levels[count] = start, now
            count += 1
    return box


class RefocusPlane(NamedTuple):
    """A plane of the scene, and the positions of its image's samples on the sensor."""

    slope: float  # (S - c) divided by the position below the lenslet; not 0
    radius: float  # of the micro-images (pixels)
    corner_y: float  # position of sample (0, 0) (pixels)
    corner_x: float
    step_y: float  # distance of samples (pixels)
    step_x: float


@njit()
def render_rows(
    frame: Float, white: Float, lenslets: NDArray[np.float64], plane: RefocusPlane, sums: Float, rows: tuple[int, int]
) -> None:
    """Add rows ``rows[0] … rows[1]`` of a plane's image to ``sums`` ``(4, rows, columns)``.

    ``lenslets`` ``(n, 3)`` are row, column and weight s. Lenslet c sees the point S at p = c + (S - c)/slope, where the
    light is L(p), relative to a white frame's W(p) (bilinear). The sums are of s W, s L, s L^2 / W and (s W)^2.
    """
    reach = abs(plane.slope) * plane.radius
    columns, (high, wide) = sums.shape[2], frame.shape
    for m in range(len(lenslets)):
        cy, cx, s = lenslets[m, 0], lenslets[m, 1], lenslets[m, 2]
        top = max(int(np.ceil((cy - reach - plane.corner_y) / plane.step_y)), rows[0])
        bottom = min(int(np.floor((cy + reach - plane.corner_y) / plane.step_y)) + 1, rows[1])
        left = max(int(np.ceil((cx - reach - plane.corner_x) / plane.step_x)), 0)
        right = min(int(np.floor((cx + reach - plane.corner_x) / plane.step_x)) + 1, columns)
        for i in range(top, bottom):
            v = (plane.corner_y + i * plane.step_y - cy) / plane.slope
            for j in range(left, right):
                u = (plane.corner_x + j * plane.step_x - cx) / plane.slope
                if v * v + u * u > plane.radius * plane.radius:
                    continue
                y, x = int(np.floor(cy + v)), int(np.floor(cx + u))
                if y < 0 or x < 0 or y + 1 >= high or x + 1 >= wide:
                    continue
                b, a = cy + v - y, cx + u - x
                w00, w01, w10, w11 = (1 - b) * (1 - a), (1 - b) * a, b * (1 - a), b * a
                light = w00 * frame[y, x] + w01 * frame[y, x + 1] + w10 * frame[y + 1, x] + w11 * frame[y + 1, x + 1]
                lit = w00 * white[y, x] + w01 * white[y, x + 1] + w10 * white[y + 1, x] + w11 * white[y + 1, x + 1]
                if lit > 0:
                    sums[0, i, j] += s * lit
                    sums[1, i, j] += s * light
                    sums[2, i, j] += s * light * light / lit
                    sums[3, i, j] += s * lit * s * lit
