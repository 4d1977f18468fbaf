"""Compiled inner loop of the search for offsets: squares of cells are counted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.base import njit

__all__ = ["add_squares"]


@njit()
def add_squares(counts: NDArray[np.int32], corners: NDArray[np.int32], side: int, weight: int) -> None:
    """Add ``weight`` to squares of ``side`` cells of ``counts``, whose first cells are ``corners`` (n, 2); -1: none."""
    for k in range(corners.shape[0]):
        row, column = corners[k, 0], corners[k, 1]
        if row < 0:
            continue
        for i in range(side):
            for j in range(side):
                counts[row + i, column + j] += weight
