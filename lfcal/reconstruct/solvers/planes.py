"""Process the planes of a volume in threads, and filter them with OpenCV, which is faster than scipy."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import free_memory, worker_count

__all__ = ["UPDATING", "box_mean", "plane_threads", "separable"]

UPDATING = 4
"""Number of images in memory while a plane is changed."""

LEAST = 1 << 21
"""Size of a plane (bytes) below which threads are not faster."""

SHARE = 0.1
"""Fraction of the free memory for planes that are processed together."""


def plane_threads(planes: int, plane_bytes: int) -> int:
    """Return how many of ``planes`` planes, each of ``plane_bytes`` bytes, to process together.

    It is 1 for planes below `LEAST`, else one per thread if memory allows.
    """
    if plane_bytes < LEAST:
        return 1
    room = int(SHARE * free_memory()) // max(1, UPDATING * plane_bytes)
    return max(1, min(worker_count(), planes, room))


def box_mean(plane: NDArray[Any], window: tuple[int, int]) -> NDArray[Any]:
    """Return the mean of ``plane`` ``(Y, X)`` in a window (rows, columns) about each pixel.

    Beyond the border, the plane is extended by its border values. A window of even size extends one pixel further up
    and to the left than down and to the right.
    """
    from lfcal.base import cv2  # slow to import

    found: NDArray[Any] = cv2.blur(plane, (window[1], window[0]), borderType=cv2.BORDER_REPLICATE)
    return found.reshape(plane.shape)


def separable(plane: NDArray[Any], kernel: NDArray[np.float64]) -> NDArray[Any]:
    """Return ``plane`` ``(Y, X)`` filtered along both axes with a symmetric ``kernel`` of odd length.

    Values beyond the border are 0.
    """
    from lfcal.base import cv2

    found: NDArray[Any] = cv2.sepFilter2D(plane, -1, kernel, kernel, borderType=cv2.BORDER_CONSTANT)
    return found.reshape(plane.shape)
