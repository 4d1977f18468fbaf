"""Offsets along one axis."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["line_offsets"]

Array = NDArray[np.float64]


def line_offsets(at: Array, count: int, length: float, tolerance_px: float) -> tuple[Array, bool]:
    """Return offsets along one axis, chosen greedily, by which images show its phases, and whether all of them.

    Parameters
    ----------
    at
        Phases of the images ``(n,)`` without an offset (pixels).
    count, length
        Phases 0 … count - 1, of a period of this length (pixels).
    tolerance_px
        How far off a phase may be.
    """
    asked = np.arange(count)[:, None] - at
    asked -= length * np.round(asked / length)
    near = [asked.ravel() + share * tolerance_px for share in (-0.9, -0.45, 0.0, 0.45, 0.9)]
    candidates = np.unique(np.round(np.concatenate(near), 6))
    serves = np.zeros((len(candidates), count), np.bool_)
    # a phase is met directly, or one period further up or down
    for turn in (-1, 0, 1):
        moved = candidates[:, None] + at - turn * length
        nearest = np.round(moved)
        good = (np.abs(moved - nearest) <= tolerance_px) & (nearest >= 0) & (nearest < count)
        which, hole = np.nonzero(good)
        serves[which, nearest[which, hole].astype(np.intp)] = True
    found: list[float] = []
    missing = np.ones(count, np.bool_)
    while missing.any():
        gain = serves @ missing.astype(np.float32)
        # of equal ones the shortest way
        best = int(np.lexsort((np.abs(candidates), -1.0 * gain))[0])
        if not gain[best]:
            break
        found.append(float(candidates[best]))
        missing &= ~serves[best]
    return np.array(found), not missing.any()
