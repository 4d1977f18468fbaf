"""Compiled inner loops of depth maps: matching between micro-images, and joining their depths in the central view.

Inverse slopes rho = 1/w are searched: pixel u of the micro-image at c shows the same point as pixel u - rho b of the
micro-image at c + b. The disparity of two micro-images is therefore rho times their distance.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import njit

__all__ = ["Lenslets", "Matching", "Raster", "join_rows", "match_lenslets", "match_views", "sweep_rows"]

Float = NDArray[Any]

MIN_TERMS = 0.4
"""Smallest number of compared pixels for a pixel, relative to the pixels of a window."""

DISTINCT = 3.0
"""Standard errors by which the best match must be better than the next, and than its surroundings."""

MAX_SLOPE = 40.0
"""Largest slope that is joined: beyond it, a pixel of a micro-image covers many samples."""

DEEP = 0.2
"""Rise of the mean squared difference about a match, relative to the noise: interpolated noise varies by less."""


class Lenslets(NamedTuple):
    """The micro-images and their neighbours."""

    centres: Float  # (n, 2): row, column (pixels)
    near: NDArray[np.int32]  # (n, k): numbers of the neighbours; -1: none
    types: NDArray[np.int32]  # (n,): lens types
    radius: float  # of the micro-images (pixels)


class Matching(NamedTuple):
    """Inverse slopes, and how pixels are compared."""

    rho: NDArray[np.float64]  # (m,): inverse slopes at equal steps
    weight: NDArray[np.float32]  # (m, 3, 3): weights of pairs of lens types
    half: int  # half the side of the window (pixels)
    most: float  # limit of the squared differences
    floor: float  # variance of the light that is always assumed
    shared: float  # number of pixels that share the noise of one


class Raster(NamedTuple):
    """Samples of the central view: positions on the sensor."""

    corner_y: float
    corner_x: float
    step_y: float
    step_x: float


@njit()
def _inside(radius: float, v: float) -> float:
    """Return half the width of a disc at height ``v``; negative outside."""
    left = radius * radius - v * v
    return np.sqrt(left) if left >= 0 else -1.0


@njit()
def _box(values: Float, half: int, out: Float, lines: Float) -> None:
    """Write the sums over windows of side 2 half + 1 to ``out``; ``lines`` is workspace of the same shape."""
    high, wide = values.shape
    for y in range(high):
        total = values.dtype.type(0)
        for x in range(min(half, wide)):
            total += values[y, x]
        for x in range(wide):
            if x + half < wide:
                total += values[y, x + half]
            if x - half - 1 >= 0:
                total -= values[y, x - half - 1]
            lines[y, x] = total
    for y in range(high):
        for x in range(wide):
            out[y, x] = 0
        for k in range(max(y - half, 0), min(y + half + 1, high)):
            for x in range(wide):
                out[y, x] += lines[k, x]


@njit(fastmath=True)
def _compare(light: Float, good: Float, box: NDArray[np.intp], lens: Float, pair: Float, sums: Float) -> None:
    """Add the squared differences of one micro-image from another one at one disparity, and their weights.

    ``box`` is the first pixel, ``lens`` the centre and the radius. ``pair`` contains the displacement of the pixels,
    the centre of the other micro-image relative to this one, the weight of the pair, and the limit of squared
    differences.
    """
    top, left, side = box[0], box[1], sums.shape[1]
    cy, cx, radius = lens[0], lens[1], lens[2]
    sy, sx, by, bx, weight, most = pair[0], pair[1], pair[2], pair[3], np.float32(pair[4]), np.float32(pair[5])
    iy, ix = int(np.floor(sy)), int(np.floor(sx))
    fy, fx = np.float32(sy - iy), np.float32(sx - ix)
    a, b = (1 - fy) * (1 - fx), (1 - fy) * fx
    c, d = fy * (1 - fx), fy * fx
    # interpolation averages noise: without this factor, noise alone would prefer disparities between pixels
    scale = weight / (1 + a * a + b * b + c * c + d * d)
    for y in range(side):
        row = top + y
        mine = _inside(radius, row - cy)
        other = _inside(radius, row + sy - cy - by)
        below = row + iy
        if mine < 0 or other < 0 or row < 0 or row >= light.shape[0] or below < 0 or below + 1 >= light.shape[0]:
            continue
        first = max(max(np.ceil(cx - mine), np.ceil(cx + bx - sx - other)), max(0, -ix))
        last = min(min(np.floor(cx + mine), np.floor(cx + bx - sx + other)), light.shape[1] - 2 - max(ix, -1))
        first, last = max(first, left), min(last, left + side - 1)
        one, two = light[below], light[below + 1]
        flag, flag2 = good[below], good[below + 1]
        for p in range(int(first), int(last) + 1):
            q = p + ix
            off = a * one[q] + b * one[q + 1] + c * two[q] + d * two[q + 1] - light[row, p]
            use = good[row, p] * flag[q] * flag[q + 1] * flag2[q] * flag2[q + 1]
            sums[0, y, p - left] += scale * use * min(off * off, most)
            sums[1, y, p - left] += weight * use


@njit()
def _costs(light: Float, good: Float, lenslets: Lenslets, how: Matching, box: NDArray[np.intp], volume: Float) -> None:
    """Write the mean squared differences and the numbers of terms to ``volume`` ``(m, 2, side, side)``.

    ``box`` are the first row and column, and the number of the micro-image.
    """
    i = box[2]
    side = volume.shape[2]
    sums, lines = np.empty((2, side, side), np.float32), np.empty((side, side), np.float32)
    lens, pair = np.empty(3), np.empty(6)
    lens[0], lens[1], lens[2] = lenslets.centres[i, 0], lenslets.centres[i, 1], lenslets.radius
    for k in range(len(how.rho)):
        sums[:] = 0
        for j in lenslets.near[i]:
            weight = how.weight[k, lenslets.types[i], lenslets.types[j]] if j >= 0 else np.float32(0)
            if weight <= 0:
                continue
            by, bx = lenslets.centres[j, 0] - lens[0], lenslets.centres[j, 1] - lens[1]
            pair[0], pair[1] = by - how.rho[k] * by, bx - how.rho[k] * bx
            pair[2], pair[3], pair[4], pair[5] = by, bx, weight, how.most
            _compare(light, good, box, lens, pair, sums)
        _box(sums[0], how.half, volume[k, 0], lines)
        _box(sums[1], how.half, volume[k, 1], lines)
    least = MIN_TERMS * (2 * how.half + 1) ** 2
    for k, y, x in np.ndindex((len(how.rho), side, side)):
        terms = volume[k, 1, y, x]
        volume[k, 0, y, x] = volume[k, 0, y, x] / terms if terms >= least else np.inf


@njit()
def _distinct(costs: Float, best: int, margin: float) -> bool:
    """Return whether costs ``(m, 2)`` rise by a margin on both sides of the best, and are higher beyond."""
    low = costs[best, 0]
    for way in (-1, 1):
        k, top, rival = best + way, low, np.inf
        while 0 <= k < len(costs) and top <= costs[k, 0] < np.inf:
            top = costs[k, 0]
            k += way
        while 0 <= k < len(costs):
            rival = min(rival, costs[k, 0])
            k += way
        if min(top, rival) - low < margin:
            return False
    return True


@njit()
def _best(costs: Float, floor: float, shared: float) -> tuple[float, float]:
    """Return position (steps) and standard error (steps) of the best of costs ``(m, 2)``; NaN if it is not distinct."""
    m, best = len(costs), 0
    for k in range(m):
        if costs[k, 0] < costs[best, 0]:
            best = k
    if best == 0 or best == m - 1:
        return np.nan, np.nan
    low, before, after = costs[best, 0], costs[best - 1, 0], costs[best + 1, 0]
    bend = before + after - 2 * low
    if not (np.isfinite(bend) and bend > 0):
        return np.nan, np.nan
    variance, terms = max(low - (before - after) ** 2 / (8 * bend), 0.0) + floor, costs[best, 1]
    # noise alone makes no bowl that deep
    if not _distinct(costs, best, variance * (DISTINCT * np.sqrt(4 * shared / terms) + DEEP)):
        return np.nan, np.nan
    return best + 0.5 * (before - after) / bend, np.sqrt(2 * shared * variance / (terms * bend))


@njit()
def match_lenslets(
    light: Float, good: Float, lenslets: Lenslets, how: Matching, found: Float, numbers: tuple[int, int]
) -> None:
    """Write inverse slope and standard error of the pixels of some micro-images to ``found`` ``(2, rows, columns)``.

    ``numbers`` is the first of these micro-images, and the one after the last.
    """
    side = 2 * int(np.ceil(lenslets.radius)) + 1
    volume = np.empty((len(how.rho), 2, side, side), np.float32)
    box = np.empty(3, np.intp)
    step = how.rho[1] - how.rho[0]
    curve = np.empty((len(how.rho), 2), np.float32)
    for i in range(numbers[0], numbers[1]):
        cy, cx = lenslets.centres[i, 0], lenslets.centres[i, 1]
        box[0], box[1], box[2] = int(np.rint(cy)) - side // 2, int(np.rint(cx)) - side // 2, i
        _costs(light, good, lenslets, how, box, volume)
        for y in range(side):
            row = box[0] + y
            reach = _inside(lenslets.radius, row - cy)
            if row < 0 or row >= light.shape[0] or reach < 0:
                continue
            for x in range(side):
                column = box[1] + x
                if abs(column - cx) > reach or column < 0 or column >= light.shape[1] or good[row, column] == 0:
                    continue
                for k in range(len(curve)):
                    curve[k, 0], curve[k, 1] = volume[k, 0, y, x], volume[k, 1, y, x]
                place, error = _best(curve, how.floor, how.shared)
                if np.isfinite(place):
                    found[0, row, column] = how.rho[0] + place * step
                    found[1, row, column] = error * abs(step)


@njit()
def _reach(raster: Raster, place: tuple[float, float], half: tuple[float, float], shape: tuple[int, int]) -> Any:
    """Return the samples ``top, bottom, left, right`` (ends excluded) about a position, at least the nearest one."""
    y, x = (place[0] - raster.corner_y) / raster.step_y, (place[1] - raster.corner_x) / raster.step_x
    high, wide = max(half[0] / raster.step_y, 0.5), max(half[1] / raster.step_x, 0.5)
    top, bottom = max(int(np.ceil(y - high)), 0), min(int(np.floor(y + high)) + 1, shape[0])
    left, right = max(int(np.ceil(x - wide)), 0), min(int(np.floor(x + wide)) + 1, shape[1])
    return top, bottom, left, right


@njit()
def _votes(found: Float, lenslets: Lenslets, raster: Raster, how: Matching, histogram: Float, best: Float) -> None:
    """Count the depths at each sample by bins ``(m, rows, columns)``; or with ``best``, sum those that agree with it.

    ``histogram`` is then ``(6, rows, columns)``: weight, weighted offset from the best bin, its square, numbers of
    pixels and of lenslets, and the last lenslet.
    """
    shape, step = histogram.shape[1:], how.rho[1] - how.rho[0]
    count, side = len(how.rho), int(np.ceil(lenslets.radius))
    far = (shape[0] - 1) * raster.step_y + raster.corner_y
    widest = lenslets.radius * MAX_SLOPE + raster.step_y
    for i in range(len(lenslets.centres)):
        cy, cx = lenslets.centres[i, 0], lenslets.centres[i, 1]
        if cy + widest < raster.corner_y or cy - widest > far:
            continue
        middle = int(np.rint(cy)), int(np.rint(cx))
        for row in range(max(middle[0] - side, 0), min(middle[0] + side + 1, found.shape[1])):
            for column in range(max(middle[1] - side, 0), min(middle[1] + side + 1, found.shape[2])):
                rho, error = found[0, row, column], found[1, row, column]
                if not abs(rho) * MAX_SLOPE >= 1 or (row - cy) ** 2 + (column - cx) ** 2 > lenslets.radius**2:
                    continue
                place = cy + (row - cy) / rho, cx + (column - cx) / rho
                half = 0.5 / abs(rho)
                top, bottom, left, right = _reach(raster, place, (half, half), shape)
                k = min(max(int(np.rint((rho - how.rho[0]) / step)), 0), count - 1)
                for y in range(top, bottom):
                    for x in range(left, right):
                        if len(best) == 0:
                            histogram[k, y, x] += 1 / (1 + (error / step) ** 2)
                        else:
                            _add(histogram[:, y, x], rho - best[y, x], error, step, i)


@njit()
def _add(sums: Float, off: float, error: float, step: float, number: int) -> None:
    """Add a depth to the sums of a sample, if it agrees with the best one."""
    if not abs(off) <= 1.5 * step + 3 * error:
        return
    weight = 1 / error**2
    sums[0] += weight
    sums[1] += weight * off
    sums[2] += weight * off * off
    sums[3] += 1
    if sums[5] != number + 1:
        sums[4] += 1
        sums[5] = number + 1


@njit()
def _modes(histogram: Float, rho: Float) -> tuple[Float, Float]:
    """Return the most frequent inverse slope of each sample, three bins wide, and its fraction of all depths there."""
    count, high, wide = histogram.shape
    best, share = np.full((high, wide), np.nan), np.zeros((high, wide))
    for y in range(high):
        for x in range(wide):
            top, total = 0.0, 0.0
            for k in range(count):
                total += histogram[k, y, x]
                three = histogram[k, y, x]
                three += histogram[k - 1, y, x] if k > 0 else 0
                three += histogram[k + 1, y, x] if k + 1 < count else 0
                if three > top:
                    top, best[y, x] = three, rho[k]
            share[y, x] = min(top / total, 1.0) if total > 0 else 0.0
    return best, share


@njit()
def join_rows(
    found: Float, lenslets: Lenslets, how: Matching, raster: Raster, out: Float, rows: tuple[int, int]
) -> None:
    """Write rows of the central view to ``out`` ``(4, rows, columns)``.

    The values are the inverse slope, its standard error, the fraction of depths that agree, and their number of
    lenslets.
    """
    part = Raster(raster.corner_y + rows[0] * raster.step_y, raster.corner_x, raster.step_y, raster.step_x)
    high, wide = rows[1] - rows[0], out.shape[2]
    histogram = np.zeros((len(how.rho), high, wide), np.float32)
    _votes(found, lenslets, part, how, histogram, np.zeros((0, 0)))
    best, share = _modes(histogram, how.rho)
    sums = np.zeros((6, high, wide), np.float32)
    _votes(found, lenslets, part, how, sums, best)
    for y in range(high):
        for x in range(wide):
            if not sums[0, y, x] > 0:
                continue
            weight, pixels, lenses = sums[0, y, x], sums[3, y, x], sums[4, y, x]
            off = sums[1, y, x] / weight
            spread = max(sums[2, y, x] - weight * off * off, 0.0) / max(pixels - 1, 1)
            # both of a pair are compared with each other, and pixels of a lenslet nearly share their windows
            variance = 2 * pixels / (lenses * weight) * max(spread, 1.0)
            out[0, rows[0] + y, x] = best[y, x] + off
            out[1, rows[0] + y, x] = np.sqrt(variance)
            out[2, rows[0] + y, x] = share[y, x]
            out[3, rows[0] + y, x] = lenses


@njit()
def _cubic(t: float) -> tuple[float, float, float, float]:
    """Return Keys's weights of the four samples about a position ``t`` behind the second one."""
    return (
        ((-0.5 * t + 1) * t - 0.5) * t,
        (1.5 * t - 2.5) * t * t + 1,
        ((-1.5 * t + 2) * t + 0.5) * t,
        (0.5 * t - 0.5) * t * t,
    )


