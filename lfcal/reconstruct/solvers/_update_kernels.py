"""Compiled passes over a plane of a volume, which read every voxel once."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import njit

__all__ = ["squares_of", "update_factors"]


@njit(fastmath={"reassoc", "contract"})
def squares_of(new: NDArray[Any], old: NDArray[Any]) -> tuple[float, float]:
    """Return the sums of squares of a plane ``(Y, X)`` and of its difference from another one, in double precision."""
    size, change = 0.0, 0.0
    for y in range(new.shape[0]):
        for x in range(new.shape[1]):
            value, off = np.float64(new[y, x]), np.float64(new[y, x] - old[y, x])
            size += value * value
            change += off * off
    return size, change


@njit()
def update_factors(
    above: NDArray[Any], share: NDArray[Any], sensitivity: NDArray[Any], least: float, out: NDArray[Any]
) -> None:
    """Write the factors ``above / share`` of a plane to ``out`` ``(Y, X)``, at least 0.

    The factor is 1 at voxels whose sensitivity is not above ``least``, or whose share is not positive.
    """
    one, zero = out.dtype.type(1), out.dtype.type(0)
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            seen = sensitivity[y, x] > least and share[y, x] > 0
            out[y, x] = max(above[y, x], zero) / share[y, x] if seen else one
