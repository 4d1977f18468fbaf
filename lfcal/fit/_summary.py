"""Summarise a fit in numbers: values, standard deviations, correlations, and degeneracies.

A parameter that was fitted and one that was not are degenerate if they have the same effect on the patterns.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, Work
from lfcal.fit._weighing import PatternLevels
from lfcal.fit.model_error import chi_square, covariance, eliminated, held_out_error
from lfcal.fit.normal import Columns
from lfcal.fit.nuisance import Spread
from lfcal.fit.parameters import GROUPS, Unknown, Vector
from lfcal.fit.problem import Point, Problem
from lfcal.fit.questions import order_of_types
from lfcal.fit.result import Fit, InRegion, Outlier, Parameter
from lfcal.fit.solver import with_prior
from lfcal.fit.spread import spread_out
from lfcal.simulate.engines import EnergyError

__all__ = [
    "Degeneracies",
    "degeneracies",
    "degeneracies_of",
    "iter_degeneracies",
    "summarised",
    "unidentified",
]

# -- degeneracies of fitted and fixed unknowns
# -------------------------------------------------------------------------
F8 = NDArray[np.float64]

WIDER, WIDER_UNASKED = 8.0, 3.0
"""Factor by which a fixed unknown must widen the standard deviation of a fitted one to be reported: for unknowns that
were tried, and for those that were not requested."""

WIDENING_COUNTED = 1.2
"""Factor by which a fixed unknown must widen a standard deviation to be included in it."""

MOST_NAMED = 3
"""Number of affected parameters listed for one unknown."""

LARGEST_SIGMA = 10.0
"""Standard deviation, in scales, above which a fixed unknown is undetermined and only reported."""

FEWEST, MOST_SAMPLED = 3, 8
"""Smallest and largest number of patterns, otherwise a quarter of all, for unknowns that were not requested."""


@dataclass(frozen=True, eq=False)
class Degeneracies:
    """Fixed unknowns and their possible effect on the fitted ones, in units of the scales of the fitted ones.

    Attributes
    ----------
    words
        Description of each degeneracy, the worst first.
    spread
        Covariance ``(k, k)`` due to errors of the fixed unknowns.
    shift
        Possible bias ``(k,)`` of the unknowns: their change if the fixed ones were fitted too.
    counted
        Indices of the fixed unknowns included in ``spread`` and ``shift``.
    """

    words: tuple[str, ...]
    spread: F8
    shift: F8
    counted: tuple[int, ...] = ()

    def with_others(self, others: Degeneracies) -> Degeneracies:
        """Return the combination of both."""
        shift = np.hypot(self.shift, others.shift)
        return Degeneracies((*self.words, *others.words), self.spread + others.spread, shift)

    def variances(self, own: F8, grown: float = 1.0) -> F8:
        """Return the variances of the unknowns; ``own`` ``(k, k)`` is their covariance with everything else fixed.

        An unknown h that is fixed at 0 and estimated as d ± s has the mean square d² + s². Noise is ``grown`` times
        as large as stated.
        """
        found: F8 = np.maximum(grown**2 * np.diag(own + self.spread) + np.square(self.shift), 0.0)
        return found


def degeneracies_of(
    problem: Problem,
    point: Point,
    columns: Columns,
    which: NDArray[np.intp],
    times: float = 1.0,
    named: float = WIDER,
) -> Degeneracies:
    """Return degeneracies between the fitted unknowns ``which`` and those that were tried but not fitted.

    The scan may show a change without determining which of the unknowns caused it. ``columns`` contains the derivatives
    with respect to all unknowns; each pattern represents ``times`` patterns; ``named`` is as in `degeneracies`.
    """
    normal = problem.normal(columns, point, problem.fitted)
    normal = replace(normal, matrix=times * normal.matrix, gradient=times * normal.gradient)
    matrix, gradient = with_prior(problem, normal, point.u)
    k = len(problem.vector)
    held = np.array([j for j in range(k) if j not in which and normal.matrix[j, j] > 0], np.intp)
    data = eliminated(matrix, k)
    slope = gradient[:k] - matrix[:k, k:] @ np.linalg.pinv(matrix[k:, k:], rcond=1e-13) @ gradient[k:]
    return degeneracies(problem.vector.unknowns, which, held, data, slope, point.u, named=named)


def iter_degeneracies(problem: Problem, point: Point, columns: Columns, groups: Sequence[str]) -> Work[Degeneracies]:
    """Return degeneracies between the unknowns of ``groups``, requested by name, and the camera's other unknowns.

    A few patterns show which of them matter; all patterns determine their size. Groups with many simulation runs
    per pattern are not examined. Yields progress in derivatives.
    """
    others = [group.name for group in GROUPS if not group.late and group.name not in groups]
    old, few = problem.vector, _sampled(problem)
    vector = Vector(old.setup, old.frame, [*(group.name for group in old.groups), *others])
    which, held = old.of_groups(groups), range(len(old), len(vector))
    try:
        some = yield from _iter_with(problem, point, columns, vector, few, held)
        first = degeneracies_of(*some, which, float(problem.fitted.sum() / few.sum()), WIDER_UNASKED)
        if not first.counted:
            return first
        every = yield from _iter_with(problem, point, columns, vector, problem.fitted, first.counted)
    except (InputError, EnergyError):
        # the fit is valid even if the camera cannot have all of them together
        return Degeneracies((), np.zeros((len(which), len(which))), np.zeros(len(which)))
    return replace(degeneracies_of(*every, which), words=first.words)


def _iter_with(
    problem: Problem, point: Point, columns: Columns, vector: Vector, keep: NDArray[np.bool_], held: Sequence[int]
) -> Work[tuple[Problem, Point, Columns]]:
    """Return problem, point and derivatives of the patterns ``keep``, with the unknowns of ``vector``.

    The additional unknowns ``held`` of ``vector`` have their fixed values.
    """
    part = Problem(problem.measured.of(keep), vector, problem.workers)
    levels = replace(point.levels, lamps=point.levels.lamps[keep])
    local = replace(point.local, offsets_px=point.local.offsets_px[keep])
    u = np.concatenate([point.u, np.zeros(len(vector) - len(point.u))])
    at = Point(u, local, point.model[keep], levels, point.seen.of(keep), point.sampling, point.doubtful)
    shared = (yield from part.columns(at, held, "other possible changes", displaced=False)).shared
    shared[: len(point.u)] = columns.shared[:, keep]
    return part, at, Columns(shared, None if columns.displacements is None else columns.displacements[:, keep])


def _sampled(problem: Problem) -> NDArray[np.bool_]:
    """Return a mask of some fitted patterns: a quarter of each region, at least three, at most eight in total."""
    measured, keep = problem.measured, np.zeros(len(problem.measured), np.bool_)
    parts = [(plan, own[problem.fitted[own]]) for plan, own, _ in measured.parts()]
    for plan, own in parts:
        few = min(len(own), max(FEWEST, min(MOST_SAMPLED // len(parts), len(own) // 4)))
        keep[own[spread_out(measured.index[own], few, plan.period)]] = True
    return keep


def degeneracies(
    unknowns: Sequence[Unknown],
    which: NDArray[np.intp],
    held: NDArray[np.intp],
    data: F8,
    slope: F8,
    u: F8,
    *,
    named: float = WIDER,
) -> Degeneracies:
    """Return degeneracies between the fixed unknowns ``held`` and the fitted ones ``which``.

    ``data`` ``(k, k)`` and ``slope`` ``(k,)`` are matrix and gradient of data and priors in scales. ``u`` contains the
    values of the unknowns. ``named`` is the widening of a fitted unknown above which a fixed one is reported.

    A fixed unknown is included in the standard deviation of the fitted ones if it widens one of them by more than
    `WIDENING_COUNTED`. It is also included if its group is `assumed`. It must be determined to within `LARGEST_SIGMA`.
    Its error is that with which the patterns determine it.
    """
    assumed = {group.name for group in GROUPS if group.assumed}
    inner = data[np.ix_(which, which)]
    size = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    spread = np.linalg.pinv(inner / np.outer(size, size), rcond=1e-13, hermitian=True) / np.outer(size, size)
    sigmas = np.sqrt(np.maximum(np.diag(spread), 1e-300))
    found: list[tuple[float, str]] = []
    counted: list[int] = []
    for k in held.tolist():
        # how far each parameter moves for one step of it, and how well it is determined apart from them
        moves = spread @ data[which, k]
        left = float(data[k, k] - data[k, which] @ moves)
        if left <= 1e-9 * data[k, k]:
            left = 1e-9 * float(data[k, k])
        wider = np.sqrt(1.0 + np.square(moves / sigmas) / left)
        if (wider.max() > WIDENING_COUNTED or unknowns[k].group in assumed) and left > LARGEST_SIGMA**-2:
            counted.append(k)
        order = [int(j) for j in np.argsort(-wider) if wider[j] > named][:MOST_NAMED]
        if not order:
            continue
        parts = []
        for j in order:
            one = unknowns[which[j]]
            now, then = (one.sigma_of(float(u[which[j]]), float(s)) for s in (sigmas[j], sigmas[j] * wider[j]))
            parts.append(f"{one.name} (± {now:.2g} would be ± {then:.2g} {one.unit}".rstrip() + ")")
        own = unknowns[k]
        value = f"{own.value(float(u[k])):.6g} {own.unit}".rstrip()
        found.append((float(wider[order[0]]), f"{own.name}, fixed at {value}, with {', '.join(parts)}"))
    words = tuple(words for _, words in sorted(found, reverse=True))
    return Degeneracies(words, *_allowed(which, np.array(counted, np.intp), data, slope, spread), tuple(counted))


def _allowed(which: NDArray[np.intp], held: NDArray[np.intp], data: F8, slope: F8, spread: F8) -> tuple[F8, F8]:
    """Return the covariance and shift of the fitted unknowns due to errors of all unknowns ``held``."""
    if not len(held):
        return np.zeros_like(spread), np.zeros(len(which))
    moves = spread @ data[np.ix_(which, held)]
    precision = data[np.ix_(held, held)] - data[np.ix_(held, which)] @ moves
    size = np.sqrt(np.maximum(np.diag(precision), 1e-300))
    errors = np.linalg.pinv(precision / np.outer(size, size), rcond=1e-9, hermitian=True) / np.outer(size, size)
    off = errors @ (slope[held] - moves.T @ slope[which])
    # the fitted ones move back by the share that was due to it
    return moves @ errors @ moves.T, -moves @ off


# -- numbers of the fit
# ------------------------------------------------------------------------------------------------

UNIDENTIFIED_SIGMA = 1.0
"""Standard deviation, in scales of the unknowns, above which a combination is not determined."""

LEAST_COMPONENT = 0.3
"""Fraction of a combination above which an unknown is listed."""


def unidentified(unknowns: Sequence[Unknown], data: F8) -> tuple[str, ...]:
    """Return the combinations of unknowns that the data alone do not determine, the least certain first.

    They are the eigenvectors with small eigenvalues of ``data`` ``(k, k)``, the matrix of the data in scales, with
    everything else eliminated.
    """
    values, vectors = np.linalg.eigh(data)
    found = []
    for value, vector in zip(values, vectors.T, strict=True):
        sigma = math.inf if value <= 0 else 1.0 / math.sqrt(value)
        if sigma < UNIDENTIFIED_SIGMA:
            break
        parts = [(abs(v), one.name) for v, one in zip(vector, unknowns, strict=True) if abs(v) > LEAST_COMPONENT]
        names = [name for _, name in sorted(parts, reverse=True)]
        found.append(
            " with ".join(names) if len(names) > 1 else names[0] if names else "a combination of many parameters"
        )
    return tuple(found)


def summarised(
    problem: Problem,
    point: Point,
    columns: Columns,
    *,
    groups: Sequence[str],
    tried: Sequence[str],
    outliers: tuple[Outlier, ...],
    untried: Degeneracies | None = None,
) -> tuple[Fit, ...]:
    """Return the result of the fit at a point for each region of the field; ``columns`` are the latest derivatives.

    ``untried`` lists unknowns that were not tried, but may explain the same changes.
    """
    vector = problem.vector
    which = vector.of_groups(groups)
    unknowns = [vector.unknowns[k] for k in which]
    spread, data = covariance(problem, point, columns, which)
    chi2 = chi_square(point, problem.fitted, len(which))
    # if the model is incomplete, its unknowns are less certain by the same factor
    grown = math.sqrt(max(1.0, chi2.lit)) if not chi2.complete else 1.0
    alone = grown * np.sqrt(np.maximum(np.diag(spread)[: len(which)], 0.0))
    held = degeneracies_of(problem, point, columns, which)
    if untried is not None:
        held = held.with_others(untried)
    sigmas = np.sqrt(held.variances(spread[: len(which), : len(which)], grown))
    parameters = {
        one.name: Parameter(
            one.name,
            one.group,
            one.unit,
            one.value(float(point.u[k])),
            one.sigma_of(float(point.u[k]), float(sigma)),
            one.start,
            one.sigma_of(float(point.u[k]), float(own)),
        )
        for k, one, sigma, own in zip(which, unknowns, sigmas, alone, strict=True)
    }
    size = np.sqrt(np.maximum(np.diag(spread)[: len(which)], 1e-300))
    measured, nz = problem.measured, problem.measured.plan.shape[0]
    images = measured.images(point.seen.residual)
    setup = vector.setup_at(point.u)
    order = order_of_types(measured.plan.camera, setup.camera)
    whole = Fit(
        setup=setup,
        planned=measured.plan,
        parameters=parameters,
        groups=tuple(groups),
        unhelpful=tuple(
            name for name in tried if name not in groups and not GROUPS.get(name).held and vector.of_groups([name]).size
        ),
        chi_square=chi2,
        held_out_error=held_out_error(problem, point, columns, which, grown**2 * spread, complete=chi2.complete),
        correlations=spread[: len(which), : len(which)] / np.outer(size, size),
        held=tuple(dict.fromkeys(one.gauge for one in unknowns if one.gauge)),
        unidentified=(*unidentified(unknowns, data), *held.words),
        outliers=outliers,
        answers={"order of lens types": f"{order} of the description"} if order else {},
        spread=Spread(point.local.stage_px, point.local.lamp, point.local.response.rms),
        levels=point.levels,
        residuals={},
    )
    found = []
    for plan, own, k in measured.parts():
        planes = slice(k * nz, (k + 1) * nz)
        light = PatternLevels(point.levels.gains[planes], point.levels.backgrounds[planes], point.levels.lamps[own])
        places = [(int(z), int(y), int(x)) for z, y, x in measured.index[own]]
        here = None
        if len(measured.plans) > 1:
            among = np.zeros(len(measured), np.bool_)
            among[own] = True
            fitted = among & problem.fitted
            # each region has its part of the common result
            share = round(len(which) * fitted.sum() / max(1, problem.fitted.sum()))
            chi2 = chi_square(point, fitted, share)
            error = held_out_error(problem, point, columns, which, grown**2 * spread, among, complete=chi2.complete)
            here = InRegion(chi2, error)
        found.append(
            replace(
                whole,
                setup=setup.of_region(k),
                planned=plan,
                outliers=tuple(one for one in outliers if one.region == k),
                levels=light.between(np.unique(measured.index[own, 0]), plan.depths_um),
                residuals=dict(zip(places, images[own], strict=True)),
                here=here,
            )
        )
    return tuple(found)
