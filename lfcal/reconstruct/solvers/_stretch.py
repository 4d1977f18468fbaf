"""Lengthen the first updates of a reconstruction, to separate planes and details faster.

A multiplicative update is short because all planes explain the same light. In each iteration, a mode of a single plane
converges only by about its fraction of the light. The common part of all planes, light that changes little over the
width of a pattern, converges completely. The logarithm of an update, relative to its mean over the pixels of a pattern,
is therefore multiplied by ``1 + strength`` (over-relaxation in the exponent, Tanaka 1987; Lewitt & Muehllehner 1986).
The volume's light remains that of the plain update.

The image shows when an update is too long: between the models of two iterations, the likelihood is nearly a parabola.
If its maximum is before the second model (a Newton step along the line, Kaufman 1987), the strength is reduced
accordingly. If the second model is less likely than the first, the update ends at the maximum instead. The likelihood
is concave along the line between the models, so the maximum follows from the two models without another projection.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.reconstruct.solvers.measurement import Measurement
from lfcal.reconstruct.solvers.planes import box_mean

__all__ = ["Stretch", "best_share", "weaker"]

FIRST = 2.0
"""Strength of the first update."""

FADING = 0.9
"""Factor on the strength from one iteration to the next."""

LEAST = 0.3
"""Smallest additional factor, for last steps that ended far beyond the maximum."""

IDLE = 0.2
"""Strength below which updates are not lengthened any more, to save time."""

HALVINGS = 8
"""Number of bisections in the search for the maximum, which is then known to 1/256 of the step."""

STEEPEST = 3.0
"""Largest change of the logarithm of a factor by lengthening."""


@dataclass(frozen=True)
class Stretch:
    """Settings for stretching updates.

    Attributes
    ----------
    window
        Size ``(rows, columns)`` of the window whose mean is not stretched (voxels).
    period
        Period ``(ny, nx)`` of H (voxels).
    shares
        Fraction, in [0, 1], of details finer than a period that is not stretched, for each plane; empty: 0 for all.
    first
        Strength of the first update.
    """

    window: tuple[int, int]
    period: tuple[int, int] = (1, 1)
    shares: tuple[float, ...] = ()
    first: float = FIRST

    def apply(self, z: int, factor: NDArray[Any], seen: NDArray[np.bool_], strength: float) -> NDArray[Any]:
        """Return the stretched update ``(Y, X)`` of plane ``z``: ``factor`` times ``exp(strength (l - mean l))``.

        Here l is the logarithm of ``factor``, and its mean is over `window`. ``seen`` marks voxels with an update; the
        others are unchanged.
        """
        logs = np.zeros_like(factor)
        np.log(np.maximum(factor, math.exp(-STEEPEST)), out=logs, where=seen)
        beside = logs - box_mean(logs, self.window)
        share = self.shares[z] if self.shares else 0.0
        if share > 0:
            # the mean over a period excludes patterns that repeat from lenslet to lenslet
            beside -= logs.dtype.type(share) * (logs - box_mean(logs, self.period))
        beside *= logs.dtype.type(strength)
        np.clip(beside, -STEEPEST, STEEPEST, out=beside)
        np.exp(beside, out=beside)
        found: NDArray[Any] = np.multiply(factor, beside, out=factor.copy(), where=seen)
        return found


def weaker(strength: float, before: NDArray[Any], model: NDArray[Any], data: Measurement, floor: float) -> float:
    """Return the strength of the next update, given the models ``(Y, X)`` of the last iteration and of this one."""
    way = np.subtract(model, before, dtype=np.float64)
    rise, left = (_slope(at, way, data, floor) for at in (before, model))
    # the maximum of a parabola with these slopes at 0 and at 1; there is none if it bends upwards
    top = rise / (rise - left) if rise > left else math.inf
    found = strength * FADING * min(max(top, LEAST), 1.0)
    return found if found >= IDLE else 0.0


def best_share(before: NDArray[Any], model: NDArray[Any], data: Measurement, floor: float) -> float:
    """Return the fraction of the step between two models ``(Y, X)`` that has the highest likelihood, rounded down."""
    way = np.subtract(model, before, dtype=np.float64)
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        at = (before + middle * way).astype(before.dtype, copy=False)
        low, high = (middle, high) if _slope(at, way, data, floor) > 0 else (low, middle)
    return low


def _slope(model: NDArray[Any], way: NDArray[np.float64], data: Measurement, floor: float) -> float:
    """Return the derivative of the likelihood at ``model`` along ``way``."""
    ratio = np.divide(data.image, model, out=np.zeros_like(model), where=model > floor)
    return float(np.sum(data.weighted(ratio - 1) * way, dtype=np.float64))
