"""Select groups of unknowns: those that lower the error of held-out patterns."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.fit.normal import Columns, Normal
from lfcal.fit.parameters import GROUPS
from lfcal.fit.problem import Point, Problem
from lfcal.fit.solver import shared_of, solve, stepped, with_prior
from lfcal.simulate.engines import EnergyError

__all__ = ["GroupSelection", "choose", "gain_of", "prune"]

F8 = NDArray[np.float64]

LINEAR = 0.5
"""Largest distance from the start (in scales) at which derivatives predict the effect of fixing an unknown."""

STEPS = 6
"""Largest number of steps in which the other groups compensate for a group that is removed."""


class GroupSelection:
    """Sums of squared residuals of fitted and held-out patterns, as quadratic forms of all unknowns about a point.

    ``columns`` contains the derivatives of the patterns with respect to all unknowns at the point. If no patterns are
    held out, the fitted ones are used instead. ``samples`` is the number of held-out samples, and so the sum that noise
    alone would contribute.
    """

    def __init__(self, problem: Problem, point: Point, columns: Columns) -> None:
        self.problem = problem
        self._fitted = problem.normal(columns, point, problem.fitted)
        aside = problem.measured.held_out if problem.measured.held_out.any() else problem.fitted
        self._aside: Normal = problem.normal(columns, point, aside)
        self._matrix, self._gradient = with_prior(problem, self._fitted, point.u)
        self.samples = float((point.seen.inverse[aside] > 0).sum())

    def left(self, groups: Sequence[str]) -> float:
        """Return the sum of squared residuals of the held-out patterns after a step of the unknowns of ``groups``.

        The step is the best one for the fitted patterns and the priors; gains and backgrounds change as well.
        """
        used = shared_of(self.problem, self.problem.vector.of_groups(groups))
        step = solve(self._matrix[np.ix_(used, used)], self._gradient[used])
        return self._aside.chi2 - self._aside.change(step, used)

    def threshold(self, groups: Sequence[str], left: float) -> float:
        """Return the decrease of the held-out sum of squares above which ``groups`` improve the model.

        ``left`` is the sum with these groups. If the q unknowns of ``groups`` fit only noise, they change the sum by
        about 0 ± sqrt(q).
        """
        q = len(self.problem.vector.of_groups(groups))
        return (4.0 + 4.0 * math.sqrt(q)) * max(1.0, left / self.samples)


def gain_of(selection: GroupSelection, chosen: Sequence[str], added: Sequence[str]) -> tuple[float, float]:
    """Return the decrease of the held-out sum of squares due to the groups ``added``, and the required decrease.

    The decrease is the difference from the sum with the groups of ``chosen`` that are not in ``added``.
    """
    others = [one for one in chosen if one not in added]
    without, with_it = selection.left(others), selection.left([*others, *added])
    return without - with_it, selection.threshold(added, with_it)


def _trials(left: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the candidates for the next trial: each group of ``left`` alone, and together with its companions."""
    alone = [(name,) for name in left]
    along = [(name, *(other for other in GROUPS.get(name).along if other in left)) for name in left]
    return alone + [together for together in along if len(together) > 1]


def choose(
    problem: Problem,
    point: Point,
    columns: Columns,
    chosen: Sequence[str],
    candidates: Sequence[str],
    *,
    least: float = 0.0,
) -> tuple[str, ...]:
    """Return ``chosen`` followed by the ``candidates`` that lower the held-out residual, the most effective first.

    Each candidate is tried by a linear fit about ``point``, which uses the derivatives ``columns`` with respect to all
    unknowns. The candidate must lower the sum of squared residuals by more than the fraction ``least``, because far
    from the best point every group helps a little.
    """
    selection = GroupSelection(problem, point, columns)
    found, left = list(chosen), [name for name in candidates if name not in chosen]
    while left:
        gains = {added: gain_of(selection, found, added) for added in _trials(left)}
        best = max(gains, key=lambda added: gains[added][0] / gains[added][1])
        if gains[best][0] <= max(gains[best][1], least * selection.left(found)):
            break
        found.extend(best)
        left = [name for name in left if name not in best]
    return tuple(found)


def prune(
    problem: Problem, point: Point, columns: Columns, chosen: Sequence[str], core: Sequence[str]
) -> tuple[str, ...]:
    """Return ``chosen`` without the groups that do not lower the held-out residual; those in ``core`` always stay.

    ``point`` and ``columns`` are as in `choose`.
    """
    found, kept = list(chosen), set(core)
    while more := [name for name in found if name not in kept]:
        # benefit of a group relative to its start, to which its unknowns return
        costs = {name: _cost_of_leaving(problem, point, columns, found, name) for name in more}
        worst = min(more, key=lambda name: costs[name][0] / costs[name][1])
        if costs[worst][0] > costs[worst][1]:
            break
        if _far(problem, point, worst) and _helps(problem, point, columns, found, worst):
            kept.add(worst)
        else:
            found.remove(worst)
    return tuple(found)


def _far(problem: Problem, point: Point, name: str) -> bool:
    """Return whether the unknowns of a group are too far from their start for derivatives to be valid."""
    return bool(np.abs(point.u[problem.vector.of_groups([name])]).max(initial=0.0) > LINEAR)


def _helps(problem: Problem, point: Point, columns: Columns, chosen: Sequence[str], name: str) -> bool:
    """Return whether held-out squares increase if the unknowns of a group return to their start and the others adapt.

    This uses computed patterns. At the best point, derivatives with respect to the distance of the source resemble a
    combination of those for gap, focal lengths and iris. Over several steps, the effects differ by 1 % of the light.
    """
    others = [one for one in chosen if one != name]
    which = problem.vector.of_groups(others)
    selection = GroupSelection(problem, point, columns)
    now = selection.left(chosen)
    u = point.u.copy()
    u[problem.vector.of_groups([name])] = 0.0
    try:
        trial = problem.point(u, point.local, point.sampling, lamps=point.levels.lamps)
    except (InputError, EnergyError):
        return True
    damping = 1e-3
    for _ in range(STEPS):
        trial, damping, gained = stepped(problem, trial, columns, which.tolist(), damping)
        if gained <= 0:
            break
    left = GroupSelection(problem, trial, columns).left(others)
    return left - now > selection.threshold([name], now)


def _cost_of_leaving(
    problem: Problem, point: Point, columns: Columns, chosen: Sequence[str], name: str
) -> tuple[float, float]:
    """Return the increase of the held-out squares if a group returns to its start, and the threshold for it."""
    k = problem.vector.of_groups([name])
    back = np.tensordot(-point.u[k], columns.shared[k], axes=1)
    selection = GroupSelection(problem, point, columns)
    now = selection.left(chosen)
    others = [one for one in chosen if one != name]
    u = point.u.copy()
    u[k] = 0.0
    start = problem.weigh(
        u, point.local, (point.model + back).astype(np.float32), point.sampling, lamps=point.levels.lamps
    )
    # the noise is that of the better model
    before = GroupSelection(problem, start, columns)
    return before.left(others) - now, selection.threshold([name], now)