@njit(fastmath=True)
def _add_view(view: Float, good: Float, move: tuple[float, float], sums: Float, rows: tuple[int, int]) -> float:
    """Add weight, weighted value, its square and count of a view moved by samples to ``sums`` ``(4, rows, columns)``.

    Return the variance of its noise relative to that of the view that is not moved.
    """
    high, wide = view.shape
    iy, ix = int(np.floor(move[0])), int(np.floor(move[1]))
    wy, wx = _cubic(move[0] - iy), _cubic(move[1] - ix)
    a, b, c, d = np.float32(wx[0]), np.float32(wx[1]), np.float32(wx[2]), np.float32(wx[3])
    p, q, r, s = np.float32(wy[0]), np.float32(wy[1]), np.float32(wy[2]), np.float32(wy[3])
    near_y, near_x = int(move[0] - iy > 0.5), int(move[1] - ix > 0.5)
    for y in range(rows[0], rows[1]):
        if y + iy - 1 < 0 or y + iy + 2 >= high:
            continue
        line, flag = sums[:, y - rows[0]], good[y + iy + near_y]
        e, f, g, h = view[y + iy - 1], view[y + iy], view[y + iy + 1], view[y + iy + 2]
        for x in range(max(0, 1 - ix), min(wide, wide - 2 - ix)):
            k = x + ix
            value = p * (a * e[k - 1] + b * e[k] + c * e[k + 1] + d * e[k + 2])
            value += q * (a * f[k - 1] + b * f[k] + c * f[k + 1] + d * f[k + 2])
            value += r * (a * g[k - 1] + b * g[k] + c * g[k + 1] + d * g[k + 2])
            value += s * (a * h[k - 1] + b * h[k] + c * h[k + 1] + d * h[k + 2])
            weight = flag[k + near_x]
            line[0, x] += weight
            line[1, x] += weight * value
            line[2, x] += weight * value * value
            line[3, x] += weight > 0
    return (wy[0] ** 2 + wy[1] ** 2 + wy[2] ** 2 + wy[3] ** 2) * (wx[0] ** 2 + wx[1] ** 2 + wx[2] ** 2 + wx[3] ** 2)


