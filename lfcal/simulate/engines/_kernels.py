"""Compiled loops of the wave engine: one lenslet, many source positions of a row.

With c the lenslet, X0 the source's image and L = lambda B', the field behind the lenslet is (see `_wave.py`)

    V(s) = exp(i pi |s-c|^2/L)/L sum_k E(x_k + c - X0) m(x_k) exp(i pi sigma x_k^2/L)
           exp(-2 pi i x_k.(s - c + (B'/a')(c - X0))/L) dx^2,     x_k = (x0 + kx dx, y0 + ky dx).

The sum is split by parity in both axes. Samples and nodes are symmetric about 0. Therefore only cosines and sines over
half the samples and half the nodes are needed. They are real matrices, the same for every lenslet of a type. This takes
a quarter of the products of the complex form. Every product is kept below 2^18 multiply-adds, below which BLAS
libraries do not start threads.

Functions and records that a kernel uses must be in the same file, because the cache on disk only detects changes of
that file.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import kernel_spared, njit

__all__ = ["LensAperture", "LightTarget", "MainLensField", "Optics", "Zoom", "respond"]

F4 = NDArray[Any]  # single precision, or double where it is asked for
F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
_SMALL = 1 << 18

DISC_S = 3e-8
"""Additional processor time (s) per sample of a disc by numpy, instead of by `mask_from_disc`."""


class Split(NamedTuple):
    """Complex values as two real arrays of the same shape, so that loops over them are vectorised."""

    re: F4
    im: F4


class MainLensField(NamedTuple):
    """The main lens's field E (or U near the native plane) on the array, about the source's image."""

    re: F4  # (n, n), rows along y; sample (n // 2, n // 2) lies at X0
    im: F4  # (n, n)
    dx_um: float  # distance of samples


class LensAperture(NamedTuple):
    """The aperture of one lens type on the samples: the table of its cell if there is one, else of a disc."""

    disc_re: F4  # (entries,) over r^2: aperture times exp(i bend r^2) times dx^2 pixel / L
    disc_im: F4
    disc_step: float  # µm^2 from entry to entry
    cell: F4  # (side, side), rows along y, origin in the middle: aperture times dx^2 pixel / L; (0, 0) for discs
    cell_step: float  # µm
    bend: float  # pi sigma / L (rad/µm^2), already included in the disc's table
    quartic: float  # phase per fourth power of the distance (rad/µm^4), also included


class Zoom(NamedTuple):
    """The Fourier transform from the samples to the nodes of the window on the sensor, and from nodes to pixels."""

    cosine: F4  # (nodes >= 0, half + 1): cos(2 pi s_i x_j / L)
    sine: F4  # the same with sines
    cosine_t: F4  # the transposes, contiguous for the matrix products
    sine_t: F4
    bins: F4  # (nodes, width): intensities at the nodes to pixels, along one axis
    bins_t: F4
    nodes_um: F8  # (nodes,) relative to the window's middle
    per_px: int  # nodes to a pixel


class Optics(NamedTuple):
    """Values that all lenslets of one type share, apart from their aperture."""

    per_spread: float  # 1 / L (1/µm^2)
    share: float  # energy per unit of sum |E m|^2, with the scale of the aperture's table
    sphere: float  # 1 - B'/a': remaining fraction of a lenslet's quadratic phase after the converging sphere
    rays: float  # 2 pi B'/lambda (rad) for rays at exact angles; 0: paraxial
    source_rate: float  # sine of a ray per µm of c - X0: 1/a'
    point_rate: float  # sine of a ray per µm on the lenslet: 1/a' + 1/f
    gap: float  # B' (µm)
    accept: tuple[float, float, float]  # power n of the pixels' response cos^n, chief ray's slope (y, x); n = 0: none
    glass: F8  # (5,): terms in sin^4, sin^6 ... of exact angles that remain with a plate before the sensor


class LightTarget(NamedTuple):
    """Where light is added: the cutouts; for fields, the node grids of the positions, which are squared at the end."""

    image: F4  # (positions, rows, columns) of pixels
    grid_re: F4  # (positions, rows, columns) of nodes; no positions if intensities are added
    grid_im: F4
    boxes: I8  # (positions, 4): first and past-last row and column of pixels touched so far


EE, EO, OE, OO = range(4)
"""Parts of a field that are even or odd in y (first letter) and x (second), as indices of an array of parities."""


class _Scratch(NamedTuple):
    """Memory of one call of `respond`, n = 2 half + 1 samples, k nodes >= 0, c nodes and w pixels a side."""

    mask: Split  # (n, n)
    bent: Split  # (n, n)
    line: F4  # (6, n)
    parities: F4  # (4, half + 1, 2 (half + 1)) by `EE` and so on: real parts, then imaginary
    half: F4  # (k, 2 (half + 1))
    lines: F4  # the same memory as (2 k, half + 1)
    quarters: F4  # (4, 2 k, k)
    nodes: F4  # (c, c)
    side: F4  # (c, w)
    pixels: F4  # (w, w)
    turns: F8  # (axis, cosine and sine, c)


@njit(_nrt=True)
def _product(a: F4, b: F4, out: F4) -> None:
    """Write out = a @ b in pieces too small for threaded BLAS."""
    rows = max(1, _SMALL // (a.shape[1] * b.shape[1]))
    for i in range(0, a.shape[0], rows):
        j = min(i + rows, a.shape[0])
        np.dot(a[i:j], b, out[i:j])


@njit(fastmath=True)
def mask_from_disc(aperture: LensAperture, dx: float, x0: float, y0: float, mask: Split) -> None:
    """Fill a disc times its phase by linear interpolation over r^2; sample (h, h) is at (x0, y0) from the centre."""
    table_re, table_im, re, im = aperture.disc_re, aperture.disc_im, mask.re, mask.im
    n, h = re.shape[0], re.shape[0] // 2
    last, scale = table_re.size - 2, 1.0 / aperture.disc_step
    for i in range(n):
        y = (i - h) * dx + y0
        for j in range(n):
            x = (j - h) * dx + x0
            t = (x * x + y * y) * scale
            k = min(int(t), last)  # the table extends past the corners: this is only for rounding
            w = re.dtype.type(min(t - k, 1.0))
            re[i, j] = table_re[k] + w * (table_re[k + 1] - table_re[k])
            im[i, j] = table_im[k] + w * (table_im[k + 1] - table_im[k])


def fill_disc(aperture: LensAperture, dx: float, x0: float, y0: float, mask: Split) -> None:
    """Fill a disc as `mask_from_disc` does, but with NumPy if compiling that function is not worthwhile."""
    n, h = mask.re.shape[0], mask.re.shape[0] // 2
    if not kernel_spared(__name__, "mask_from_disc", DISC_S * n * n):  # numba replaces kernels that others call
        mask_from_disc(aperture, dx, x0, y0, mask)
        return
    along = (np.arange(n) - h) * dx
    t = ((along + x0) ** 2 + ((along + y0) ** 2)[:, None]) / aperture.disc_step
    k = np.minimum(t.astype(np.int64), aperture.disc_re.size - 2)
    w = np.minimum(t - k, 1.0).astype(mask.re.dtype)
    for table, part in ((aperture.disc_re, mask.re), (aperture.disc_im, mask.im)):
        part[...] = table[k] + w * (table[k + 1] - table[k])


@njit(fastmath=True)
def mask_from_table(aperture: LensAperture, dx: float, x0: float, y0: float, mask: Split) -> None:
    """Fill the lattice's cell by bilinear interpolation in its fine table, times exp(i bend r^2 + i quartic r^4)."""
    table, step, re, im = aperture.cell, aperture.cell_step, mask.re, mask.im
    n, h = re.shape[0], re.shape[0] // 2
    middle = table.shape[0] // 2
    for i in range(n):
        y = (i - h) * dx + y0
        v = min(max(y / step + middle, 0.0), table.shape[0] - 2.0)
        r, b = int(v), v - int(v)
        for j in range(n):
            x = (j - h) * dx + x0
            u = min(max(x / step + middle, 0.0), table.shape[0] - 2.0)
            c = int(u)
            a = u - c
            value = (1 - b) * ((1 - a) * table[r, c] + a * table[r, c + 1]) + b * (
                (1 - a) * table[r + 1, c] + a * table[r + 1, c + 1]
            )
            phase = (x * x + y * y) * (aperture.bend + aperture.quartic * (x * x + y * y))
            re[i, j] = value * math.cos(phase)
            im[i, j] = value * math.sin(phase)


