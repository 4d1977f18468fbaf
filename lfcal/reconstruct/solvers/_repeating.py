"""What repeats from lenslet to lenslet near the native plane: told by H alone, and by its errors before all.

Near the native plane each lenslet images the points behind it onto nearly the same pixels. A pattern that is the same
behind all lenslets changes the frame there as a slightly wrong H does, and an error of H (vignetting, an aperture, a
white frame) is the same under all lenslets, while what one looks at is not: such a pattern is a nuisance parameter of
the calibration, not of the volume. An update's part that repeats, the geometric mean over all periods of
what it is beside the mean around, is left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.reconstruct.solvers.planes import box_mean

__all__ = ["Repeating"]

STEEP = 0.7
"""Logarithms of factors beyond this count as this: a single bright bead does not tell what repeats."""

DARK = 1e-6
"""Smaller factors count as this: where a voxel goes out."""

FEWEST = 8
"""Periods that a plane must have, or nothing can be told to repeat."""


@dataclass(frozen=True)
class Repeating:
    """What repeats in the updates of each plane.

    Attributes
    ----------
    period
        ``(ny, nx)`` of H in voxels.
    shares
        How much of it is left out of each plane's updates, in [0, 1].
    """

    period: tuple[int, int]
    shares: tuple[float, ...]

    def without(self, z: int, factor: NDArray[Any], seen: NDArray[np.bool_]) -> NDArray[Any]:
        """Return the multiplicative update ``(Y, X)`` of plane ``z`` less what repeats in it.

        ``seen``: which voxels have an update; the others do not count, and stay as they are.
        """
        share = self.shares[z]
        (ny, nx), (rows, columns) = self.period, factor.shape
        down, across = -(-rows // ny), -(-columns // nx)
        if share <= 0 or down * across < FEWEST:
            return factor
        logs, count = np.zeros((2, down * ny, across * nx), factor.dtype)
        np.log(np.maximum(factor, DARK), out=logs[:rows, :columns], where=seen)
        # where there is more or less light than thought is no pattern: beside the mean of a period around
        logs[:rows, :columns] -= box_mean(logs[:rows, :columns], self.period)
        np.clip(logs, -STEEP, STEEP, out=logs)
        count[:rows, :columns] = seen
        logs *= count
        total, number = (a.reshape(down, ny, across, nx).sum((0, 2), dtype=np.float64) for a in (logs, count))
        mean = np.divide(total, number, out=np.zeros_like(total), where=number > 0)
        # the plane's light is no pattern
        mean -= mean.mean()
        even = np.tile(np.exp(-share * mean), (down, across))[:rows, :columns].astype(factor.dtype)
        found: NDArray[Any] = np.multiply(factor, even, out=factor.copy(), where=seen)
        return found
