"""Compiled kernel that reduces the noise of recorded patterns."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import njit

__all__ = ["NoiseRule", "reduce_noise"]


class NoiseRule(NamedTuple):
    """Settings of the noise reduction.

    Attributes
    ----------
    reach
        Number of positions on either side whose entries are compared.
    certain
        Standard errors that a mean must exceed; otherwise it is set to zero, because its light cannot be distinguished
        from noise.
    start, stop
        Rows y of positions to process.
    """

    reach: int
    certain: float
    start: int = 0
    stop: int = 0


@njit(_nrt=False)
def reduce_noise(
    plane: NDArray[Any],
    used: NDArray[np.bool_],
    noise: NDArray[np.float64],
    rule: NoiseRule,
    out: NDArray[Any],
    sums: NDArray[np.float64],
) -> None:
    """Write some rows of positions of ``plane`` ``(ny, nx, nt, ns)`` to ``out`` with less noise.

    Each entry is moved towards the mean of the entries of the same sensor pixel at the surrounding positions, as far as
    noise explains their scatter. This is the linear estimate with the least mean square error (Lee 1980).

    ``noise`` ``(ny, nx, 2)`` is the variance without light and per unit of signal; a pattern with NaN is unchanged,
    and not used for others. ``used`` marks entries that are measurements, in the shape of ``plane``; ``(1, 1, 1, 1)``:
    all are. ``sums`` ``(5, nt, ns)`` is scratch memory.
    """
    ny, nx, nt, ns = plane.shape
    some = used.size > 1
    reach, certain = rule.reach, rule.certain
    number, total, square, floor, slope = sums[0], sums[1], sums[2], sums[3], sums[4]
    for y in range(rule.start, rule.stop):
        for x in range(nx):
            known = not np.isnan(noise[y, x, 0])
            for t in range(nt):  # assigning a slice would take seconds to compile
                for s in range(ns):
                    if known:
                        number[t, s] = total[t, s] = square[t, s] = floor[t, s] = slope[t, s] = 0.0
                    else:
                        out[y, x, t, s] = plane[y, x, t, s]
            if not known:
                continue
            for dy in range(-reach, reach + 1):
                for dx in range(-reach, reach + 1):
                    row, column = (y + dy) % ny, (x + dx) % nx
                    if np.isnan(noise[row, column, 0]):
                        continue
                    constant, growth = noise[row, column, 0], noise[row, column, 1]
                    # at a neighbouring position, the same sensor pixel lies as many pixels in the opposite direction
                    # in the cutout
                    for t in range(max(0, dy), min(nt, nt + dy)):
                        for s in range(max(0, dx), min(ns, ns + dx)):
                            if some and not used[row, column, t - dy, s - dx]:
                                continue
                            value = np.float64(plane[row, column, t - dy, s - dx])
                            number[t, s] += 1.0
                            total[t, s] += value
                            square[t, s] += value * value
                            floor[t, s] += constant
                            slope[t, s] += growth
            for t in range(nt):
                for s in range(ns):
                    value, n = np.float64(plane[y, x, t, s]), number[t, s]
                    if n < 4.0 or (some and not used[y, x, t, s]):
                        out[y, x, t, s] = plane[y, x, t, s]
                        continue
                    mean = total[t, s] / n
                    light = max(mean, 0.0)
                    own = noise[y, x, 0] + noise[y, x, 1] * light
                    expected = (floor[t, s] + slope[t, s] * light) / n
                    beyond = max((square[t, s] - n * mean * mean) / (n - 1.0) - expected, 0.0)
                    share = beyond / (beyond + own) if own > 0.0 else 1.0
                    # set means within the noise to zero: cutting off at zero alone would keep half of the noise
                    dark = mean * mean * n < certain * certain * expected or mean < 0.0
                    out[y, x, t, s] = 0.0 if dark else max(mean + share * (value - mean), 0.0)
