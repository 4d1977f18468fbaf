"""Compiled loops of the geometric engine: clip a lenslet's light, draw the spot with exact pixel areas."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.compiled import njit

__all__ = ["draw_spots"]

Array = NDArray[Any]


@njit()
def _cut(source: Array, n: int, target: Array, nx: float, ny: float, limit: float) -> int:
    """Keep what of a convex polygon lies in nx x + ny y <= limit; return its number of vertices."""
    m = 0
    for i in range(n):
        j = i + 1 if i + 1 < n else 0
        x0, y0, x1, y1 = source[i, 0], source[i, 1], source[j, 0], source[j, 1]
        s0, s1 = nx * x0 + ny * y0 - limit, nx * x1 + ny * y1 - limit
        if s0 <= 0:
            target[m, 0], target[m, 1] = x0, y0
            m += 1
        if (s0 < 0 and s1 > 0) or (s0 > 0 and s1 < 0):
            t = s0 / (s0 - s1)
            target[m, 0], target[m, 1] = x0 + t * (x1 - x0), y0 + t * (y1 - y0)
            m += 1
    return m


@njit()
def _area(p: Array, n: int) -> float:
    total = 0.0
    for i in range(n):
        j = i + 1 if i + 1 < n else 0
        total += p[i, 0] * p[j, 1] - p[j, 0] * p[i, 1]
    return 0.5 * total


@njit()
def _edge(acc: Array, r: int, xl: float, xr: float, d: float) -> None:
    """Add the signed cover ``d`` of one edge within row r: the share right of the edge, column by column."""
    il, ir = int(xl), int(xr)
    if il == ir or xr == il + 1.0:
        middle = 0.5 * (xl + xr) - il
        acc[r, il] += d * (1 - middle)
        acc[r, il + 1] += d * middle
        return
    s = 1 / (xr - xl)
    before = 0.5 * s * (il + 1 - xl) ** 2
    acc[r, il] += d * before
    for c in range(il + 1, ir):
        cover = s * (c + 0.5 - xl)
        acc[r, c] += d * (cover - before)
        before = cover
    t = xr - ir
    cover = 1 - 0.5 * s * t * t
    acc[r, ir] += d * (cover - before)
    acc[r, ir + 1] += d * (1 - cover)


@njit()
def _draw(p: Array, n: int, acc: Array, h: int) -> None:
    """Accumulate signed cover of a polygon inside [0, w) x [0, h]; the prefix sum of a row is the area."""
    for i in range(n):
        j = i + 1 if i + 1 < n else 0
        x0, y0, x1, y1 = p[i, 0], p[i, 1], p[j, 0], p[j, 1]
        if y0 == y1:
            continue
        sign = 1.0
        if y0 > y1:
            x0, y0, x1, y1, sign = x1, y1, x0, y0, -1.0
        slope = (x1 - x0) / (y1 - y0)
        y, x = y0, x0
        for r in range(int(y0), min(math.ceil(y1), h)):
            below = y1 if y1 < r + 1 else r + 1.0
            if below - y <= 0:
                continue
            # held between the ends: rounding must not leave the cells of the polygon
            next_x = min(max(x0 + slope * (below - y0), min(x0, x1)), max(x0, x1))
            _edge(acc, r, min(x, next_x), max(x, next_x), sign * (below - y))
            x, y = next_x, below


@njit()
def draw_spots(
    out: Array,
    source: Array,
    pixel: Array,
    centres: Array,
    kinds: Array,
    subject: Array,
    normals: Array,
    limits: Array,
    rates: Array,
    pull: Array,
    size: Array,
    px: float,
    density: float,
) -> tuple[int, float, float, float]:
    """Add the spots of all lenslets to the cutouts ``out`` (n, nt, ns) of sources ``(n, 2)`` as (x, y).

    Parameters
    ----------
    subject
        The polygon that is clipped and drawn: the lenslet's aperture, or the pupil where its shadow is smaller.
    normals, limits
        Half planes of the other one, about its own centre.
    rates
        factor from subject to the array (1 or a'/(2 Nw)), sign of the lenslet's distance in the half planes,
        radius about the subject, radii in and about the window, least size of a spot's scale.
    pull, size
        Per lens type: the spot's middle is at c - pull (c - X0), its scale over the subject.
    density
        Energy per area of the subject.

    Returns
    -------
    tuple
        Responses, energy in, energy out, worst ratio.
    """
    nt, ns = out.shape[1], out.shape[2]
    factor, sign, r_subject, r_in, r_about, least = rates[0], rates[1], rates[2], rates[3], rates[4], rates[5]
    room = subject.shape[0] + normals.shape[0] + 8
    a, b = np.empty((room, 2)), np.empty((room, 2))
    acc = np.zeros((nt + 2, ns + 3))
    count, energy_in, energy_out, worst = 0, 0.0, 0.0, 0.0
    for p in range(source.shape[0]):
        for q in range(centres.shape[0]):
            dx, dy = centres[q, 0] - source[p, 0], centres[q, 1] - source[p, 1]
            apart = math.sqrt(dx * dx + dy * dy)
            if apart >= r_about + r_subject:
                continue
            n = subject.shape[0]
            a[:n] = subject
            if apart > r_in - r_subject:
                for k in range(normals.shape[0]):
                    limit = limits[k] - sign * (normals[k, 0] * dx + normals[k, 1] * dy)
                    n = _cut(a, n, b, factor * normals[k, 0], factor * normals[k, 1], limit)
                    a, b = b, a
                    if n < 3:
                        break
            if n < 3:
                continue
            kind = kinds[q]
            scale = size[kind]
            if abs(scale) < least:
                scale = least if scale >= 0 else -least
            bx = (centres[q, 0] - pull[kind] * dx) / px - pixel[p, 1] + ns // 2 + 0.5
            by = (centres[q, 1] - pull[kind] * dy) / px - pixel[p, 0] + nt // 2 + 0.5
            x0, x1, y0, y1 = 1e300, -1e300, 1e300, -1e300
            for i in range(n):
                a[i, 0], a[i, 1] = bx + scale / px * a[i, 0], by + scale / px * a[i, 1]
                x0, x1, y0, y1 = min(x0, a[i, 0]), max(x1, a[i, 0]), min(y0, a[i, 1]), max(y1, a[i, 1])
            gain = density * (px / scale) ** 2
            if x1 <= 0 or y1 <= 0 or x0 >= ns or y0 >= nt:
                continue
            if x0 < 0 or y0 < 0 or x1 > ns or y1 > nt:
                n = _cut(a, n, b, -1.0, 0.0, 0.0)
                n = _cut(b, n, a, 1.0, 0.0, float(ns))
                n = _cut(a, n, b, 0.0, -1.0, 0.0)
                n = _cut(b, n, a, 0.0, 1.0, float(nt))
                if n < 3:
                    continue
                x0, x1, y0, y1 = 1e300, -1e300, 1e300, -1e300
                for i in range(n):
                    x0, x1, y0, y1 = min(x0, a[i, 0]), max(x1, a[i, 0]), min(y0, a[i, 1]), max(y1, a[i, 1])
            left, top = max(0, int(x0)), max(0, int(y0))
            w, h = min(int(x1), ns - 1) - left + 1, min(int(y1), nt - 1) - top + 1
            for i in range(n):
                a[i, 0] -= left
                a[i, 1] -= top
            lit = abs(_area(a, n)) * gain
            acc[: h + 1, : w + 2] = 0
            _draw(a, n, acc, h)
            drawn = 0.0
            for r in range(h):
                cover = 0.0
                for c in range(w):
                    cover += acc[r, c]
                    value = abs(cover) * gain
                    out[p, top + r, left + c] += value
                    drawn += value
            count += 1
            energy_in += lit
            energy_out += drawn
            if lit > 1e-30:
                worst = max(worst, drawn / lit)
    return count, energy_in, energy_out, worst
