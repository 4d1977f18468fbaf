"""Removal of patterns that repeat from lenslet to lenslet near the native plane; they are mainly errors of H.

Near the native plane, each lenslet images the points behind it onto nearly the same pixels. A pattern that is the same
behind all lenslets changes the frame there like a slightly wrong H. An error of H (vignetting, an aperture, a white
frame) is the same under all lenslets, while the object is not. Such a pattern is a nuisance parameter of the
calibration. The repeating part of an update, the geometric mean over all periods of its ratio to the surrounding mean,
is therefore removed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.reconstruct.solvers.planes import box_mean

__all__ = ["Repeating"]

STEEP = 0.7
"""Limit of the logarithms of factors, so that a single bright bead does not dominate the repeating part."""

DARK = 1e-6
"""Smallest factor; smaller ones, of vanishing voxels, are set to it."""

FEWEST = 8
"""Smallest number of periods in a plane for detecting repetition."""


@dataclass(frozen=True)
class Repeating:
    """Removal of the repeating part from the updates of each plane.

    Attributes
    ----------
    period
        Period ``(ny, nx)`` of H (voxels).
    shares
        Fraction of the repeating part to remove from the updates of each plane, in [0, 1].
    """

    period: tuple[int, int]
    shares: tuple[float, ...]

    def without(self, z: int, factor: NDArray[Any], seen: NDArray[np.bool_]) -> NDArray[Any]:
        """Return the multiplicative update ``(Y, X)`` of plane ``z`` without its repeating part.

        ``seen`` marks voxels with an update; the others are ignored and unchanged.
        """
        share = self.shares[z]
        (ny, nx), (rows, columns) = self.period, factor.shape
        down, across = -(-rows // ny), -(-columns // nx)
        if share <= 0 or down * across < FEWEST:
            return factor
        logs, count = np.zeros((2, down * ny, across * nx), factor.dtype)
        np.log(np.maximum(factor, DARK), out=logs[:rows, :columns], where=seen)
        # divide by the mean over a surrounding period, because an error of the total light is not a pattern
        logs[:rows, :columns] -= box_mean(logs[:rows, :columns], self.period)
        np.clip(logs, -STEEP, STEEP, out=logs)
        count[:rows, :columns] = seen
        logs *= count
        total, number = (a.reshape(down, ny, across, nx).sum((0, 2), dtype=np.float64) for a in (logs, count))
        mean = np.divide(total, number, out=np.zeros_like(total), where=number > 0)
        # the total light of the plane is not a pattern
        mean -= mean.mean()
        even = np.tile(np.exp(-share * mean), (down, across))[:rows, :columns].astype(factor.dtype)
        found: NDArray[Any] = np.multiply(factor, even, out=factor.copy(), where=seen)
        return found
