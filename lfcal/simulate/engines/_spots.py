"""Compiled loops of the geometric engine: clip a lenslet's light, and draw the spot with exact pixel areas.

A spot is a convex polygon of constant irradiance. It is clipped by the algorithm of Sutherland and Hodgman (1974). Its
cover of each pixel is the exact area, from signed areas under the edges (Green's theorem), as in font rasterizers. An
edge adds its cover to the cells it crosses, and a sum along the row extends it to all cells to its right.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import njit

__all__ = ["Canvas", "LitLenslets", "Shapes", "SpotDrawing", "canvas", "draw_spots"]

Array = NDArray[Any]
F8 = NDArray[np.float64]


class LitLenslets(NamedTuple):
    """The lenslets that may be lit, and how each transforms a spot."""

    centres: F8  # (lenslets, 2) as (x, y) (µm)
    pull: F8  # (lenslets,): the spot's middle is at c - pull (c - X0)
    size: F8  # (lenslets,): ratio of spot to subject, negative if it is inverted
    gain: F8  # (lenslets,): fraction of the light that passes


class Shapes(NamedTuple):
    """Two convex polygons: the light behind a lenslet is their intersection.

    The subject is clipped and drawn. It is the lenslet's aperture (µm), or the pupil (radii of f/(2 Nw)) if its
    shadow is smaller. The window is the other polygon, in µm on the array, given by its half planes normal . p <=
    limit.
    """

    subject: F8  # (vertices, 2)
    normals: F8  # (sides, 2), of length 1
    limits: F8  # (sides,) (µm)
    factor: float  # from the subject's units to µm on the array: 1, or a'/(2 Nw)
    sign: float  # of c - X0, which places the subject within the window
    reach: float  # radius about the subject, on the array (µm)
    inner: float  # radius inside the window (µm)
    outer: float  # radius around the window (µm)


class SpotDrawing(NamedTuple):
    """How spots become pixel values."""

    px_um: float  # pixel pitch
    density: float  # energy per area of the subject
    least: float  # smallest scale of a spot, because in focus its area would be 0 and its irradiance infinite


class Canvas(NamedTuple):
    """The cutouts that spots are added to, and scratch memory: without allocations, code compiles faster."""

    out: Array  # (n, nt, ns)
    polygon: F8  # (vertices, 2)
    clipped: F8  # (vertices, 2)
    cover: F8  # (nt + 2, ns + 3)


def canvas(out: Array, shapes: Shapes) -> Canvas:
    """Return cutouts ``(n, nt, ns)`` with the memory that `draw_spots` needs."""
    room = shapes.subject.shape[0] + shapes.normals.shape[0] + 8  # each half plane adds one vertex at most
    return Canvas(out, np.empty((room, 2)), np.empty((room, 2)), np.zeros((out.shape[1] + 2, out.shape[2] + 3)))


@njit(_nrt=False)
def _cut(source: Array, n: int, target: Array, nx: float, ny: float, limit: float) -> int:
    """Clip a convex polygon to nx x + ny y <= limit; return its number of vertices."""
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


@njit(inline="always")
def _area(p: Array, n: int) -> float:
    """Return the signed area of the first ``n`` vertices: half the sum of x_i y_i+1 - x_i+1 y_i (shoelace)."""
    total = 0.0
    for i in range(n):
        j = i + 1 if i + 1 < n else 0
        total += p[i, 0] * p[j, 1] - p[j, 0] * p[i, 1]
    return 0.5 * total


@njit(inline="always")
def _edge(acc: Array, r: int, xl: float, xr: float, d: float) -> None:
    """Add the signed cover ``d`` of one edge within row r: the share right of the edge, column by column.

    The added numbers are differences from column to column; their sum along the row is the cover. ``d`` is the height
    of the edge's part in the row, ``xl`` <= ``xr`` are its ends.
    """
    il, ir = int(xl), int(xr)
    if il == ir or xr == il + 1.0:
        middle = 0.5 * (xl + xr) - il  # within one column, the part to the right of the edge is a trapezoid
        acc[r, il] += d * (1 - middle)
        acc[r, il + 1] += d * middle
        return
    s = 1 / (xr - xl)  # height gained per column; a triangle in the first column, trapezoids, a triangle cut off
    t = il + 1 - xl
    before = 0.5 * s * (t * t)
    acc[r, il] += d * before
    for c in range(il + 1, ir):
        cover = s * (c + 0.5 - xl)
        acc[r, c] += d * (cover - before)
        before = cover
    t = xr - ir
    cover = 1 - 0.5 * s * t * t
    acc[r, ir] += d * (cover - before)
    acc[r, ir + 1] += d * (1 - cover)


@njit(inline="always")
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
            # limited to the ends: rounding must not leave the cells of the polygon
            next_x = min(max(x0 + slope * (below - y0), min(x0, x1)), max(x0, x1))
            _edge(acc, r, min(x, next_x), max(x, next_x), sign * (below - y))
            x, y = next_x, below


@njit(inline="always")
def _overlap(shapes: Shapes, dx: float, dy: float, a: Array, b: Array) -> int:
    """Leave in ``a`` the part of the subject inside the window, c - X0 = (dx, dy); return its number of vertices."""
    n: int = shapes.subject.shape[0]
    for i in range(n):  # a loop, because numba takes seconds longer to compile operations on arrays of different shapes
        a[i, 0], a[i, 1] = shapes.subject[i, 0], shapes.subject[i, 1]
    if math.sqrt(dx * dx + dy * dy) <= shapes.inner - shapes.reach:
        return n  # completely inside: nothing to clip
    for k in range(shapes.limits.size):
        nx, ny = shapes.normals[k, 0], shapes.normals[k, 1]
        # normal . (factor u + sign (c - X0)) <= limit: the window is fixed, the subject moves
        limit = shapes.limits[k] - shapes.sign * (nx * dx + ny * dy)
        kept = _cut(a, n, b, shapes.factor * nx, shapes.factor * ny, limit)
        if kept < 3:
            return 0
        for i in range(kept):
            a[i, 0], a[i, 1] = b[i, 0], b[i, 1]
        n = kept
    return n


@njit(inline="always")
def _bounds(p: Array, n: int) -> tuple[float, float, float, float]:
    """Return the least and greatest x and y of the first ``n`` vertices."""
    x0, x1, y0, y1 = 1e300, -1e300, 1e300, -1e300
    for i in range(n):
        x0, x1, y0, y1 = min(x0, p[i, 0]), max(x1, p[i, 0]), min(y0, p[i, 1]), max(y1, p[i, 1])
    return x0, x1, y0, y1


@njit(_nrt=False)
def _paint(image: Array, a: Array, b: Array, n: int, gain: float, acc: Array) -> tuple[float, float]:
    """Add a spot of irradiance ``gain``, in pixels from the cutout's corner, to ``image`` (nt, ns).

    Returns the energy of the spot's part in the cutout, and the energy that was drawn; both are 0 if it is outside.
    They are computed by two different sums and agree up to rounding. ``a`` contains the polygon, ``b`` and ``acc``
    are scratch.
    """
    nt, ns = image.shape
    x0, x1, y0, y1 = _bounds(a, n)
    if x1 <= 0 or y1 <= 0 or x0 >= ns or y0 >= nt:
        return 0.0, 0.0
    if x0 < 0 or y0 < 0 or x1 > ns or y1 > nt:
        n = _cut(a, n, b, -1.0, 0.0, 0.0)
        n = _cut(b, n, a, 1.0, 0.0, float(ns))
        n = _cut(a, n, b, 0.0, -1.0, 0.0)
        n = _cut(b, n, a, 0.0, 1.0, float(nt))
        if n < 3:
            return 0.0, 0.0
        x0, x1, y0, y1 = _bounds(a, n)
    left, top = max(0, int(x0)), max(0, int(y0))
    w, h = min(int(x1), ns - 1) - left + 1, min(int(y1), nt - 1) - top + 1
    for i in range(n):
        a[i, 0] -= left
        a[i, 1] -= top
    lit = abs(_area(a, n)) * gain
    for r in range(h + 1):  # one row and two columns more than the spot: edges end on cell borders
        for c in range(w + 2):
            acc[r, c] = 0.0
    _draw(a, n, acc, h)
    drawn = 0.0
    for r in range(h):
        cover = 0.0
        for c in range(w):
            cover += acc[r, c]
            value = abs(cover) * gain  # the sign is the polygon's direction of rotation
            image[top + r, left + c] += value
            drawn += value
    return lit, drawn


@njit(_nrt=False)
def draw_spots(
    target: Canvas, source: Array, pixel: Array, lenslets: LitLenslets, shapes: Shapes, drawing: SpotDrawing
) -> tuple[int, float, float, float]:
    """Add the spots of all lenslets to the cutouts of ``target``.

    A point u of the subject (see `Shapes`) arrives at s = c - pull (c - X0) + size u, where c is the centre of the
    lenslet. This holds whether the subject is the aperture of the lenslet or the pupil.

    Parameters
    ----------
    source
        Images X0 of the sources ``(n, 2)`` as (x, y) (µm).
    pixel
        Middle pixels of the cutouts ``(n, 2)`` as (row, column).
    lenslets, shapes, drawing
        As documented in these classes.

    Returns
    -------
    tuple
        Number of spots, energy of the spots in the cutouts, energy that was drawn, and the largest ratio of drawn
        energy to energy of a single spot.
    """
    out, a, b, acc = target.out, target.polygon, target.clipped, target.cover
    nt, ns, px = out.shape[1], out.shape[2], drawing.px_um
    centres, pulls, sizes, gains = lenslets.centres, lenslets.pull, lenslets.size, lenslets.gain
    far = shapes.outer + shapes.reach
    count, energy_in, energy_out, worst = 0, 0.0, 0.0, 0.0
    for p in range(source.shape[0]):
        for q in range(centres.shape[0]):
            cx, cy = centres[q, 0], centres[q, 1]
            dx, dy = cx - source[p, 0], cy - source[p, 1]
            if math.sqrt(dx * dx + dy * dy) >= far:
                continue
            n = _overlap(shapes, dx, dy, a, b)
            if n < 3:
                continue
            scale, pull = sizes[q], pulls[q]
            if abs(scale) < drawing.least:
                scale = drawing.least if scale >= 0 else -drawing.least
            bx = (cx - pull * dx) / px - pixel[p, 1] + ns // 2 + 0.5
            by = (cy - pull * dy) / px - pixel[p, 0] + nt // 2 + 0.5
            per = px / scale
            for i in range(n):
                a[i, 0], a[i, 1] = bx + scale / px * a[i, 0], by + scale / px * a[i, 1]
            lit, drawn = _paint(out[p], a, b, n, gains[q] * drawing.density * (per * per), acc)
            if lit == 0.0 and drawn == 0.0:
                continue
            count += 1
            energy_in += lit
            energy_out += drawn
            if lit > 1e-30:
                worst = max(worst, drawn / lit)
    return count, energy_in, energy_out, worst
