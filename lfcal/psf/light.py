"""Find planes and positions of H without light, at which nothing can be reconstructed."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lfcal.psf.facts import Origin
from lfcal.psf.matrix import PSFMatrix
from lfcal.psf.store import facts_of

__all__ = ["dark_planes", "empty_positions", "empty_words"]


def dark_planes(matrix: PSFMatrix) -> tuple[int, ...]:
    """Return the indices of the depth planes whose entries sum to zero or less."""
    return tuple(z for z in range(len(matrix)) if not matrix.depth_sum(z).sum() > 0)


def empty_positions(matrix: PSFMatrix) -> NDArray[np.intp]:
    """Return the positions ``(n, 3)`` (z, y, x) of H that were neither recorded nor filled: their entries are 0.

    ``matrix`` may be H or HT.
    """
    facts = facts_of(matrix)
    if facts.recorded is None:
        return np.empty((0, 3), np.intp)
    empty = facts.recorded == 0
    return np.argwhere(empty if facts.origin is None else empty & (facts.origin == Origin.MEASURED))


def empty_words(matrix: PSFMatrix) -> str:
    """Return a text with the number of empty positions of H and the first of them; empty if there are none."""
    empty = empty_positions(matrix)
    if not len(empty):
        return ""
    verb = "is" if len(empty) == 1 else "are"
    first = tuple(empty[0].tolist())
    return (
        f"{len(empty):,} of {math.prod(matrix.shape[:3]):,} positions {verb} missing, the first at (z, y, x) = {first}"
    )
