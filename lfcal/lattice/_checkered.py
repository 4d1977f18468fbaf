"""Whether the cells of a square lattice are those of a checkerboard, which has no gaps between micro-images."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.lattice._model import LatticeModel

__all__ = ["check_cell", "mean_cell"]

Array = NDArray[np.float64]

SIDE = 12
"""Samples along each side of a cell; even, so that half a cell is a whole number of them."""

LENSLETS = 400

INVERSE = -0.99
"""Correlation of a cell with itself half a diagonal away from which light and dark only change places. Measured:
checkerboards -0.999 and below; sharp micro-images that fill 50 % to 100 % of the pitch -0.36 to -0.86."""

BETWEEN = 0.35
"""Share of the cell between a quarter and three quarters of its contrast up to which its edges are sharp: blurred ones,
0.42 and above where micro-images are not resolved, look alike whatever they are of."""


def mean_cell(image: NDArray[np.float32], model: LatticeModel, index: NDArray[np.intp]) -> Array:
    """Return the mean brightness over one cell ``(SIDE, SIDE)``, from the lenslets (q, r) of ``index``."""
    from scipy.ndimage import map_coordinates

    chosen = index[:: max(1, len(index) // LENSLETS)]
    part = np.arange(SIDE) / SIDE
    basis = model.basis()
    offsets = (part[:, None, None] * basis[0] + part[None, :, None] * basis[1]).reshape(-1, 1, 2)
    points = (model.places(chosen) + offsets)[..., ::-1]
    values = map_coordinates(image, points.reshape(-1, 2).T, order=1, mode="nearest")
    mean: Array = values.reshape(SIDE, SIDE, -1).mean(-1, dtype=np.float64)
    return mean


def check_cell(cell: Array) -> None:
    """Raise `InputError` where the mean cell is that of a checkerboard.

    Its light and dark fields have one shape: half a diagonal away each is the negative of the other. Micro-images and
    the gaps between them have two.
    """
    contrast = float(np.ptp(cell))
    if contrast <= 0:
        return
    level = (cell - cell.min()) / contrast
    between = float(((level > 0.25) & (level < 0.75)).mean())
    turned = np.roll(level, (SIDE // 2, SIDE // 2), (0, 1))
    alike = float(np.corrcoef(level.ravel(), turned.ravel())[0, 1])
    if alike < INVERSE and between < BETWEEN:
        raise InputError.expected(
            "white image",
            "micro-images with gaps of another shape between them",
            "light and dark fields of one shape, as of a checkerboard",
            "take an evenly lit image of the lenslets",
        )
