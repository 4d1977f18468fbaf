"""The diameter of a target's holes as an unknown that all its points share: when it is called for, and what is told."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from lfcal.base import Work
from lfcal.fit import Columns, Finished, Fit, GroupSelection, chi_square, covariance, gain_of

__all__ = ["HOLE", "hole_words", "is_told", "iter_called_for", "moved_far", "not_told", "without_hole"]

HOLE = "hole"
"""Group of unknowns (`lfcal.fit.groups.light.Holes`)."""

CALLED_FOR = 0.1
"""Share of what is left beyond noise of patterns that were never fitted that another size must take away."""

VAGUE = 0.5
"""Standard deviation of the squared diameter, over that of the description, from which on it is not told."""

SAME = 0.02
"""Change of the squared diameter, relative, that needs no other light of the holes."""

SHOWN = 3.0
"""Standard deviations by which a squared diameter must differ from the description's to be told for all that."""


def iter_called_for(finished: Finished) -> Work[bool]:
    """Return whether the points call for holes of another size than described; yields progress in derivatives.

    They do where chi² says that the model does not suffice, and another size lowers what is left of patterns that
    were never fitted.
    """
    problem, point, groups, columns, _ = finished
    own = problem.vector.of_groups([HOLE]).tolist()
    if not own or chi_square(point, problem.fitted, len(problem.vector.of_groups(groups))).complete:
        return False
    found = yield from problem.columns(point, own, "size of the holes", own=False)
    shared = columns.shared.copy()
    shared[own] = found.shared[own]
    selection = GroupSelection(problem, point, Columns(shared, columns.own))
    gain, enough = gain_of(selection, groups, (HOLE,))
    beyond = max(0.0, selection.left(groups) - selection.samples)
    return gain > max(enough, CALLED_FOR * beyond)


def is_told(finished: Finished) -> bool:
    """Return whether the points tell the size of the holes, which is among the groups that were fitted.

    The image of a hole that is far smaller than the finest detail of a pattern blurs nothing.
    """
    problem, point, groups, columns, _ = finished
    which = problem.vector.of_groups(groups)
    (k,) = problem.vector.of_groups([HOLE]).tolist()
    spread, _ = covariance(problem, point, columns, which)
    chi2 = chi_square(point, problem.fitted, len(which))
    grown = math.sqrt(max(1.0, chi2.lit)) if not chi2.complete else 1.0
    at, one = int(np.flatnonzero(which == k)[0]), problem.vector.unknowns[k]
    sigma = grown * math.sqrt(max(0.0, float(spread[at, at]))) * one.scale**2
    moved = abs(one.value(float(point.u[k])) ** 2 - one.start**2)
    return bool(sigma < VAGUE * one.start**2 or moved > SHOWN * sigma)


def moved_far(finished: Finished) -> bool:
    """Return whether the holes have another size than that of which their light was computed, by more than a trifle."""
    problem, point, groups, _, _ = finished
    if HOLE not in groups:
        return False
    found = problem.vector.setup_at(point.u).hole_um or 0.0
    return bool(abs(found**2 - problem.measured.blurred_um**2) > SAME * found**2)


def without_hole(finished: Finished) -> Finished:
    """Return what was found with the holes as described, at the same values of all else."""
    problem, point, groups, columns, outliers = finished
    u = point.u.copy()
    u[problem.vector.of_groups([HOLE])] = 0.0
    point = problem.point(u, point.local, point.sampling, lamps=point.levels.lamps, doubtful=point.doubtful)
    return problem, point, tuple(name for name in groups if name != HOLE), columns, outliers


def hole_words(fit: Fit, *, asked: bool = True) -> str:
    """Return what a fit of points says of the size of the holes, in a line; empty where it says nothing new.

    Parameters
    ----------
    fit
        Of points.
    asked
        Whether the size was asked for by name: that it is not told is no news else.
    """
    if asked and HOLE in fit.unhelpful:
        stays = _described(fit.setup.hole_um or 0.0)
        return f"size of the holes: not told, their images are far smaller than the light's details; {stays} stay"
    found = fit.parameters.get("hole_um")
    if found is None or abs(found.value - found.start) <= found.sigma:
        return ""
    start = _described(found.start)
    return f"size of the holes: {found.value:.4g} ± {found.sigma:.2g} µm found, {start} described"


def _described(hole_um: float) -> str:
    return f"{hole_um:.4g} µm" if hole_um else "points"


def not_told(fit: Fit) -> Fit:
    """Return the fit with the size of the holes among what was asked for and did not help."""
    return replace(fit, unhelpful=(*fit.unhelpful, HOLE))
