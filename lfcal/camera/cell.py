"""The cell of a lattice: what lies nearer to one of its points than to any other."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Vector", "cell_corners", "cell_neighbours", "cell_size"]

Array = NDArray[np.float64]
Vector = tuple[float, float]

UPRIGHT = 1e-9
"""Cosine of the angle between shortest vectors below which the cell is a rectangle."""


def cell_neighbours(basis: ArrayLike) -> Array:
    """Return the neighbours that bound the cell, one of each opposite pair: two of a rectangle, three of a hexagon.

    Parameters
    ----------
    basis
        Two vectors of the lattice as rows, ``(2, 2)``.

    Returns
    -------
    ndarray
        ``(2 or 3, 2)``, in the order of their angles, within half a turn: with their negatives they go round the cell.
    """
    vectors = np.array(basis, float)
    # squares of lengths could overflow
    unit = float(np.abs(vectors).max())
    short, long = vectors / unit
    # Gauss's reduction: the shortest vectors, at 60 to 90 degrees
    steps = 1.0
    while abs(steps) >= 1:
        if short @ short > long @ long:
            short, long = long, short
        steps = np.rint(short @ long / (short @ short))
        long = long - steps * short
    if short @ long < 0:
        long = -long
    if short[0] * long[1] < short[1] * long[0]:
        short, long = long, short
    if short @ long <= UPRIGHT * np.hypot(*short) * np.hypot(*long):
        return unit * np.array([short, long])
    return unit * np.array([short, long, long - short])


def cell_corners(basis: ArrayLike) -> Array:
    """Return the corners ``(4 or 6, 2)`` of the cell about a point of the lattice, from +x towards +y round it.

    Each lies where the perpendicular bisectors of two neighbours in turn meet; all are as far from the point.
    """
    unit = float(np.abs(np.array(basis, float)).max())
    half = cell_neighbours(basis) / unit
    around = np.concatenate([half, -half, half[:1]])
    pairs = np.stack([around[:-1], around[1:]], axis=1)
    squares = (pairs**2).sum(-1, keepdims=True) / 2
    corners: Array = unit * np.linalg.solve(pairs, squares)[..., 0]
    return corners


@lru_cache(maxsize=256)
def cell_size(a: Vector, b: Vector) -> tuple[tuple[float, ...], float]:
    """Return the distances of opposite sides of the cell of two vectors, and its diameter from corner to corner.

    Kept, as simulations ask for them at every lenslet.
    """
    sides = np.hypot(*cell_neighbours((a, b)).T)
    return tuple(sides.tolist()), 2 * float(np.hypot(*cell_corners((a, b))[0]))
