"""Change of each pattern from its neighbours: seams and unusual frames."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

__all__ = ["odd_frames", "seam_ratio", "unlike_displaced"]

NEIGHBOURHOOD = 9


def _pairs(steps: NDArray[np.float64], use: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return ``steps (2, ny, nx)`` with NaN for pairs that contain an unused pattern."""
    both = np.stack([use & np.roll(use, -1, axis) for axis in (0, 1)])
    return np.where(both, steps, np.nan)


def unlike_displaced(frames: NDArray[np.float32], by: NDArray[np.float64]) -> float:
    """Return the median of the root of 1 minus the correlation between patterns and their displaced copies.

    Parameters
    ----------
    frames
        Patterns ``(n, nt, ns)``.
    by
        Displacement as (rows, columns) (pixels).
    """
    from scipy.ndimage import fourier_shift

    if not frames.any() or not np.any(np.abs(by) > 1e-6):
        return 0.0
    frames = np.where(np.isfinite(frames), frames, 0).astype(np.float64)
    moved = np.fft.ifft2([fourier_shift(np.fft.fft2(one), by) for one in frames]).real
    alike = (frames * moved).sum((1, 2)) / np.maximum(np.square(frames).sum((1, 2)), 1e-300)
    return math.sqrt(max(0.0, 1 - float(np.median(alike[frames.any((1, 2))]))))


def seam_ratio(steps: NDArray[np.float64], use: NDArray[np.bool_], slip: NDArray[np.float64] | None = None) -> float:
    """Return the ratio of the change across the wrap to the expected one, the larger of y and x.

    The expected change is the median inside the cell plus the contribution of a known displacement. ``1 -
    correlation`` grows with the square of a change, so the root of the ratio is used.

    Parameters
    ----------
    steps
        Change to the next position along y and x, wrapping, ``(2, ny, nx)``.
    use
        Patterns to use ``(ny, nx)``.
    slip
        For each axis, the change due to the displacement (root of 1 minus the correlation), and the additional motion
        of the source in steps ``(2, 2)``. None: nothing.
    """
    pairs = _pairs(steps, use)
    slip = np.zeros((2, 2)) if slip is None else slip
    ratios = []
    for axis in (0, 1):
        if pairs.shape[1 + axis] < 3:
            continue
        inside, wrap = np.split(np.moveaxis(pairs[axis], axis, 0), [-1])
        if np.isfinite(inside).any() and np.isfinite(wrap).any():
            step = math.sqrt(max(float(np.nanmedian(inside)), 1e-12))
            ratios.append(math.sqrt(float(np.nanmedian(wrap))) / (step * (1 + slip[axis, 1]) + slip[axis, 0]))
    return max(ratios, default=math.nan)


def odd_frames(steps: NDArray[np.float64], use: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return each pattern's median change to its neighbours, relative to the typical change, ``(ny, nx)``."""
    from scipy import ndimage

    pairs = _pairs(steps, use)
    for axis in (0, 1):  # the seam has a separate metric
        np.moveaxis(pairs[axis], axis, 0)[-1] = np.nan
    four = np.stack([pairs[0], np.roll(pairs[0], 1, 0), pairs[1], np.roll(pairs[1], 1, 1)])
    counted = np.isfinite(four).sum(0)
    change = np.full(use.shape, np.nan)
    change[counted >= 2] = np.nanmedian(four[:, counted >= 2], axis=0)
    usual = float(np.nanmedian(change)) if (counted >= 2).any() else math.nan
    size = tuple(min(NEIGHBOURHOOD, n) for n in use.shape)
    # ripple of the lattice makes some steps larger than others, so compare with the surroundings
    around = ndimage.median_filter(np.where(np.isfinite(change), change, usual), size=size, mode="wrap")
    return change / np.maximum(around, 1e-12)
