"""Compiled inner loops of the lattice fit: one pass over the pixels of every lenslet."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import njit

__all__ = ["Support", "Template", "WhiteLenslets", "fold", "lenslet_statistics", "register"]


class Support(NamedTuple):
    """Pixels about a lenslet: an ellipse ``xx x² + 2 xy x y + yy y² <= 1`` about its centre."""

    xx: float
    xy: float
    yy: float

    @property
    def radius(self) -> float:
        """Largest distance from the centre (pixels)."""
        half, apart = (self.xx + self.yy) / 2, math.hypot((self.xx - self.yy) / 2, self.xy)
        return 1 / math.sqrt(half - apart)

    @classmethod
    def along(cls, direction: NDArray[np.float64], length: float, width: float) -> Support:
        """Return the ellipse with half axes ``length`` along ``direction`` (x, y) and ``width`` across."""
        x, y = (direction / np.hypot(*direction)).tolist()
        one, two = length**-2, width**-2
        return cls(one * x * x + two * y * y, (one - two) * x * y, one * y * y + two * x * x)


class WhiteLenslets(NamedTuple):
    """The lenslets of a white image, and the region of pixels about each."""

    centres: NDArray[np.float64]  # (n, 2) as (x, y) (pixels)
    radius: float  # pixels; that of the support, if there is one
    per_px: int  # samples per pixel of the tables about a centre


class Template(NamedTuple):
    """Table of the mean micro-image, with the lenslet's centre in the middle."""

    values: NDArray[np.float64]  # (side, side), rows along y
    slopes: NDArray[np.float64]  # (2, side, side): derivatives along x and y per pixel
    support: Support
    memory: NDArray[np.float64]  # (8, 4): scratch memory of a thread, because code without allocations compiles faster


@njit(_nrt=False)
def fold(
    image: NDArray[np.float32],
    lenslets: WhiteLenslets,
    scales: NDArray[np.float64],
    sums: NDArray[np.float64],
    start: int,
    stop: int,
) -> None:
    """Add the pixels of lenslets ``start … stop`` to the mean micro-image; each is shared among four samples.

    ``scales`` ``(n,)`` divide each lenslet (0: left out). ``sums`` ``(2, side, side)`` receives values and counts, with
    side = 2 ceil(radius) per_px + 1. The centres have various fractions of a pixel, so that many lenslets together
    sample a micro-image more finely than one does. If the pitch is an integer number of pixels, all centres have the
    same fraction. Adding to only the nearest sample would then shift the mean by up to half a sample.
    """
    total, count = sums[0], sums[1]
    centres, radius, over = lenslets.centres, lenslets.radius, lenslets.per_px
    rows, columns = image.shape
    middle, last = total.shape[0] // 2, total.shape[0] - 2
    for k in range(start, stop):
        if scales[k] <= 0.0:
            continue
        inverse = 1.0 / scales[k]
        cx, cy = centres[k, 0], centres[k, 1]
        for y in range(max(0, math.ceil(cy - radius)), min(rows - 1, math.floor(cy + radius)) + 1):
            v = (y - cy) * over + middle
            j = min(math.floor(v), last)
            fv = v - j
            for x in range(max(0, math.ceil(cx - radius)), min(columns - 1, math.floor(cx + radius)) + 1):
                u = (x - cx) * over + middle
                i = min(math.floor(u), last)
                fu = u - i
                value = image[y, x] * inverse
                for b, down in ((j, 1.0 - fv), (j + 1, fv)):
                    for a, share in ((i, down * (1.0 - fu)), (i + 1, down * fu)):
                        total[b, a] += share * value
                        count[b, a] += share


SHIFT_X, SHIFT_Y, GAIN, LEVEL, EXPLAINED = range(5)
"""Columns that `register` fills: shift d (pixels), gain g, level b, and the fraction of variance explained."""


