"""Patterns that are not like the others: left out with a reason."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.fit.problem import Point, Problem
from lfcal.fit.result import Outlier

__all__ = ["outliers_of"]

FAR = 8.0
"""Robust standard deviations from the other patterns' chi² from which on a pattern is left out."""

LEAST = 1.3
"""How many times the others' chi² it must be, whatever they scatter."""


def outliers_of(problem: Problem, point: Point) -> tuple[NDArray[np.bool_], tuple[Outlier, ...]]:
    """Return which patterns ``(n,)`` are outliers, and each with its reason.

    Judged by each pattern's own chi² against median and spread of all.
    """
    pixels = np.maximum(1, (point.seen.inverse > 0).sum(1))
    # without the robust loss: what it forgives is what shows here
    chi2 = np.square(point.seen.residual, dtype=np.float64).sum(1) / pixels
    middle = float(np.median(chi2))
    noise = np.sqrt(2.0 / pixels)
    spread = max(1.4826 * float(np.median(np.abs(chi2 - middle))), middle * float(np.median(noise)))
    far = (chi2 > middle + FAR * spread) & (chi2 > LEAST * middle)
    # half of the patterns are no outliers: then the model is wrong
    if far.sum() > 0.25 * len(far):
        far[:] = False
    measured = problem.measured
    regions = measured.level // measured.plan.shape[0]
    found = [
        Outlier(int(z), int(y), int(x), f"chi² {own:.3g} where the others have {middle:.3g}", int(region))
        for (z, y, x), own, region in zip(measured.index[far], chi2[far], regions[far], strict=True)
    ]
    return far, tuple(found)
