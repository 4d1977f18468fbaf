"""Values of patterns in the order of the scan: robust fits and jumps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["BETTER", "ENOUGH", "FEW", "SURE", "SeriesJump", "Usual", "robust", "scan_order", "sharpest_step", "usual"]

F8 = NDArray[np.float64]

SURE = 7.0
"""Standard deviations above which a fault is significant."""

BETTER = 0.6
"""Ratio of two residuals below which the smaller one is clearly better; values with a ratio above it are similar."""

FAR = 6.0
"""Standard deviations above which a value has no weight."""

MOST = 0.6
"""Fraction of the values that must be near the median for a fit to start with only these."""

FEW = 6
"""Smallest number of patterns on either side of a jump."""

ENOUGH = 8
"""Smallest number of patterns that determine a typical value."""


class Usual(NamedTuple):
    """Typical value: the median, the scatter about it (by medians), and the error of the median.

    ``good`` marks the known values ``(n,)``.
    """

    middle: float
    scatter: float
    error: float
    good: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class SeriesJump:
    """A jump in the order of the scan.

    Attributes
    ----------
    size
        Mean after minus mean before.
    sigmas
        Size in standard deviations of the values' scatter.
    after
        Indices of the patterns after the jump, in the order of the scan.
    """

    size: float
    sigmas: float
    after: NDArray[np.intp]


def usual(values: F8, sigmas: F8) -> Usual | None:
    """Return the typical value of ``(n,)`` values with known errors; None if too few are known."""
    good = np.isfinite(sigmas)
    if good.sum() < ENOUGH:
        return None
    middle = float(np.median(values[good]))
    scatter = 1.4826 * float(np.median(np.abs(values[good] - middle)))
    return Usual(middle, scatter, max(scatter, float(np.median(sigmas[good]))) / float(np.sqrt(good.sum())), good)


def robust(design: F8, values: F8, sigmas: F8) -> tuple[F8, F8, F8]:
    """Return the coefficients of the best fit of ``design (n, k)`` to values, their errors, and the residuals ``(n,)``.

    Outliers have no weight. Errors follow the scatter of the residuals if it exceeds the sigmas.
    """
    good = np.isfinite(sigmas)
    keep = _middle(values, good)
    weight = np.where(good, 1 / np.where(good, sigmas, 1.0), 0.0)
    found = np.zeros(design.shape[1])
    errors = np.full(design.shape[1], np.inf)
    left = values.copy()
    for _ in range(4):
        a, b = design[keep] * weight[keep, None], values[keep] * weight[keep]
        size = np.sqrt(np.square(a).sum(0))
        used = size > 0
        if keep.sum() <= used.sum():
            break
        inverse = np.linalg.pinv((a[:, used] / size[used]).T @ (a[:, used] / size[used]), rcond=1e-9, hermitian=True)
        found[used] = inverse @ ((a[:, used] / size[used]).T @ b) / size[used]
        left = values - design @ found
        scatter = max(1.0, 1.4826 * float(np.median(np.abs(left[keep] * weight[keep]))))
        errors[used] = scatter * np.sqrt(np.diag(inverse)) / size[used]
        keep = good & (np.abs(left) * weight < 4 * scatter)
    return found, errors, left


def _middle(values: F8, good: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask of the values near the median, because a fit that starts with all values would follow outliers."""
    if not good.any():
        return good.copy()
    away = np.abs(values - np.median(values[good]))
    near = good & (away <= FAR * 1.4826 * float(np.median(away[good])))
    return near if near.sum() > MOST * good.sum() else good.copy()


def scan_order(index: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the order in which positions ``(n, 3)`` are scanned, plane by plane and row by row."""
    z, y, x = index.T
    found: NDArray[np.intp] = np.lexsort((x, y, z))
    return found


def sharpest_step(order: NDArray[np.intp], values: F8, sigmas: F8) -> SeriesJump | None:
    """Return the jump that best explains the values in ``order``; None if a straight line is as good."""
    order = order[np.isfinite(sigmas[order])]
    if len(order) < 2 * FEW:
        return None
    v = values[order] - np.median(values[order])
    scatter = max(1.4826 * float(np.median(np.abs(np.diff(v)))) / np.sqrt(2), float(np.median(sigmas[order])))
    whole, v = v, np.clip(v, -FAR * scatter, FAR * scatter)  # a single frame is not a jump
    n = np.arange(1, len(v))
    sums = np.cumsum(v)[:-1]
    before, after = sums / n, (v.sum() - sums) / (len(v) - n)
    reported = np.abs(after - before) / scatter * np.sqrt(n * (len(v) - n) / len(v))
    reported[: FEW - 1] = reported[len(reported) - FEW + 1 :] = 0.0
    k = int(np.argmax(reported))
    stepped = v - np.where(np.arange(len(v)) > k, after[k], before[k])
    straight = v - np.polyval(np.polyfit(np.arange(len(v)), v, 1), np.arange(len(v)))
    if np.median(np.abs(stepped)) > BETTER * np.median(np.abs(straight)):
        return None  # it changes evenly
    size = float(np.median(whole[k + 1 :]) - np.median(whole[: k + 1]))
    return SeriesJump(size, float(reported[k]), order[k + 1 :])
