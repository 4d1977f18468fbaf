"""How well the places of a list tell the step of a plane: the stage's scatter, and what rounding leaves open."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lfcal.frames.lists._grid import PlaneGrid

__all__ = ["rounding", "step_error", "step_size"]

COARSEST = 8.0
"""Shares of a step that places may be rounded to."""


def step_size(steps: NDArray[np.float64]) -> float:
    """Return the side of a square as large as the cell between steps."""
    return float(np.sqrt(np.abs(np.linalg.det(steps))))


def step_error(lateral: NDArray[np.float64], plane: PlaneGrid) -> float:
    """Return the standard error of a plane's `step_size`, in the unit of the list.

    The frames of a column share what is wrong with its coordinate, and so do those of a row: rounding is the same in
    all of them. So a column counts once, however many frames it has.

    Parameters
    ----------
    lateral
        ``(N, 2)`` coordinates of all frames of the list along the two lateral axes.
    plane
        The plane, as its grid was found.
    """
    points, index = lateral[plane.frames], plane.index.astype(float)
    used = np.ptp(index, axis=0) > 0
    if not used.any():
        return 0.0
    design = np.column_stack([np.ones(len(points)), index[:, used]])
    solve = np.linalg.pinv(design)
    rest = points - design @ (solve @ points)
    size = step_size(plane.steps)
    # of the size by each step; where there is a single row or column both steps are the same one
    gradient = size / used.sum() * np.linalg.inv(plane.steps).T
    total = 0.0
    for axis in (0, 1):
        weights = gradient[used, axis] @ solve[1:]
        numbers, group = np.unique(plane.index[:, axis], return_inverse=True)
        columns = float((np.bincount(group, weights * rest[:, axis]) ** 2).sum())
        columns *= len(numbers) / max(1, len(numbers) - 2)
        frames = float(((weights * rest[:, axis]) ** 2).sum()) * len(points) / max(1, len(points) - 3)
        error = max(columns, frames)  # few columns may happen to cancel
        if used[axis]:
            straight = points[:, axis] - index[:, 1 - axis] * plane.steps[1 - axis, axis] * used[1 - axis]
            unit = rounding(points[:, axis], size)
            left, scatter = _left_open(straight, group, numbers, unit, plane.steps[axis, axis])
            left = (gradient[axis, axis] * left) ** 2
            # of places that do not scatter at all the digits tell everything
            error = left if left and scatter < 0.01 else max(error, left)
        total += error
    return math.sqrt(total)


def rounding(values: NDArray[np.float64], step: float) -> float:
    """Return the 1, 2, 2.5 or 5 of a decimal that all values are multiples of; 0 if none is below an eighth of a step.

    Coarser ones would be the steps themselves; of finer ones than seven decades nothing is left open that matters.
    """
    top = math.floor(math.log10(step / COARSEST)) if step > 0 else 0
    for exponent in range(top, top - 7, -1):
        for digit in (5, 2.5, 2, 1):
            unit = digit * 10.0**exponent
            if unit <= step / COARSEST and np.abs(values / unit - np.round(values / unit)).max() < 1e-4:
                return unit
    return 0.0


def _left_open(
    values: NDArray[np.float64], group: NDArray[np.intp], numbers: NDArray[np.intp], unit: float, step: float
) -> tuple[float, float]:
    """Return the error that rounding to ``unit`` leaves to a step, and the variance within columns in that unit.

    The error is 0 where the stage scatters beyond rounding.

    Steps that are nearly a whole number of digits are rounded alike in many columns: the values then lie on a line as
    if they were exact, and their scatter tells nothing. What rounding leaves open are all slopes of lines through the
    ranges that the digits stand for.
    """
    if not unit:
        return 0.0, 0.0
    means = np.bincount(group, values) / np.bincount(group)
    scatter = float(np.mean((values - means[group]) ** 2)) / unit**2
    # frames of a column that scatter by some of a digit have a mean that is better than a digit
    unit *= math.exp(-2 * math.pi**2 * scatter)
    first, second = np.triu_indices(len(numbers), 1)
    apart, rise = numbers[second] - numbers[first], means[second] - means[first]
    low, high = float(((rise - unit) / apart).max()), float(((rise + unit) / apart).min())
    if low > high:
        return 0.0, scatter
    # the lines of the middle slopes have more room: a triangle rather than equal odds
    return math.sqrt((high - low) ** 2 / 24 + ((low + high) / 2 - step) ** 2), scatter
