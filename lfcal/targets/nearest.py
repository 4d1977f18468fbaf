"""Which position of a scan each image of a frame shows, and how far beside it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from lfcal.targets.phases import Phases

__all__ = ["Nearest", "nearest_positions"]


class Nearest(NamedTuple):
    """Positions ``(n, 2)`` as (y, x), and the phases of the images minus theirs ``(n, 2)`` (pixels)."""

    positions: NDArray[np.intp]
    residual_px: NDArray[np.float64]


def nearest_positions(phases: Phases, pixels: ArrayLike) -> Nearest:
    """Return the position that each image ``(n, 2)`` (sensor row, column) is next to, by its phase in the array."""
    wanted, found = phases.wanted(), phases.at(np.asarray(pixels, float).reshape(-1, 2))
    if not len(found):
        return Nearest(np.zeros((0, 2), np.intp), np.zeros((0, 2)))
    number = cKDTree(wanted, boxsize=phases.period).query(found, p=np.inf)[1]
    away = found - wanted[number]
    away -= phases.period * np.round(away / phases.period)
    return Nearest(np.stack(np.divmod(number, phases.plan.period[1]), axis=-1).astype(np.intp), away)