@njit(_nrt=False)
def register(
    image: NDArray[np.float32],
    lenslets: WhiteLenslets,
    template: Template,
    out: NDArray[np.float64],
    start: int,
    stop: int,
) -> None:
    """Fit ``I(p) = g T(p - c - d) + b`` to each lenslet, linearised in the shift d (Lucas and Kanade 1981).

    To first order, I = g T - g d.grad T + b. The unknowns g, b, -g d_x, -g d_y are linear. Their normal equations
    ``(4, 4)`` are summed over the pixels within the support. ``out`` ``(n, 5)`` receives `SHIFT_X` and so on; NaN if
    the system is singular.
    """
    centres, radius, over = lenslets.centres, lenslets.radius, lenslets.per_px
    table, slopes, support = template.values, template.slopes, template.support
    normal, right, basis = template.memory, template.memory[4], template.memory[5]
    rows, columns = image.shape
    middle = table.shape[0] // 2
    for k in range(start, stop):
        cx, cy = centres[k, 0], centres[k, 1]
        for a in range(8):
            for b in range(4):
                normal[a, b] = 0.0
        basis[1] = 1.0  # order of the unknowns: g, b, -g d_x, -g d_y
        squares = 0.0
        for y in range(max(0, math.ceil(cy - radius)), min(rows - 1, math.floor(cy + radius)) + 1):
            v = (y - cy) * over + middle
            j = math.floor(v)
            fv = v - j
            across, both = support.yy * ((y - cy) * (y - cy)), 2 * support.xy * (y - cy)
            for x in range(max(0, math.ceil(cx - radius)), min(columns - 1, math.floor(cx + radius)) + 1):
                if (support.xx * (x - cx) + both) * (x - cx) + across > 1.0:
                    continue
                u = (x - cx) * over + middle
                i = math.floor(u)
                fu = u - i  # bilinear interpolation in the table
                w00, w01 = (1 - fv) * (1 - fu), (1 - fv) * fu
                w10, w11 = fv * (1 - fu), fv * fu
                basis[0] = w00 * table[j, i] + w01 * table[j, i + 1] + w10 * table[j + 1, i] + w11 * table[j + 1, i + 1]
                for axis in range(2):
                    s = slopes[axis]
                    basis[2 + axis] = w00 * s[j, i] + w01 * s[j, i + 1] + w10 * s[j + 1, i] + w11 * s[j + 1, i + 1]
                value = image[y, x]
                squares += value * value
                for a in range(4):
                    right[a] += basis[a] * value
                    for b in range(a, 4):
                        normal[a, b] += basis[a] * basis[b]
        for a in range(4):
            for b in range(a):
                normal[a, b] = normal[b, a]
        _solve_lenslet(normal, squares, out[k])


@njit(inline="always")
def _solve_lenslet(matrix: Any, squares: float, out: Any) -> None:
    """Solve the normal equations of a lenslet in the memory of a `Template`.

    ``squares`` is the sum of the lenslet's squared values, ``out`` one row.
    """
    n, right, answer, diagonal = matrix[1, 1], matrix[4], matrix[6], matrix[7]
    for a in range(4):
        answer[a], diagonal[a] = right[a], matrix[a, a]
    # elimination without pivoting: the matrix is symmetric and, for lenslets that can be located, definite
    for a in range(4):
        if not matrix[a, a] > 1e-9 * (diagonal[a] + 1e-300):
            for column in range(5):
                out[column] = np.nan
            return
        for b in range(a + 1, 4):
            factor = matrix[b, a] / matrix[a, a]
            for c in range(a, 4):
                matrix[b, c] -= factor * matrix[a, c]
            answer[b] -= factor * answer[a]
    for a in range(3, -1, -1):
        for b in range(a + 1, 4):
            answer[a] -= matrix[a, b] * answer[b]
        answer[a] /= matrix[a, a]
    gain = answer[0]
    # the explained sum of squares of a least-squares fit is answer . right; subtract the mean from both
    fitted = answer[0] * right[0] + answer[1] * right[1] + answer[2] * right[2] + answer[3] * right[3]
    variance = squares - right[1] * right[1] / n
    # a shift by d is -g d times the slope
    out[SHIFT_X] = -answer[2] / gain if gain != 0.0 else np.nan
    out[SHIFT_Y] = -answer[3] / gain if gain != 0.0 else np.nan
    out[GAIN] = gain
    out[LEVEL] = answer[1]
    out[EXPLAINED] = (fitted - right[1] * right[1] / n) / variance if variance > 0.0 else 0.0


@njit(_nrt=False)
def lenslet_statistics(
    image: NDArray[np.float32],
    centres: NDArray[np.float64],
    radius: float,
    out: NDArray[np.float64],
    start: int,
    stop: int,
) -> None:
    """Write pixel count, sum, and gradient energy sum |grad I|^2 within ``radius`` of each centre.

    ``centres`` ``(n, 2)`` are (x, y) (pixels), ``out`` is ``(n, 3)``. The energy distinguishes lens types by sharpness.
    The gradient is the central difference over two pixels; pixels whose neighbours leave the image are left out.
    """
    rows, columns = image.shape
    for k in range(start, stop):
        cx, cy = centres[k, 0], centres[k, 1]
        count, total, energy = 0.0, 0.0, 0.0
        for y in range(max(1, math.ceil(cy - radius)), min(rows - 2, math.floor(cy + radius)) + 1):
            reach = radius * radius - (y - cy) * (y - cy)
            for x in range(max(1, math.ceil(cx - radius)), min(columns - 2, math.floor(cx + radius)) + 1):
                if (x - cx) * (x - cx) > reach:
                    continue
                dx = 0.5 * (image[y, x + 1] - image[y, x - 1])
                dy = 0.5 * (image[y + 1, x] - image[y - 1, x])
                count += 1.0
                total += image[y, x]
                energy += dx * dx + dy * dy
        out[k, 0] = count
        out[k, 1] = total
        out[k, 2] = energy
