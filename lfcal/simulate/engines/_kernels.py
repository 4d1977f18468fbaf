"""Compiled loops of the wave engine: one lenslet, many source positions of a row.

The zoomed Fourier transform of a lenslet's field is split by parity in both axes: with samples i dx and nodes
symmetric about 0 only cosines and sines over half the samples and half the nodes are needed, real matrices that
are the same for every lenslet of a type. That is a quarter of the products of the complex form. Every product is
kept below 2^18 multiply-adds, where BLAS libraries do not start threads of their own.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.compiled import njit
from lfcal.simulate.engines._lenslets import mask_from_disc, mask_from_table, straighten

__all__ = ["respond", "square_fields"]

F4 = NDArray[Any]  # single precision, or double where it is asked for
F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
_SMALL = 1 << 18


@njit()
def _product(a: F4, b: F4, out: F4) -> None:
    """Write out = a @ b in pieces too small for threaded BLAS."""
    rows = max(1, _SMALL // (a.shape[1] * b.shape[1]))
    for i in range(0, a.shape[0], rows):
        j = min(i + rows, a.shape[0])
        np.dot(a[i:j], b, out[i:j])


@njit(fastmath=True)
def fold(
    field_re: F4,
    field_im: F4,
    row: int,
    col: int,
    mask_re: F4,
    mask_im: F4,
    turn_x: float,
    turn_y: float,
    line: F4,
    ee: F4,
    eo: F4,
    oe: F4,
    oo: F4,
) -> float:
    """Multiply field, aperture and tilt, split by parity in y (first letter) and x; return the sum of the square.

    The four results are ``(h+1, 2 (h+1))``: real parts, then imaginary parts. ``turn`` is the tilt's phase per
    sample. ``line`` is scratch ``(6, 2h+1)``.
    """
    n = mask_re.shape[0]
    h = n // 2
    m = h + 1
    for j in range(n):
        line[4, j] = math.cos(turn_x * (j - h))
        line[5, j] = math.sin(turn_x * (j - h))
    total = 0.0
    for i in range(m):
        for side in range(2):
            k = h + i if side == 0 else h - i
            angle = turn_y * (k - h)
            c, s = field_re.dtype.type(math.cos(angle)), field_re.dtype.type(math.sin(angle))
            part = field_re.dtype.type(0)
            base = col - h
            r = row - h + k
            for j in range(n):
                er, ei = field_re[r, base + j], field_im[r, base + j]
                mr, mi = mask_re[k, j], mask_im[k, j]
                fr, fi = er * mr - ei * mi, er * mi + ei * mr
                tr, ti = line[4, j] * c - line[5, j] * s, line[4, j] * s + line[5, j] * c
                part += fr * fr + fi * fi
                line[2 * side, j] = fr * tr - fi * ti
                line[2 * side + 1, j] = fr * ti + fi * tr
            if side == 0 or i > 0:
                total += part
        if i == 0:
            for j in range(n):
                line[2, j] = 0
                line[3, j] = 0
        for j in range(1, m):
            pr, pi = line[0, h + j] + line[0, h - j], line[1, h + j] + line[1, h - j]
            qr, qi = line[2, h + j] + line[2, h - j], line[3, h + j] + line[3, h - j]
            ee[i, j], ee[i, m + j] = pr + qr, pi + qi
            oe[i, j], oe[i, m + j] = pr - qr, pi - qi
            pr, pi = line[0, h + j] - line[0, h - j], line[1, h + j] - line[1, h - j]
            qr, qi = line[2, h + j] - line[2, h - j], line[3, h + j] - line[3, h - j]
            eo[i, j], eo[i, m + j] = pr + qr, pi + qi
            oo[i, j], oo[i, m + j] = pr - qr, pi - qi
        ee[i, 0], ee[i, m] = line[0, h] + line[2, h], line[1, h] + line[3, h]
        oe[i, 0], oe[i, m] = line[0, h] - line[2, h], line[1, h] - line[3, h]
        eo[i, 0], eo[i, m] = 0, 0
        oo[i, 0], oo[i, m] = 0, 0
    return total


@njit()
def transform(
    cosine: F4, sine: F4, cosine_t: F4, sine_t: F4, ee: F4, eo: F4, oe: F4, oo: F4, half: F4, out: F4
) -> None:
    """Zoomed transform of the four parities: ``out[parity]`` is ``(2 k, k)``, rows real and imaginary in turn.

    ``cosine``, ``sine`` are (k, h+1), the transposes ``_t`` (h+1, k); ``half`` is scratch (k, 2(h+1)).
    """
    m, k = cosine_t.shape
    parts = half.reshape(2 * k, m)
    _product(cosine, ee, half)
    _product(parts, cosine_t, out[0])
    _product(cosine, eo, half)
    _product(parts, sine_t, out[1])
    _product(sine, oe, half)
    _product(parts, cosine_t, out[2])
    _product(sine, oo, half)
    _product(parts, sine_t, out[3])


@njit(fastmath=True)
def add_incoherent(
    quarters: F4, nodes: F4, bins: F4, bins_t: F4, half: F4, pixels: F4, image: F4, top: int, left: int
) -> float:
    """Square the field, integrate over pixels, add to the cutout; return the energy of the whole window.

    Field at (+-y, +-x) is (a - s d) - i (s_x b + s_y c) with a, b, c, d the four parities and s = s_x s_y.
    """
    k = quarters.shape[2]
    n = nodes.shape[0]
    up, down = n // 2, (n - 1) // 2
    for i in range(k):
        for j in range(k):
            ar, ai = quarters[0, 2 * i, j], quarters[0, 2 * i + 1, j]
            br, bi = quarters[1, 2 * i, j], quarters[1, 2 * i + 1, j]
            cr, ci = quarters[2, 2 * i, j], quarters[2, 2 * i + 1, j]
            dr, di = quarters[3, 2 * i, j], quarters[3, 2 * i + 1, j]
            pr, pi, qr, qi = ar - dr, ai - di, br + cr, bi + ci
            square, cross = pr * pr + pi * pi + qr * qr + qi * qi, 2 * (pr * qi - pi * qr)
            nodes[up + i, up + j] = square + cross
            nodes[down - i, down - j] = square - cross
            pr, pi, qr, qi = ar + dr, ai + di, cr - br, ci - bi
            square, cross = pr * pr + pi * pi + qr * qr + qi * qi, 2 * (pr * qi - pi * qr)
            nodes[up + i, down - j] = square + cross
            nodes[down - i, up + j] = square - cross
    _product(nodes, bins, half)
    _product(bins_t, half, pixels)
    total = 0.0
    w = pixels.shape[0]
    for i in range(w):
        for j in range(w):
            total += pixels[i, j]
    first, last = max(0, -left), min(w, image.shape[1] - left)
    for i in range(max(0, -top), min(w, image.shape[0] - top)):
        for j in range(first, last):
            image[top + i, left + j] += pixels[i, j]
    return float(total)


@njit(fastmath=True)
def add_coherent(quarters: F4, turn_y: F8, turn_x: F8, grid_re: F4, grid_im: F4, top: int, left: int) -> float:
    """Add the field times its phase to the position's node grid; return the sum of its square.

    ``turn`` are ``(2, n)``, cosines and sines of the phase along each axis; ``top``, ``left`` are in nodes.
    """
    k = quarters.shape[2]
    n = turn_x.shape[1]
    up, down = n // 2, (n - 1) // 2
    total = 0.0
    for i in range(k):
        for side_y in range(2):
            r = up + i if side_y == 0 else down - i
            if side_y == 1 and r == up:
                continue
            sy = quarters.dtype.type(1 - 2 * side_y)
            yr, yi = quarters.dtype.type(turn_y[0, r]), quarters.dtype.type(turn_y[1, r])
            seen_y = 0 <= top + r < grid_re.shape[0]
            for side_x in range(2):
                sx = quarters.dtype.type(1 - 2 * side_x)
                part = quarters.dtype.type(0)
                for j in range(side_x * (1 if up == down else 0), k):
                    c = up + j if side_x == 0 else down - j
                    re = (
                        quarters[0, 2 * i, j]
                        - sx * sy * quarters[3, 2 * i, j]
                        + (sx * quarters[1, 2 * i + 1, j] + sy * quarters[2, 2 * i + 1, j])
                    )
                    im = (
                        quarters[0, 2 * i + 1, j]
                        - sx * sy * quarters[3, 2 * i + 1, j]
                        - (sx * quarters[1, 2 * i, j] + sy * quarters[2, 2 * i, j])
                    )
                    part += re * re + im * im
                    if seen_y and 0 <= left + c < grid_re.shape[1]:
                        xr, xi = quarters.dtype.type(turn_x[0, c]), quarters.dtype.type(turn_x[1, c])
                        tr, ti = xr * yr - xi * yi, xr * yi + xi * yr
                        grid_re[top + r, left + c] += re * tr - im * ti
                        grid_im[top + r, left + c] += re * ti + im * tr
                total += part
    return total


@njit(fastmath=True)
def respond(
    field_re: F4,
    field_im: F4,
    dx: float,
    disc_re: F4,
    disc_im: F4,
    disc_step: float,
    cell: F4,
    cell_step: float,
    bend: float,
    cosine: F4,
    sine: F4,
    bins: F4,
    scale: F8,
    rays: F8,
    nodes_um: F8,
    places: I8,
    numbers: F8,
    offsets: F8,
    out: F4,
    grid_re: F4,
    grid_im: F4,
    boxes: I8,
    energies: F8,
) -> None:
    """Add one lenslet's response to the cutouts (incoherent) or node grids (coherent) of the listed positions.

    Parameters
    ----------
    disc_re, disc_im, disc_step, cell, cell_step, bend
        Aperture tables: the cell's where ``cell`` is not empty, else the disc's, phase included.
    scale
        1 / (lambda B'), energy in per square of a masked sample, 1 - B'/a', nodes per pixel.
    rays
        For `straighten`: 2 pi B/lambda (0: paraxial), 1/a', 1/a' + 1/f.
    nodes_um
        Nodes of the window about its middle.
    places, numbers, offsets
        From `select`; lenslet minus source (n, 2) as (x, y).
    grid_re, grid_im, boxes
        Coherent: node grids ``(positions, rows, columns)`` and the touched box of each; empty otherwise.
    energies
        Out: ``(n, 2)`` energy in and out of each response.
    """
    cosine_t, sine_t, bins_t = cosine.T.copy(), sine.T.copy(), bins.T.copy()
    n, h = 2 * cosine.shape[1] - 1, cosine.shape[1] - 1
    m, k, count = h + 1, cosine.shape[0], bins.shape[0]
    w = bins.shape[1]
    re, im = np.empty((n, n), field_re.dtype), np.empty((n, n), field_re.dtype)
    bent_re, bent_im = np.empty_like(re), np.empty_like(im)
    line = np.empty((6, n), field_re.dtype)
    ee, eo = np.empty((m, 2 * m), field_re.dtype), np.empty((m, 2 * m), field_re.dtype)
    oe, oo = np.empty((m, 2 * m), field_re.dtype), np.empty((m, 2 * m), field_re.dtype)
    half, quarters = np.empty((k, 2 * m), field_re.dtype), np.empty((4, 2 * k, k), field_re.dtype)
    nodes, side = np.empty((count, count), field_re.dtype), np.empty((count, w), field_re.dtype)
    pixels = np.empty((w, w), field_re.dtype)
    turn_x, turn_y = np.empty((2, count)), np.empty((2, count))
    last_x = last_y = 1e300
    per = int(scale[3])
    rate = 2 * math.pi * scale[0]
    for f in range(places.shape[0]):
        x0, y0 = numbers[f, 0], numbers[f, 1]
        if abs(x0 - last_x) + abs(y0 - last_y) > 1e-6 * dx:
            if cell.shape[0]:
                mask_from_table(cell, cell_step, bend, dx, x0, y0, re, im)
            else:
                mask_from_disc(disc_re, disc_im, disc_step, dx, x0, y0, re, im)
            last_x, last_y = x0, y0
        p, row, col, top, left = places[f, 0], places[f, 1], places[f, 2], places[f, 3], places[f, 4]
        ox, oy = numbers[f, 2], numbers[f, 3]
        if rays[0] != 0:
            straighten(re, im, dx, x0, y0, offsets[f], rays, bent_re, bent_im)
            light = fold(
                field_re, field_im, row, col, bent_re, bent_im, -rate * dx * ox, -rate * dx * oy, line, ee, eo, oe, oo
            )
        else:
            light = fold(field_re, field_im, row, col, re, im, -rate * dx * ox, -rate * dx * oy, line, ee, eo, oe, oo)
        energies[f, 0] = scale[1] * light
        transform(cosine, sine, cosine_t, sine_t, ee, eo, oe, oo, half, quarters)
        if grid_re.shape[0] == 0:
            energies[f, 1] = add_incoherent(quarters, nodes, bins, bins_t, side, pixels, out[p], top, left)
            continue
        lx, ly = offsets[f, 0], offsets[f, 1]
        common = 0.5 * rate * (lx * lx + ly * ly) * scale[2]
        for j in range(count):
            a = common - rate * ((numbers[f, 4] + nodes_um[j]) * lx + x0 * (nodes_um[j] + ox))
            b = -rate * ((numbers[f, 5] + nodes_um[j]) * ly + y0 * (nodes_um[j] + oy))
            turn_x[0, j], turn_x[1, j] = math.cos(a), math.sin(a)
            turn_y[0, j], turn_y[1, j] = math.cos(b), math.sin(b)
        energies[f, 1] = add_coherent(quarters, turn_y, turn_x, grid_re[p], grid_im[p], top * per, left * per) / (
            per * per
        )
        boxes[p, 0], boxes[p, 1] = min(boxes[p, 0], top), max(boxes[p, 1], top + w)
        boxes[p, 2], boxes[p, 3] = min(boxes[p, 2], left), max(boxes[p, 3], left + w)


@njit(fastmath=True)
def square_fields(grid_re: F4, grid_im: F4, boxes: I8, weights: F4, per: int, out: F4) -> None:
    """Integrate the summed fields' squares over the pixels of each position's box; leave grids and boxes empty."""
    taps = weights.size
    line = np.empty(grid_re.shape[2], grid_re.dtype)
    for p in range(out.shape[0]):
        top, bottom = max(0, boxes[p, 0]), min(out.shape[1], boxes[p, 1])
        left, right = max(0, boxes[p, 2]), min(out.shape[2], boxes[p, 3])
        if top < bottom and left < right:
            first, last = left * per, right * per + taps - per
            for t in range(top, bottom):
                line[first:last] = 0
                for i in range(taps):
                    for j in range(first, last):
                        re, im = grid_re[p, t * per + i, j], grid_im[p, t * per + i, j]
                        line[j] += weights[i] * (re * re + im * im)
                for s in range(left, right):
                    total = weights[0] * line[s * per]
                    for j in range(1, taps):
                        total += weights[j] * line[s * per + j]
                    out[p, t, s] = total
            grid_re[p, top * per : bottom * per + taps - per, first:last] = 0
            grid_im[p, top * per : bottom * per + taps - per, first:last] = 0
        boxes[p, 0], boxes[p, 1], boxes[p, 2], boxes[p, 3] = 1 << 30, -(1 << 30), 1 << 30, -(1 << 30)
