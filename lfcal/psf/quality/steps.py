"""How each pattern follows from its neighbours: seams and odd frames."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

__all__ = ["odd_frames", "seam_ratio"]

NEIGHBOURHOOD = 9


def _pairs(steps: NDArray[np.float64], use: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return ``steps (2, ny, nx)`` with pairs of unused patterns as NaN."""
    both = np.stack([use & np.roll(use, -1, axis) for axis in (0, 1)])
    return np.where(both, steps, np.nan)


def seam_ratio(steps: NDArray[np.float64], use: NDArray[np.bool_]) -> float:
    """Return the change across the wrap over the median change inside the cell, the larger of y and x.

    ``1 - correlation`` grows with the square of a change, so the root of the ratio is taken.

    Parameters
    ----------
    steps
        Change to the next position along y and x, wrapping, ``(2, ny, nx)``.
    use
        Patterns to use ``(ny, nx)``.
    """
    pairs = _pairs(steps, use)
    ratios = []
    for axis in (0, 1):
        if pairs.shape[1 + axis] < 3:
            continue
        inside, wrap = np.split(np.moveaxis(pairs[axis], axis, 0), [-1])
        if np.isfinite(inside).any() and np.isfinite(wrap).any():
            ratios.append(math.sqrt(float(np.nanmedian(wrap)) / max(float(np.nanmedian(inside)), 1e-12)))
    return max(ratios, default=math.nan)


def odd_frames(steps: NDArray[np.float64], use: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return each pattern's median change to its four neighbours over what is usual around it, ``(ny, nx)``."""
    from scipy import ndimage

    pairs = _pairs(steps, use)
    for axis in (0, 1):  # the seam has a metric of its own
        np.moveaxis(pairs[axis], axis, 0)[-1] = np.nan
    four = np.stack([pairs[0], np.roll(pairs[0], 1, 0), pairs[1], np.roll(pairs[1], 1, 1)])
    counted = np.isfinite(four).sum(0)
    change = np.full(use.shape, np.nan)
    change[counted >= 2] = np.nanmedian(four[:, counted >= 2], axis=0)
    usual = float(np.nanmedian(change)) if (counted >= 2).any() else math.nan
    size = tuple(min(NEIGHBOURHOOD, n) for n in use.shape)
    # the lattice's own ripple makes some steps larger than others: compare with the surroundings
    around = ndimage.median_filter(np.where(np.isfinite(change), change, usual), size=size, mode="wrap")
    return change / np.maximum(around, 1e-12)