@njit(fastmath={"contract", "nnan", "ninf", "nsz"})
def straighten(mask: Split, dx: float, spot: Any, optics: Optics, bent: Split, line: F4) -> None:
    """Write the mask times a phase with which rays of the Fresnel integral arrive where exact rays do, at B tan.

    A ray leaves the lenslet's point x with sines s = -(c - X0)/a' - kappa x, kappa = 1/a' + 1/f. In the integral, it
    arrives at B times its slope. The phase is therefore -(2 pi/lambda) (G(s^2) - G(s0^2))/kappa, with G(v) = 1 - v/2
    - sqrt(1 - v) and s0 of the chief ray. With 8 G as a series and s^2 - s0^2 = kappa w, w = 2 (c - X0).x/a' + kappa
      x^2, no division by kappa is needed. The chief ray is behind its parabola by 1/cos - 1 - tan^2/2.
    """
    n, real = mask.re.shape[0], mask.re.dtype.type
    ux, uy, rate = spot.lx * optics.source_rate, spot.ly * optics.source_rate, optics.point_rate
    # coefficients of 8 (G(v) - G(v0))/(v - v0) in powers of v; of sine and cosine by Taylor, valid for |t| <= pi/2
    v0, g = ux * ux + uy * uy, optics.glass
    e5 = g[4] * 21 / 128
    e4 = g[3] * 7 / 32 + e5 * v0
    e3 = g[2] * 5 / 16 + e4 * v0
    e2 = g[1] / 2 + e3 * v0
    k0, k1, k2, k3, k4, k5 = real((g[0] + e2 * v0) * v0), real(g[0] + e2 * v0), real(e2), real(e3), real(e4), real(e5)
    s3, s5, s7, s9 = real(-1 / 6), real(1 / 120), real(-1 / 5040), real(1 / 362880)
    c2, c4, c6, c8, one, pi = real(-1 / 2), real(1 / 24), real(-1 / 720), real(1 / 40320), real(1), real(math.pi)
    nearest = real(1.5 * 2.0 ** (23 if mask.re.itemsize == 4 else 52))  # adding and subtracting it rounds to integers
    half = optics.rays / (2 * math.pi)
    behind = g[0] * half * v0 * v0 * (1 / 8 + v0 * (3 / 16 + v0 * (29 / 128 + v0 * (65 / 256))))
    chief, scale = real(behind - math.floor(behind)), half / (8 * optics.gap)
    tilt, excess = line[0], line[1]
    for j in range(n):
        x = (j - n // 2) * dx + spot.x0
        tilt[j], excess[j] = ux + rate * x, scale * x * (2 * ux + rate * x)
    for i in range(n):
        y = (i - n // 2) * dx + spot.y0
        sy, wy = real(uy + rate * y), real(scale * y * (2 * uy + rate * y))
        out_re, out_im, in_re, in_im = bent.re[i], bent.im[i], mask.re[i], mask.im[i]
        for j in range(n):
            v = tilt[j] * tilt[j] + sy * sy
            turns = chief + (excess[j] + wy) * (k0 + v * (k1 + v * (k2 + v * (k3 + v * (k4 + v * k5)))))
            t = (turns - ((turns + nearest) - nearest)) * pi  # half the phase
            u = t * t
            s = t * (one + u * (s3 + u * (s5 + u * (s7 + u * s9))))
            c = one + u * (c2 + u * (c4 + u * (c6 + u * c8)))
            cosine, sine = c * c - s * s, -(s * c + s * c)
            out_re[j] = in_re[j] * cosine - in_im[j] * sine
            out_im[j] = in_re[j] * sine + in_im[j] * cosine


@njit(fastmath=True, inline="always")
def weigh(bent: Split, dx: float, spot: Any, optics: Optics) -> None:
    """Multiply by the pixels' response to each ray's angle, in amplitude: (1 - sin²)^(n/4); rays as in `straighten`."""
    power, from_y, from_x = optics.accept
    for i in range(bent.re.shape[0]):
        sy = spot.ly * optics.source_rate + ((i - bent.re.shape[0] // 2) * dx + spot.y0) * optics.point_rate - from_y
        for j in range(bent.re.shape[0]):
            sx = (
                spot.lx * optics.source_rate + ((j - bent.re.shape[0] // 2) * dx + spot.x0) * optics.point_rate - from_x
            )
            gain = bent.re.dtype.type(max(1.0 - sx * sx - sy * sy, 0.0) ** (power / 4))
            bent.re[i, j], bent.im[i, j] = gain * bent.re[i, j], gain * bent.im[i, j]


@njit(fastmath=True, inline="always")
def _split_row(line: F4, i: int, parts: F4) -> None:
    """Write row i of the four parities from ``line``, the field at rows +i and -i (see `fold`)."""
    h, m = parts.shape[1] - 1, parts.shape[1]
    for j in range(1, m):
        pr, pi = line[0, h + j] + line[0, h - j], line[1, h + j] + line[1, h - j]
        qr, qi = line[2, h + j] + line[2, h - j], line[3, h + j] + line[3, h - j]
        parts[EE, i, j], parts[EE, i, m + j] = pr + qr, pi + qi
        parts[OE, i, j], parts[OE, i, m + j] = pr - qr, pi - qi
        pr, pi = line[0, h + j] - line[0, h - j], line[1, h + j] - line[1, h - j]
        qr, qi = line[2, h + j] - line[2, h - j], line[3, h + j] - line[3, h - j]
        parts[EO, i, j], parts[EO, i, m + j] = pr + qr, pi + qi
        parts[OO, i, j], parts[OO, i, m + j] = pr - qr, pi - qi
    parts[EE, i, 0], parts[EE, i, m] = line[0, h] + line[2, h], line[1, h] + line[3, h]
    parts[OE, i, 0], parts[OE, i, m] = line[0, h] - line[2, h], line[1, h] - line[3, h]
    parts[EO, i, 0] = parts[EO, i, m] = parts[OO, i, 0] = parts[OO, i, m] = 0  # odd parts vanish on the axis


@njit(fastmath=True, inline="always")
def fold(
    field: MainLensField, place: tuple[int, int], mask: Split, turn: tuple[float, float], line: F4, parts: F4
) -> float:
    """Multiply field, aperture and tilt, f_k = E_k m_k exp(i (turn_y k_y + turn_x k_x)), and split f by parity.

    ``place`` is the table's row and column of the sample k = 0, ``turn`` the phase per sample (y, x). With f(+-i,
    +-j) the values at samples mirrored in both axes, ee sums all four, and o subtracts those at negative k; samples
    on an axis count once. Returns the sum of |E m|^2. ``line`` is scratch memory ``(6, 2h+1)``: f at +i and at -i
    (re, im), and the tilt along x.
    """
    field_re, field_im, mask_re, mask_im = field.re, field.im, mask.re, mask.im
    row, col = place
    turn_y, turn_x = turn
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
            part = field_re.dtype.type(0)  # summing a row in its own precision keeps the loop vectorised
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
        if i == 0:  # the axis is its own mirror image
            line[2:4] = 0
        _split_row(line, i, parts)
    return total


@njit(inline="always")
def transform(zoom: Zoom, parts: F4, half: F4, lines: F4, out: F4) -> None:
    """Write the transforms of the four parities at the nodes >= 0: ``out`` (4, 2 k, k), rows re and im alternating.

    out[0] = C ee C^T, out[1] = C eo S^T, out[2] = S oe C^T, out[3] = S oo S^T, with C, S (k, h+1) of cosines and
    sines. ``half`` is scratch (k, 2 (h+1)): after the matrix along y it has re and im side by side. ``lines`` is the
    same memory as (2 k, h+1), so that one product along x handles both.
    """
    cosine, sine, cosine_t, sine_t = zoom.cosine, zoom.sine, zoom.cosine_t, zoom.sine_t
    _product(cosine, parts[EE], half)
    _product(lines, cosine_t, out[0])
    _product(cosine, parts[EO], half)
    _product(lines, sine_t, out[1])
    _product(sine, parts[OE], half)
    _product(lines, cosine_t, out[2])
    _product(sine, parts[OO], half)
    _product(lines, sine_t, out[3])


@njit(fastmath=True, inline="always")
def add_incoherent(scratch: _Scratch, zoom: Zoom, image: F4, top: int, left: int) -> float:
    """Square the field, integrate over pixels, add to the cutout; return the energy of the whole window.

    Field at (+-y, +-x) is (a - s d) - i (s_x b + s_y c) with a, b, c, d the four parities and s = s_x s_y. Its
    square at one node and at the mirrored one differ in the sign of one term only, so both cost one product.
    """
    quarters, nodes, pixels = scratch.quarters, scratch.nodes, scratch.pixels
    k, n = quarters.shape[2], nodes.shape[0]
    up, down = n // 2, (n - 1) // 2  # for an odd number of nodes, the middle one is its own mirror image
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
    _product(nodes, zoom.bins, scratch.side)
    _product(zoom.bins_t, scratch.side, pixels)
    total, w = 0.0, pixels.shape[0]
    for i in range(w):
        for j in range(w):
            total += pixels[i, j]
    for i in range(max(0, -top), min(w, image.shape[0] - top)):
        for j in range(max(0, -left), min(w, image.shape[1] - left)):
            image[top + i, left + j] += pixels[i, j]
    return float(total)


@njit(fastmath=True, inline="always")
def add_coherent(quarters: F4, turns: F8, grid_re: F4, grid_im: F4, top: int, left: int) -> float:
    """Add the field times its phase to the position's node grid; return the sum of its square.

    ``turns`` are ``(axis, 2, n)``, cosines and sines of the phase along y and x; ``top``, ``left`` are in nodes. The
    field at (+-y, +-x) is combined as in `add_incoherent`.
    """
    q, turn_y, turn_x = quarters, turns[0], turns[1]
    k, n = q.shape[2], turns.shape[2]
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
                    re, im = q[0, 2 * i, j], q[0, 2 * i + 1, j]
                    re += sx * q[1, 2 * i + 1, j] + sy * q[2, 2 * i + 1, j] - sx * sy * q[3, 2 * i, j]
                    im -= sx * q[1, 2 * i, j] + sy * q[2, 2 * i, j] + sx * sy * q[3, 2 * i + 1, j]
                    part += re * re + im * im
                    if seen_y and 0 <= left + c < grid_re.shape[1]:
                        xr, xi = quarters.dtype.type(turn_x[0, c]), quarters.dtype.type(turn_x[1, c])
                        tr, ti = xr * yr - xi * yi, xr * yi + xi * yr
                        grid_re[top + r, left + c] += re * tr - im * ti
                        grid_im[top + r, left + c] += re * ti + im * tr
                total += part
    return total


@njit(fastmath=True, inline="always")
def _node_turns(zoom: Zoom, optics: Optics, spot: Any, turns: F8) -> None:
    """Fill the phase of a lenslet's field at the nodes, along y and x, which the transform omits.

    With l = c - X0 and s - X0 = m + node, the two spheres give pi l^2 (1 - B'/a')/L - 2 pi l.(s - X0)/L; the square of
    s - X0 is the same for all lenslets. In addition there is -2 pi x0.(o + node)/L, because the samples start at x0
    and not at the centre.
    """
    rate, nodes = 2 * math.pi * optics.per_spread, zoom.nodes_um
    common = 0.5 * rate * (spot.lx * spot.lx + spot.ly * spot.ly) * optics.sphere
    for j in range(nodes.size):
        node = nodes[j]
        a = common - rate * ((spot.mx + node) * spot.lx + spot.x0 * (node + spot.ox))
        b = -rate * ((spot.my + node) * spot.ly + spot.y0 * (node + spot.oy))
        turns[1, 0, j], turns[1, 1, j] = math.cos(a), math.sin(a)
        turns[0, 0, j], turns[0, 1, j] = math.cos(b), math.sin(b)


def _memory(zoom: Zoom, like: F4) -> _Scratch:
    """Return scratch memory for one lens type, in the precision of ``like``."""
    k, m = zoom.cosine.shape
    n, (count, w), kind = 2 * m - 1, zoom.bins.shape, like.dtype
    masks, turns = np.empty((4, n, n), kind), np.empty((2, 2, count))
    line, parities, half = np.empty((6, n), kind), np.empty((4, m, 2 * m), kind), np.empty((k, 2 * m), kind)
    quarters, nodes = np.empty((4, 2 * k, k), kind), np.empty((count, count), kind)
    side, pixels = np.empty((count, w), kind), np.empty((w, w), kind)
    straight, bent = Split(masks[0], masks[1]), Split(masks[2], masks[3])
    return _Scratch(straight, bent, line, parities, half, half.reshape(2 * k, m), quarters, nodes, side, pixels, turns)


@njit(fastmath=True, _nrt=False)
def _respond(
    field: MainLensField,
    lens: tuple[LensAperture, Zoom],
    optics: Optics,
    spots: Any,
    target: LightTarget,
    scratch: _Scratch,
) -> None:
    """Compute the responses of `respond` in memory allocated by Python: code without allocations compiles faster."""
    aperture, zoom = lens
    # read arrays from their records before the loop: inside, each access would count references
    dx, per, w = field.dx_um, zoom.per_px, zoom.bins.shape[1]
    straight, bent, line, parities = scratch.mask, scratch.bent, scratch.line, scratch.parities
    half, quarters, turns = scratch.half, scratch.quarters, scratch.turns
    image, grid_re, grid_im, boxes = target.image, target.grid_re, target.grid_im, target.boxes
    cell = aperture.cell.shape[0] > 0
    step = -2 * math.pi * optics.per_spread * dx  # phase per sample for a window 1 µm off the phase's centre
    last_x = last_y = 1e300
    for f in range(spots.shape[0]):
        spot = spots[f]
        if abs(spot.x0 - last_x) + abs(spot.y0 - last_y) > 1e-6 * dx:
            if cell:
                mask_from_table(aperture, dx, spot.x0, spot.y0, straight)
            else:
                mask_from_disc(aperture, dx, spot.x0, spot.y0, straight)
            last_x, last_y = spot.x0, spot.y0
        place, turn = (spot.row, spot.col), (step * spot.oy, step * spot.ox)
        if optics.rays != 0 or optics.accept[0] != 0:
            straighten(straight, dx, spot, optics, bent, line)
            if optics.accept[0] != 0:
                weigh(bent, dx, spot, optics)
            seen = bent
        else:
            seen = straight
        spot.energy_in = optics.share * fold(field, place, seen, turn, line, parities)
        transform(zoom, parities, half, scratch.lines, quarters)
        p, top, left = spot.position, spot.top, spot.left
        if grid_re.shape[0] == 0:
            spot.energy_out = add_incoherent(scratch, zoom, image[p], top, left)
            continue
        _node_turns(zoom, optics, spot, turns)
        spot.energy_out = add_coherent(quarters, turns, grid_re[p], grid_im[p], top * per, left * per) / (per * per)
        boxes[p, 0], boxes[p, 1] = min(boxes[p, 0], top), max(boxes[p, 1], top + w)
        boxes[p, 2], boxes[p, 3] = min(boxes[p, 2], left), max(boxes[p, 3], left + w)


def respond(
    field: MainLensField, aperture: LensAperture, zoom: Zoom, optics: Optics, spots: Any, target: LightTarget
) -> None:
    """Add one lenslet's response to the cutouts (incoherent) or node grids (coherent) of the listed positions.

    ``spots`` come from `lfcal.simulate.engines._lenslets.select`. They are sorted by the offset ``x0`` of the field
    sample from the lenslet's centre, because consecutive spots with the same offset share a mask. Their ``energy_in``
    and ``energy_out`` are set.
    """
    _respond(field, (aperture, zoom), optics, spots, target, _memory(zoom, field.re))