@njit()
def sweep_rows(views: Float, good: Float, moves: Float, out: Float, rows: tuple[int, int], fewest: int) -> None:
    """Write sums of squares and numbers of terms of rows of the views on a plane to ``out`` ``(2, rows, columns)``.

    View ``n`` of ``views`` ``(n, rows, columns)`` shows sample S of the plane at S + moves[n]. ``good`` are weights:
    one over the variance of the noise, or 0. Samples that fewer than ``fewest`` views show have 0 terms.
    """
    sums, gain = np.zeros((4, rows[1] - rows[0], views.shape[2]), np.float32), 0.0
    for n in range(len(views)):
        gain += _add_view(views[n], good[n], (moves[n, 0], moves[n, 1]), sums, rows)
    gain /= max(len(views), 1)
    for y in range(rows[1] - rows[0]):
        for x in range(views.shape[2]):
            count, weight = sums[3, y, x], sums[0, y, x]
            known = count >= fewest
            out[0, y, x] = max(sums[2, y, x] - sums[1, y, x] ** 2 / weight, 0.0) / gain if known else 0.0
            out[1, y, x] = count - 1 if known else 0.0


@njit()
def match_views(volume: Float, how: Matching, found: Float, rows: tuple[int, int], fewest: int) -> None:
    """Write slope and standard error of rows of the central view to ``found`` ``(2, rows, columns)``.

    ``volume`` ``(m, 2, rows, columns)`` are the sums of squares and numbers of terms on planes of slopes ``how.rho``.
    ``fewest`` is as in `sweep_rows`.
    """
    least = fewest * MIN_TERMS * (2 * how.half + 1) ** 2
    curve, step = np.empty((len(how.rho), 2), np.float32), how.rho[1] - how.rho[0]
    for y in range(rows[0], rows[1]):
        for x in range(volume.shape[3]):
            for k in range(len(how.rho)):
                terms = volume[k, 1, y, x]
                curve[k, 0] = volume[k, 0, y, x] / terms if terms >= least else np.inf
                curve[k, 1] = terms
            place, error = _best(curve, how.floor, how.shared)
            if np.isfinite(place):
                found[0, y, x] = how.rho[0] + place * step
                found[1, y, x] = error * abs(step)
