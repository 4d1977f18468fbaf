"""Determine whether the frames of a plane are flipped or turned, from the motion of their centroids."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.frames import AS_IS, nearest_orientation
from lfcal.judge.quality.pattern_table import PatternTable

__all__ = ["move_matrix", "turned_frames"]

WHOLE = 0.8
"""Fraction of the highest typical energy above which a pattern is not cut off; the centroid of a cut-off one lags."""

FAR = 0.9
"""Largest distance of the motion from the motion of an orientation; if the image does not move, it is 1.4 for all."""


def move_matrix(table: PatternTable, use: NDArray[np.bool_]) -> NDArray[np.float64] | None:
    """Return the motion (down, right) of the image per planned pixel, ``(2, 2)``; ideally the unit matrix.

    In a cutout that follows the source, the pattern does not move; the motion of its centroid is added to that of the
    cutout. None if the positions do not span the plane.
    """
    light = np.where(use, table.light, 0.0)
    whole = use & (light > WHOLE * np.quantile(light, 0.9))
    y, x = np.nonzero(whole)
    if len(y) < 8 or np.ptp(y) < 2 or np.ptp(x) < 2:
        return None
    design = np.column_stack([y, x, np.ones(len(y))]).astype(np.float64)
    seen = np.column_stack([table.column("row")[whole], table.column("column")[whole]])
    keep = np.ones(len(y), bool)
    for _ in range(3):
        slopes = np.linalg.lstsq(design[keep], seen[keep], rcond=None)[0]
        distance = np.hypot(*(seen - design @ slopes).T)
        # single misplaced frames must not determine the orientation of the plane
        keep = distance <= np.quantile(distance, 0.8)
    moves: NDArray[np.float64] = np.eye(2) + slopes[:2].T
    return moves


def turned_frames(table: PatternTable, use: NDArray[np.bool_]) -> str:
    """Return the orientation that would make the frames of a plane upright, by name.

    It is ``"as is"`` unless another orientation is clearly closer to the motion of the image.
    """
    moves = move_matrix(table, use)
    if moves is None:
        return AS_IS
    nearest, away = nearest_orientation(moves)
    return nearest.name if away < min(FAR, float(np.linalg.norm(np.eye(2) - moves)) / 2) else AS_IS
