"""Compiled loops of the wave engine: which lenslets matter to a source, and their apertures on its samples."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.compiled import njit

__all__ = ["mask_from_disc", "mask_from_table", "select", "straighten"]

F4 = NDArray[Any]
F8 = NDArray[np.float64]
I8 = NDArray[np.int64]


@njit(fastmath=True)
def mask_from_disc(table_re: F4, table_im: F4, step: float, dx: float, x0: float, y0: float, re: F4, im: F4) -> None:
    """Fill the aperture times its phase from a table over r^2; sample (h, h) lies at (x0, y0) from the centre."""
    n = re.shape[0]
    h = n // 2
    last = table_re.size - 2
    scale = 1.0 / step
    for i in range(n):
        y = (i - h) * dx + y0
        for j in range(n):
            x = (j - h) * dx + x0
            t = (x * x + y * y) * scale
            k = min(int(t), last)
            w = re.dtype.type(min(t - k, 1.0))
            re[i, j] = table_re[k] + w * (table_re[k + 1] - table_re[k])
            im[i, j] = table_im[k] + w * (table_im[k + 1] - table_im[k])


@njit(fastmath=True)
def mask_from_table(table: F4, step: float, bend: float, dx: float, x0: float, y0: float, re: F4, im: F4) -> None:
    """Fill the aperture, bilinear in a fine table, times exp(i bend r^2)."""
    n = re.shape[0]
    h = n // 2
    middle = table.shape[0] // 2
    for i in range(n):
        y = (i - h) * dx + y0
        v = min(max(y / step + middle, 0.0), table.shape[0] - 2.0)
        r = int(v)
        b = v - r
        for j in range(n):
            x = (j - h) * dx + x0
            u = min(max(x / step + middle, 0.0), table.shape[0] - 2.0)
            c = int(u)
            a = u - c
            value = (1 - b) * ((1 - a) * table[r, c] + a * table[r, c + 1]) + b * (
                (1 - a) * table[r + 1, c] + a * table[r + 1, c + 1]
            )
            phase = bend * (x * x + y * y)
            re[i, j] = value * math.cos(phase)
            im[i, j] = value * math.sin(phase)


@njit()
def select(
    energy: F4,
    floor: float,
    dx: float,
    half: int,
    centre: F8,
    source: F8,
    pixel: I8,
    optics: F8,
    cutout: I8,
    width: int,
    places: I8,
    numbers: F8,
) -> int:
    """List the positions whose light reaches a lenslet and, behind it, the cutout; return how many.

    Parameters
    ----------
    energy
        What a lenslet at each table sample passes.
    centre
        Lenslet centre (x, y); ``source`` (n, 2) and ``pixel`` (n, 2) as (x, y) and (row, column).
    optics
        pixel pitch, B'/a' of the phase, pull of the window towards the source.
    places
        Out: position, table row and column of the centre sample, window's first row and column in the cutout.
    numbers
        Out: x0, y0 of the centre sample from the lenslet, ox, oy of the window's middle from the phase's centre,
        mx, my of the window's middle from the source.
    """
    n = energy.shape[0]
    px, ratio, pull = optics[0], optics[1], optics[2]
    found = 0
    for p in range(source.shape[0]):
        dx_, dy_ = centre[0] - source[p, 0], centre[1] - source[p, 1]
        kx, ky = round(dx_ / dx), round(dy_ / dx)
        col, row = n // 2 + kx, n // 2 + ky
        if row - half < 0 or row + half >= n or col - half < 0 or col + half >= n:
            continue
        if energy[row, col] < floor:
            continue
        ax, ay = centre[0] - pull * dx_, centre[1] - pull * dy_
        wx, wy = math.floor(ax / px + 0.5), math.floor(ay / px + 0.5)
        left = int(wx) - pixel[p, 1] - width // 2 + cutout[1] // 2
        top = int(wy) - pixel[p, 0] - width // 2 + cutout[0] // 2
        if left + width <= 0 or top + width <= 0 or left >= cutout[1] or top >= cutout[0]:
            continue
        places[found, 0] = p
        places[found, 1] = row
        places[found, 2] = col
        places[found, 3] = top
        places[found, 4] = left
        numbers[found, 0] = kx * dx - dx_
        numbers[found, 1] = ky * dx - dy_
        numbers[found, 2] = wx * px - (centre[0] - ratio * dx_)
        numbers[found, 3] = wy * px - (centre[1] - ratio * dy_)
        numbers[found, 4] = wx * px - source[p, 0]
        numbers[found, 5] = wy * px - source[p, 1]
        found += 1
    return found


@njit(fastmath={"contract", "nnan", "ninf", "nsz"})
def straighten(mask_re: F4, mask_im: F4, dx: float, x0: float, y0: float, away: F8, rays: F8, re: F4, im: F4) -> None:
    """Write the mask times the phase by which exact propagation differs from Fresnel's, ray by ray.

    A ray that leaves the lenslet's point x with sine s = -(c - X0 + x)/a' - x/f is behind its parabola by
    (2 pi B/lambda) (1 - s^2/2 - sqrt(1 - s^2)), here as its series in s^2. ``away`` is c - X0; ``rays`` holds
    2 pi B/lambda, 1/a' and 1/a' + 1/f. Polynomials in one precision throughout let the loop run in vectors.
    """
    n = mask_re.shape[0]
    real = mask_re.dtype.type
    k0, k1, k2, k3, k4 = real(1), real(1 / 2), real(5 / 16), real(7 / 32), real(21 / 128)
    s3, s5, s7, s9 = real(-1 / 6), real(1 / 120), real(-1 / 5040), real(1 / 362880)
    c2, c4, c6, c8 = real(-1 / 2), real(1 / 24), real(-1 / 720), real(1 / 40320)
    one, pi = real(1), real(math.pi)
    # adding and taking away 1.5 times 2 to the digits of the mantissa rounds to whole numbers
    nearest = real(1.5 * 2.0 ** (23 if mask_re.itemsize == 4 else 52))
    gap = real(rays[0] / (16 * math.pi))
    tilt = np.empty(n, mask_re.dtype)
    for j in range(n):
        tilt[j] = away[0] * rays[1] + ((j - n // 2) * dx + x0) * rays[2]
    for i in range(n):
        sy = real(away[1] * rays[1] + ((i - n // 2) * dx + y0) * rays[2])
        out_re, out_im, in_re, in_im = re[i], im[i], mask_re[i], mask_im[i]
        for j in range(n):
            v = tilt[j] * tilt[j] + sy * sy
            turns = gap * v * v * (k0 + v * (k1 + v * (k2 + v * (k3 + v * k4))))
            t = (turns - ((turns + nearest) - nearest)) * pi  # half the phase
            u = t * t
            s = t * (one + u * (s3 + u * (s5 + u * (s7 + u * s9))))
            c = one + u * (c2 + u * (c4 + u * (c6 + u * c8)))
            cosine, sine = c * c - s * s, -(s * c + s * c)
            out_re[j] = in_re[j] * cosine - in_im[j] * sine
            out_im[j] = in_re[j] * sine + in_im[j] * cosine
