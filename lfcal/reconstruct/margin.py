"""Add a margin around the frame, because sources outside it also illuminate the frame.

A volume that ends at the border of the frame must explain all light with sources inside the frame, so its edges become
too bright. With a margin, the volume extends beyond the frame. The added pixels have weight 0, and the margin is
cropped from the result.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError

__all__ = ["cropped", "usual_margin", "widened", "widened_start"]


def usual_margin(period: tuple[int, int], cutout: tuple[int, int], shape: tuple[int, int]) -> int:
    """Return the default margin (pixels) for an H with this ``period`` ``(ny, nx)`` and ``cutout`` ``(nt, ns)``.

    The margin is two periods, which include most of the light that reaches the frame from outside. The edges of the
    volume then have the correct brightness; without a margin, they are 1.3 times as bright. The margin is limited to
    half the cutout and to an eighth of the longer side of the frame ``shape`` ``(rows, columns)``. A margin of an
    eighth increases the computing time by half.
    """
    return max(0, min(2 * max(period), (max(cutout) - 1) // 2, max(shape) // 8))


def widened(array: ArrayLike, margin: int, fill: float = 0.0) -> NDArray[Any]:
    """Return an image or its weights ``(Y, X)``, extended by ``margin`` pixels of value ``fill`` on every side."""
    return np.pad(np.asarray(array), margin, constant_values=fill)


def widened_start(volume: ArrayLike, margin: int, wanted: tuple[int, int, int]) -> NDArray[Any]:
    """Return an initial volume of shape ``wanted`` ``(nz, Y, X)``, which includes a margin of ``margin`` voxels.

    If ``volume`` has no margin, border values are repeated to fill it.

    Raises
    ------
    InputError
        If the volume has neither this shape nor that without the margin.
    """
    start = np.asarray(volume)
    if start.shape == wanted:
        return start
    narrow = (wanted[0], wanted[1] - 2 * margin, wanted[2] - 2 * margin)
    if start.shape != narrow:
        raise InputError.expected(
            "initial volume", f"shape {wanted} or {narrow}", start.shape, "give a volume of one of these shapes"
        )
    return np.pad(start, ((0, 0), (margin, margin), (margin, margin)), mode="edge")


def cropped(volume: NDArray[Any], margin: int) -> NDArray[Any]:
    """Return a copy of a volume ``(nz, Y, X)`` without ``margin`` voxels on each side in Y and X."""
    rows, columns = volume.shape[1:]
    return volume[:, margin : rows - margin, margin : columns - margin].copy()
