"""Levenberg-Marquardt algorithm for weighted patterns: choice of steps, and stopping rule."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, Progress, Work
from lfcal.fit.normal import Columns, Normal
from lfcal.fit.problem import Point, Problem
from lfcal.simulate.engines import EnergyError

__all__ = ["RoundRecorder", "descend", "solve", "stepped"]

LONGEST = 5.0
"""Longest step of an unknown, in its scales."""

STEPS = 4
"""Largest number of steps with the same derivatives."""

TRIES = 5
"""Number of dampings that are tried before a step is abandoned."""

F8 = NDArray[np.float64]

RoundRecorder = Callable[[Problem, Point, str], Progress]
"""Function that creates the progress record of a round from problem, point and name of the stage."""


def solve(matrix: F8, gradient: F8) -> F8:
    """Return the solution d of N d = g for N = ``matrix`` and g = ``gradient``.

    N is positive semidefinite. Its unknowns may differ in scale, and components of d that N does not determine are 0.
    """
    size = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    known = size > 0
    out = np.zeros_like(gradient)
    scaled = matrix[np.ix_(known, known)] / np.outer(size[known], size[known])
    # eigenvectors on which no pattern has information are not changed
    values, vectors = np.linalg.eigh(scaled)
    good = values > 1e-12 * values.max(initial=0.0)
    part = vectors[:, good].T @ (gradient[known] / size[known])
    out[known] = vectors[:, good] @ (part / values[good]) / size[known]
    return out


def shared_of(problem: Problem, which: Sequence[int] | NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the indices, in the normal equations, of the unknowns ``which`` and of all gains and backgrounds."""
    k = len(problem.vector)
    levels = np.arange(k, k + 2 * problem.measured.levels)
    return np.concatenate([np.asarray(which, np.intp), levels])


def with_prior(problem: Problem, normal: Normal, u: F8) -> tuple[F8, F8]:
    """Return the matrix and gradient of ``normal`` at ``u``, including the priors of the unknowns."""
    precision, _ = problem.vector.prior()
    matrix, gradient = normal.matrix.copy(), normal.gradient.copy()
    k = len(precision)
    matrix[np.arange(k), np.arange(k)] += precision
    gradient[:k] -= precision * u
    return matrix, gradient


def stepped(
    problem: Problem, point: Point, columns: Columns, which: Sequence[int], damping: float
) -> tuple[Point, float, float]:
    """Return the first point that is better than ``point``, the next damping, and the decrease of the loss.

    The unknowns ``which`` (indices) change. ``damping`` is that of the first trial; it is raised after every trial that
    is not better. If no better point is found in five trials, ``point`` and a decrease of 0 are returned.
    """
    normal = problem.normal(columns, point, problem.fitted)
    matrix, gradient = with_prior(problem, normal, point.u)
    used = shared_of(problem, which)
    inner, slope = matrix[np.ix_(used, used)], gradient[used]
    before = problem.cost(point)
    for _ in range(TRIES):
        damped = inner + damping * np.diag(np.diag(inner))
        step = solve(damped, slope)
        trial = moved(problem, point, normal, used, step, len(which))
        better = before - problem.cost(trial, point) if trial is not None else -1.0
        if trial is not None and better > 0:
            return trial, max(1e-6, damping / 6), better
        damping = max(1e-4, damping) * 6
    return point, damping, 0.0


def moved(problem: Problem, point: Point, normal: Normal, used: NDArray[np.intp], step: F8, count: int) -> Point | None:
    """Return the point after a step; None if its camera is impossible or cannot be computed.

    ``used`` contains the indices of ``step`` in the normal equations: first ``count`` unknowns, then gains and
    backgrounds. If the step changes an unknown by more than `LONGEST` scales, the whole step is shortened. The unknowns
    of single patterns are updated as well.
    """
    longest = float(np.abs(step[:count]).max(initial=0.0))
    step = step * min(1.0, LONGEST / longest) if longest > 0 else step
    u = point.u.copy()
    u[used[:count]] += step[:count]
    u = problem.vector.clipped(u)
    whole = np.zeros(len(normal.gradient))
    whole[used] = step
    local, lamps = point.local, point.levels.lamps.copy()
    offsets = local.offsets_px.copy()
    for p, (cb, ch) in zip(np.flatnonzero(problem.fitted).tolist(), normal.solved, strict=True):
        own = ch - cb @ whole
        if local.stage_px > 0:
            offsets[p] = np.clip(offsets[p] + own[:2], -8 * local.stage_px, 8 * local.stage_px)
        if local.lamp > 0:
            lamps[p] = np.clip(lamps[p] + own[-1], -0.9, 9.0)
    try:
        found = replace(local, offsets_px=offsets)
        return problem.point(u, found, point.sampling, lamps=lamps, doubtful=point.doubtful)
    except (InputError, EnergyError):
        return None


def descend(
    problem: Problem,
    point: Point,
    which: Sequence[int],
    note: str,
    *,
    most: int = 8,
    enough: float = 1e-3,
    columns: Columns | None = None,
    record_round: RoundRecorder | None = None,
) -> Work[tuple[Point, Columns]]:
    """Return the point reached by descending, and the last derivatives.

    There are at most ``most`` rounds; the last one is the first that lowers the loss by less than the fraction
    ``enough``. Of the shared unknowns, only those with the indices ``which`` change. ``columns`` are the derivatives
    for the first round, if known. Progress counts derivatives and shows ``note``; the result of ``record_round`` is
    yielded at the end of each round.
    """
    damping, known = 1e-3, columns
    for turn in range(most):
        if known is None or turn:
            displaced = point.local.stage_px > 0
            known = yield from problem.columns(point, which, f"{note}, round {turn + 1}", displaced=displaced)
        before, better = problem.cost(point), 0.0
        # derivatives stay valid for a few smaller steps
        for _ in range(STEPS):
            point, damping, gained = stepped(problem, point, known, which, damping)
            better += gained
            if gained < max(enough * before, 0.05 * better):
                break
        if record_round is not None:
            yield record_round(problem, point, f"{note}, round {turn + 1}")
        if better < enough * before:
            break
    assert known is not None
    return point, known
