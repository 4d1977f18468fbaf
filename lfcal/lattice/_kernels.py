"""Compiled inner loops of the lattice fit: one pass over the pixels of every lenslet."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.compiled import njit

__all__ = ["fold", "lenslet_statistics", "register"]


@njit()
def fold(
    image: NDArray[np.float32],
    centres: NDArray[np.float64],
    scales: NDArray[np.float64],
    radius: float,
    over: int,
    total: NDArray[np.float64],
    count: NDArray[np.float64],
    start: int,
    stop: int,
) -> None:
    """Add the pixels of lenslets ``start … stop`` to the mean micro-image, ``over`` samples per pixel.

    ``centres`` are (x, y); ``scales`` divide each lenslet (0: left out); ``total`` and ``count`` are square
    tables of side ``2 ceil(radius) over + 1`` whose middle is the lenslet's centre.
    """
    rows, columns = image.shape
    middle = total.shape[0] // 2
    for k in range(start, stop):
        if scales[k] <= 0.0:
            continue
        inverse = 1.0 / scales[k]
        cx, cy = centres[k, 0], centres[k, 1]
        for y in range(max(0, math.ceil(cy - radius)), min(rows - 1, math.floor(cy + radius)) + 1):
            j = math.floor((y - cy) * over + 0.5) + middle
            for x in range(max(0, math.ceil(cx - radius)), min(columns - 1, math.floor(cx + radius)) + 1):
                i = math.floor((x - cx) * over + 0.5) + middle
                total[j, i] += image[y, x] * inverse
                count[j, i] += 1.0


@njit()
def register(
    image: NDArray[np.float32],
    centres: NDArray[np.float64],
    template: NDArray[np.float64],
    slopes: NDArray[np.float64],
    radius: float,
    over: int,
    out: NDArray[np.float64],
    start: int,
    stop: int,
) -> None:
    """Fit ``I(p) = g T(p - c - d) + b`` to each lenslet, linear in the shift d (Lucas-Kanade).

    ``template`` is the mean micro-image, ``slopes`` its derivatives ``(2, n, n)`` along x and y per pixel.
    ``out`` takes d_x, d_y, g, b and the share of variance explained; NaN where the system is singular.
    """
    rows, columns = image.shape
    middle = template.shape[0] // 2
    for k in range(start, stop):
        cx, cy = centres[k, 0], centres[k, 1]
        normal = np.zeros((4, 4))
        right = np.zeros(4)
        basis = np.empty(4)
        basis[1] = 1.0
        squares = 0.0
        for y in range(max(0, math.ceil(cy - radius)), min(rows - 1, math.floor(cy + radius)) + 1):
            v = (y - cy) * over + middle
            j = math.floor(v)
            fv = v - j
            reach = radius * radius - (y - cy) ** 2
            for x in range(max(0, math.ceil(cx - radius)), min(columns - 1, math.floor(cx + radius)) + 1):
                if (x - cx) ** 2 > reach:
                    continue
                u = (x - cx) * over + middle
                i = math.floor(u)
                fu = u - i
                w00, w01 = (1 - fv) * (1 - fu), (1 - fv) * fu
                w10, w11 = fv * (1 - fu), fv * fu
                basis[0] = (
                    w00 * template[j, i]
                    + w01 * template[j, i + 1]
                    + w10 * template[j + 1, i]
                    + w11 * template[j + 1, i + 1]
                )
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
        _solve_lenslet(normal, right, squares, out[k])


@njit()
def _solve_lenslet(normal: Any, right: Any, squares: float, out: Any) -> None:
    n = normal[1, 1]
    matrix = normal.copy()
    answer = right.copy()
    # elimination without pivoting: the matrix is symmetric and, where a lenslet can be placed, definite
    for a in range(4):
        if not matrix[a, a] > 1e-9 * (normal[a, a] + 1e-300):
            out[:] = np.nan
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
    fitted = answer[0] * right[0] + answer[1] * right[1] + answer[2] * right[2] + answer[3] * right[3]
    variance = squares - right[1] * right[1] / n
    # a shift by d is -g d times the slope
    out[0] = -answer[2] / gain if gain != 0.0 else np.nan
    out[1] = -answer[3] / gain if gain != 0.0 else np.nan
    out[2] = gain
    out[3] = answer[1]
    out[4] = (fitted - right[1] * right[1] / n) / variance if variance > 0.0 else 0.0


@njit()
def lenslet_statistics(
    image: NDArray[np.float32],
    centres: NDArray[np.float64],
    radius: float,
    out: NDArray[np.float64],
    start: int,
    stop: int,
) -> None:
    """Write the pixel count, the sum, and the gradient energy within ``radius`` of each centre.

    The gradient is the central difference over two pixels; pixels whose neighbours leave the image are left out.
    """
    rows, columns = image.shape
    for k in range(start, stop):
        cx, cy = centres[k, 0], centres[k, 1]
        count, total, energy = 0.0, 0.0, 0.0
        for y in range(max(1, math.ceil(cy - radius)), min(rows - 2, math.floor(cy + radius)) + 1):
            reach = radius * radius - (y - cy) ** 2
            for x in range(max(1, math.ceil(cx - radius)), min(columns - 2, math.floor(cx + radius)) + 1):
                if (x - cx) ** 2 > reach:
                    continue
                dx = 0.5 * (image[y, x + 1] - image[y, x - 1])
                dy = 0.5 * (image[y + 1, x] - image[y - 1, x])
                count += 1.0
                total += image[y, x]
                energy += dx * dx + dy * dy
        out[k, 0] = count
        out[k, 1] = total
        out[k, 2] = energy
