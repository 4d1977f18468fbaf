"""Which groups of unknowns a scan calls for: those that lower the error of patterns that are never fitted."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lfcal.fit.normal import Columns, Normal
from lfcal.fit.problem import Point, Problem
from lfcal.fit.solver import shared_of, solve, with_prior

__all__ = ["Selection", "choose", "gain_of", "prune"]

F8 = NDArray[np.float64]


class Selection:
    """The sums of squares of fitted and left-out patterns as quadratic forms of all unknowns about a point.

    ``samples`` is the number of left-out ones: what noise alone makes of their sum.
    """

    def __init__(self, problem: Problem, point: Point, columns: Columns) -> None:
        self.problem = problem
        self._fitted = problem.normal(columns, point, problem.fitted)
        aside = problem.measured.left_out if problem.measured.left_out.any() else problem.fitted
        self._aside: Normal = problem.normal(columns, point, aside)
        self._matrix, self._gradient = with_prior(problem, self._fitted, point.u)
        self.samples = float((point.seen.inverse[aside] > 0).sum())

    def left(self, groups: Sequence[str]) -> float:
        """Return the sum of squares of left-out patterns after the best step of the groups' unknowns."""
        used = shared_of(self.problem, self.problem.vector.of_groups(groups))
        step = solve(self._matrix[np.ix_(used, used)], self._gradient[used])
        return self._aside.chi2 - self._aside.change(step, used)

    def threshold(self, groups: Sequence[str], left: float) -> float:
        """Return by how much a group must lower the sum to be told from one that does nothing.

        q unknowns that fit noise change it by 0 +- sqrt(q) or so: their own errors times the left-out noise.
        """
        q = len(self.problem.vector.of_groups(groups))
        return (4.0 + 4.0 * math.sqrt(q)) * max(1.0, left / self.samples)


def gain_of(selection: Selection, chosen: Sequence[str], name: str) -> tuple[float, float]:
    """Return by how much group ``name`` beside ``chosen`` lowers the sum of left-out squares, and what is enough."""
    others = [one for one in chosen if one != name]
    without, with_it = selection.left(others), selection.left([*others, name])
    return without - with_it, selection.threshold([name], with_it)


def choose(
    problem: Problem,
    point: Point,
    columns: Columns,
    chosen: Sequence[str],
    candidates: Sequence[str],
    *,
    least: float = 0.0,
) -> tuple[str, ...]:
    """Return ``chosen`` and those of ``candidates`` that help beside it, the most helpful first.

    Each is tried by the linear fit about ``point``, with the derivatives ``columns`` by all of them. It must take away
    the share ``least`` of what is left: far from the best point all help a little.
    """
    selection = Selection(problem, point, columns)
    found, left = list(chosen), [name for name in candidates if name not in chosen]
    while left:
        gains = {name: gain_of(selection, found, name) for name in left}
        best = max(left, key=lambda name: gains[name][0] / gains[name][1])
        if gains[best][0] <= max(gains[best][1], least * selection.left(found)):
            break
        found.append(best)
        left.remove(best)
    return tuple(found)


def prune(
    problem: Problem, point: Point, columns: Columns, chosen: Sequence[str], core: Sequence[str]
) -> tuple[str, ...]:
    """Return ``chosen`` without the groups that do not help beside the others; those of ``core`` stay."""
    found = list(chosen)
    while more := [name for name in found if name not in core]:
        # what a group gains about its own start: its unknowns go back to it
        costs = {name: _cost_of_leaving(problem, point, columns, found, name) for name in more}
        worst = min(more, key=lambda name: costs[name][0] / costs[name][1])
        if costs[worst][0] > costs[worst][1]:
            break
        found.remove(worst)
    return tuple(found)


def _cost_of_leaving(
    problem: Problem, point: Point, columns: Columns, chosen: Sequence[str], name: str
) -> tuple[float, float]:
    """Return by how much left-out squares grow where a group's unknowns go back to their start, and what is enough."""
    k = problem.vector.of_groups([name])
    back = np.tensordot(-point.u[k], columns.shared[k], axes=1)
    selection = Selection(problem, point, columns)
    now = selection.left(chosen)
    others = [one for one in chosen if one != name]
    u = point.u.copy()
    u[k] = 0.0
    start = problem.weigh(
        u, point.local, (point.model + back).astype(np.float32), point.sampling, lamps=point.levels.lamps
    )
    # the noise stays that of the better model
    before = Selection(problem, start, columns)
    return before.left(others) - now, selection.threshold([name], now)
