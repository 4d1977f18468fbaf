"""What neighbouring lenslets depart from their lattice together."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

__all__ = ["best_places", "gridded"]

Array = NDArray[np.float64]
REACH = 3
"""Neighbours that are averaged, in lattice indices to each side."""

SPREAD = 1.5
"""Standard deviation of their weights, in lattice indices."""


def best_places(index: NDArray[np.intp], lattice: Array, measured: Array) -> Array:
    """Return best estimates ``(n, 2)`` of the lenslets' places.

    The lattice's place, and of the weighted mean of what the neighbours depart from it the share that they have in
    common: scatter alone would have it at sum(w²)/sum(w)² of a single one's variance (James and Stein 1961).

    Parameters
    ----------
    index
        ``(n, 2)``: lattice indices (q, r).
    lattice
        ``(n, 2)``: places by the lattice (pixels).
    measured
        ``(n, 2)``: places measured; NaN where there is none.
    """
    residual = measured - lattice
    known: NDArray[np.bool_] = np.asarray(np.isfinite(residual).all(1))
    if known.sum() < 3 * (2 * REACH + 1) ** 2:
        return lattice
    # one wild lenslet is no common displacement
    distance = np.hypot(*residual[known].T)
    limit = 4 * float(np.median(distance)) / 1.1774
    held = known.copy()
    held[known] = distance <= limit
    mean, noise = _means(index, np.where(held[:, None], residual, 0.0), held)
    single = float((residual[held] ** 2).mean())
    common = float((mean[held] ** 2).mean())
    scatter = single * float(noise[held].mean())
    share = max(0.0, 1 - scatter / common) if common > 0 else 0.0
    result: Array = lattice + share * mean
    return result


def _means(index: NDArray[np.intp], values: Array, held: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return weighted means ``(n, 2)`` over the neighbours, the lenslet itself left out, and their noise factors."""
    from scipy import ndimage

    place = index - index.min(0)
    shape = tuple(place.max(0) + 1)
    steps = np.arange(-REACH, REACH + 1)
    line = np.exp(-0.5 * (steps / SPREAD) ** 2)
    kernel = line[:, None] * line
    kernel[REACH, REACH] = 0.0
    grids = np.zeros((3, *shape))
    grids[:, place[:, 0], place[:, 1]] = *values.T, held
    total = [ndimage.correlate(g, kernel, mode="constant")[place[:, 0], place[:, 1]] for g in grids]
    squares = ndimage.correlate(grids[2], kernel**2, mode="constant")[place[:, 0], place[:, 1]]
    count = np.maximum(total[2], 1e-12)
    enough = total[2] > 0.2 * kernel.sum()
    means = np.where(enough[:, None], np.stack(total[:2], axis=-1) / count[:, None], 0.0)
    return means, np.where(enough, squares / count**2, 0.0)


def gridded(places: Array, values: Array, shape: tuple[int, int], size: int) -> Array:
    """Return the mean of ``values`` ``(n, 2)`` in the cells of a grid, ``(2, rows, columns)``; NaN where there is none.

    ``size`` cells along the longer side of a frame of ``shape``; ``places`` are (row, column), NaN left out.
    """
    known = np.isfinite(places).all(1) & np.isfinite(values).all(1)
    cell = max(shape) / size
    counts = tuple(max(1, math.ceil(n / cell)) for n in shape)
    row, column = np.clip((places[known] / cell).astype(np.intp), 0, np.array(counts) - 1).T
    number = np.bincount(row * counts[1] + column, minlength=counts[0] * counts[1]).astype(float)
    sums = [np.bincount(row * counts[1] + column, weights=v, minlength=counts[0] * counts[1]) for v in values[known].T]
    with np.errstate(invalid="ignore"):
        means: Array = np.stack([s / np.where(number > 0, number, np.nan) for s in sums]).reshape(2, *counts)
    return means
