"""Select the image phases of each update: ordered subsets and views."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.reconstruct.projectors import Grid

__all__ = ["angular_subsets", "by_energy", "interleaved_subsets"]

Masks = tuple[NDArray[np.bool_], ...]


def interleaved_subsets(period: tuple[int, int], count: int) -> Masks:
    """Return ``count`` masks ``(ny, nx)`` that split the image phases evenly and finely (Hudson & Larkin 1994).

    Long periods are split by rows, which the direct method can skip; others by rows and columns.

    Raises
    ------
    InputError
        If there are fewer phases than subsets.
    """
    ny, nx = period
    _check_count(count, ny * nx)
    # a step near the golden ratio of the count keeps pixels of one subset far apart in both directions.
    step = next(k for k in range(max(1, round(count * 0.618)), 2 * count + 2) if math.gcd(k, count) == 1)
    y, x = np.mgrid[:ny, :nx]
    label = y % count if ny >= 4 * count else (x + step * y) % count
    if len(np.unique(label)) < count:
        label = np.arange(ny * nx).reshape(ny, nx) % count
    return tuple(label == k for k in range(count))


def angular_subsets(
    period: tuple[int, int], views: tuple[int, int] = (3, 3), lenslet_centre: tuple[float, float] = (0.0, 0.0)
) -> Masks:
    """Return masks ``(ny, nx)`` of neighbouring views: blocks of pixels under the lenslet, centre block first.

    Parameters
    ----------
    period
        Period ``(ny, nx)`` with one lenslet, so that the position of a pixel in it corresponds to a direction of view.
    views
        Number of blocks down and across.
    lenslet_centre
        Phase (row, column) of the lenslet's centre.
    """
    label = np.zeros(period, np.intp)
    distance = np.zeros(views)
    for axis in (0, 1):
        n, blocks = period[axis], views[axis]
        _check_count(blocks, n)
        offset = np.mod(np.arange(n) - lenslet_centre[axis] + n / 2, n)  # 0 … n, the lenslet's centre at n/2
        index = np.minimum((offset * blocks / n).astype(np.intp), blocks - 1)
        shape = (-1, 1) if axis == 0 else (1, -1)
        label = label * blocks + index.reshape(shape)
        distance = np.hypot(distance, (np.arange(blocks) - (blocks - 1) / 2).reshape(shape))
    order = np.argsort(distance.ravel(), kind="stable")
    return tuple(label == k for k in order if (label == k).any())


def by_energy(masks: Masks, image: NDArray[Any], grid: Grid) -> Masks:
    """Return ``masks`` sorted by their light in ``image``, the brightest first (the order of Lu et al. 2019)."""
    energy = [float(image[grid.tiled(mask)].sum()) for mask in masks]
    return tuple(masks[k] for k in np.argsort(energy, kind="stable")[::-1])


def check_partition(masks: Masks, period: tuple[int, int]) -> None:
    """Raise `InputError` unless every image phase is in exactly one of ``masks``."""
    count = np.zeros(period, np.intp)
    for mask in masks:
        if np.shape(mask) != period:
            raise InputError.expected(
                "subset", f"a mask of shape {period}", np.shape(mask), "make the masks for this projector"
            )
        count += mask
    if not (count == 1).all():
        raise InputError.expected(
            "subsets",
            "each image phase exactly once",
            f"{count.min()} to {count.max()} times",
            "assign each phase to one subset",
        )


def _check_count(count: int, limit: int) -> None:
    if not 1 <= count <= limit:
        raise InputError.expected("number of subsets", f"1 to {limit}", count, "choose a number in this range")
