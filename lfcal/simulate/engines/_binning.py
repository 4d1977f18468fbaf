"""Integrate a sampled field over pixels, by a compiled loop or by numpy."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import njit

__all__ = ["bin_light", "bin_light_by_numpy"]


def bin_light_by_numpy(
    field: NDArray[Any], weights: NDArray[Any], per: int, top: int, left: int, out: NDArray[Any]
) -> None:
    """Compute the results of `bin_light` with NumPy, without compiled code."""
    part = field[top:, left:]
    power = part.real * part.real + part.imag * part.imag
    (rows, columns), taps = out.shape, range(weights.size)
    lines = sum(weights[i] * power[i : i + (rows - 1) * per + 1 : per] for i in taps)
    out[...] = sum(weights[j] * lines[:, j : j + (columns - 1) * per + 1 : per] for j in taps)


@njit(fastmath=True)
def bin_light(field: NDArray[Any], weights: NDArray[Any], per: int, top: int, left: int, out: NDArray[Any]) -> None:
    """Write the light of a complex field on pixels: sum_ij w_i w_j |V|^2 over the samples of each pixel.

    Pixel (t, s) uses the samples ``top + per t ...`` and ``left + per s ...``, one for each weight; neighbours share
    some samples. Columns are summed first, because neighbouring pixels of a row share these sums.
    """
    taps, last = weights.size, left + (out.shape[1] - 1) * per + weights.size
    line = np.empty(field.shape[1], weights.dtype)
    for t in range(out.shape[0]):
        line[left:last] = 0
        for i in range(taps):
            row, weight = field[top + t * per + i], weights[i]
            for j in range(left, last):
                line[j] += weight * (row[j].real * row[j].real + row[j].imag * row[j].imag)
        for s in range(out.shape[1]):
            total = weights.dtype.type(0)
            for j in range(taps):
                total += weights[j] * line[left + s * per + j]
            out[t, s] = total
