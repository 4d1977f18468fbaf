"""Compiled loop that adds the light of lenslets beyond their windows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import njit

__all__ = ["add_tails"]

F4 = NDArray[Any]


@njit(fastmath=True)
def add_tails(spots: Any, lacking: NDArray[np.float64], pattern: F4, beyond: int, image: F4) -> None:
    """Add to each cutout the light that the windows of spots do not contain, distributed as ``pattern``.

    Parameters
    ----------
    spots
        `lfcal.simulate.engines._lenslets.SPOT` array ``(n,)``.
    lacking
        Light outside each window ``(n,)``.
    pattern
        ``(m, m)`` pixels about the spot, 0 inside its window: fractions of the light outside it.
    beyond
        Distance by which the pattern extends beyond the window on each side (pixels).
    image
        Cutouts ``(positions, rows, columns)``; changed.
    """
    m = pattern.shape[0]
    for f in range(spots.shape[0]):
        spot = spots[f]
        light = image.dtype.type(lacking[f])
        p, top, left = spot.position, spot.top - beyond, spot.left - beyond
        first, last = max(0, -left), min(m, image.shape[2] - left)
        for i in range(max(0, -top), min(m, image.shape[1] - top)):
            # slices, because an index that might be negative prevents vectorisation
            onto, share = image[p, top + i, left + first : left + last], pattern[i, first:last]
            for j in range(last - first):
                onto[j] += light * share[j]
