"""What is held as described and would change what was found, were it found too: one stands in for the other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lfcal.fit.judge import eliminated
from lfcal.fit.normal import Columns
from lfcal.fit.parameters import Unknown
from lfcal.fit.problem import Point, Problem
from lfcal.fit.solver import with_prior

__all__ = ["stand_ins", "standing_in"]

F8 = NDArray[np.float64]

WIDER = 8.0
"""How many times larger the standard deviation of what was found would be, for it to be named."""

NAMED = 3
"""Parameters that are named of what one unknown would change."""


def standing_in(problem: Problem, point: Point, columns: Columns, which: NDArray[np.intp]) -> tuple[str, ...]:
    """Return what of the unknowns that were tried, but not found, those found at ``which`` stand in for.

    The scan may show that something changed without telling which of them did. ``columns`` has the derivatives by all.
    """
    normal = problem.normal(columns, point, problem.fitted)
    matrix, _ = with_prior(problem, normal, point.u)
    k = len(problem.vector)
    held = np.array([j for j in range(k) if j not in which and normal.matrix[j, j] > 0], np.intp)
    unknowns = problem.vector.unknowns
    return stand_ins(unknowns, which, held, eliminated(matrix, k), point.u)


def stand_ins(
    unknowns: Sequence[Unknown], which: NDArray[np.intp], held: NDArray[np.intp], data: F8, u: F8
) -> tuple[str, ...]:
    """Return in words which of the unknowns ``held`` stand behind those found at ``which``, the worst first.

    ``data`` ``(k, k)`` is the matrix of the data and priors in scales, ``u`` where the unknowns are.
    """
    inner = data[np.ix_(which, which)]
    size = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    spread = np.linalg.pinv(inner / np.outer(size, size), rcond=1e-13, hermitian=True) / np.outer(size, size)
    sigmas = np.sqrt(np.maximum(np.diag(spread), 1e-300))
    found: list[tuple[float, str]] = []
    for k in held.tolist():
        # by how much each parameter moves for a step of it, and how well it is told beside them
        moves = spread @ data[which, k]
        left = float(data[k, k] - data[k, which] @ moves)
        if left <= 1e-9 * data[k, k]:
            left = 1e-9 * float(data[k, k])
        wider = np.sqrt(1.0 + np.square(moves / sigmas) / left)
        order = [int(j) for j in np.argsort(-wider) if wider[j] > WIDER][:NAMED]
        if not order:
            continue
        parts = []
        for j in order:
            one = unknowns[which[j]]
            now, then = (one.sigma_of(float(u[which[j]]), float(s)) for s in (sigmas[j], sigmas[j] * wider[j]))
            parts.append(f"{one.name} (± {now:.2g} would be ± {then:.2g} {one.unit}".rstrip() + ")")
        own = unknowns[k]
        value = f"{own.value(float(u[k])):.6g} {own.unit}".rstrip()
        found.append((float(wider[order[0]]), f"{own.name}, held at {value}, with {', '.join(parts)}"))
    return tuple(words for _, words in sorted(found, reverse=True))
