"""A set of patterns that is chosen by what each adds to the expected accuracy of H."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.fit.information import Information

__all__ = ["Chosen", "choose"]

F8 = NDArray[np.float64]

PASSES = 4
"""How often every position is tried against all others."""


class Chosen:
    """What a changing set of patterns tells of the unknowns, gain and background of each plane eliminated.

    Parameters
    ----------
    told
        What each pattern tells, and what is wanted.
    """

    def __init__(self, told: Information) -> None:
        self._told = told
        self._planes = told.index[:, 0]
        k = len(told.unknowns)
        self._rows: list[int] = []
        self._sums = np.zeros((int(self._planes.max(initial=0)) + 1, k + 2, k + 2))
        self.matrix = told.prior

    @property
    def error(self) -> float:
        """Expected relative error (L2) of H."""
        return float(np.sqrt(self._squares(self.matrix[None])[0]))

    @property
    def covariance(self) -> F8:
        """Covariance of the unknowns ``(k, k)`` in scales."""
        found: F8 = _inverse(self.matrix[None])[0]
        return found

    def add(self, *rows: int) -> None:
        """Add patterns."""
        self._rows += rows
        self._summed({int(self._planes[row]) for row in rows})

    def remove(self, row: int) -> None:
        """Take a pattern away."""
        self._rows.remove(row)
        self._summed({int(self._planes[row])})

    def _summed(self, planes: set[int]) -> None:
        # sums are made anew: what subtraction would leave of an empty plane is rounding, and would count as much
        for z in planes:
            self._sums[z] = self._told.patterns[[row for row in self._rows if self._planes[row] == z]].sum(0)
        self.matrix = self._told.prior + _eliminated(self._sums).sum(0)

    def trials(self, rows: NDArray[np.intp]) -> F8:
        """Return the expected squared error of H with each of the patterns ``rows`` added alone."""
        z = self._planes[rows]
        before = _eliminated(self._sums)[z]
        after = _eliminated(self._sums[z] + self._told.patterns[rows])
        return self._squares(self.matrix + after - before)

    def _squares(self, matrices: F8) -> F8:
        found: F8 = np.einsum("nij,ji->n", _inverse(matrices), self._told.wanted)
        return np.maximum(found, 0.0)


def _eliminated(matrices: F8) -> F8:
    """Return matrices ``(..., k + 2, k + 2)`` with gain and background, the last two, eliminated ``(..., k, k)``."""
    k = matrices.shape[-1] - 2
    cross, level = matrices[..., :k, k:], matrices[..., k:, k:]
    size = np.sqrt(np.maximum(np.diagonal(level, axis1=-2, axis2=-1), 1e-300))
    scaled = level / (size[..., :, None] * size[..., None, :])
    scaled = np.where(np.isfinite(scaled), scaled, 0.0)
    inverse = np.linalg.pinv(scaled, rcond=1e-12, hermitian=True)
    part = cross / size[..., None, :]
    found: F8 = matrices[..., :k, :k] - part @ inverse @ np.swapaxes(part, -1, -2)
    return found


def _inverse(matrices: F8) -> F8:
    """Return the inverses of positive matrices ``(n, k, k)`` whose unknowns differ in size."""
    size = np.sqrt(np.diagonal(matrices, axis1=-2, axis2=-1))
    both = size[:, :, None] * size[:, None, :]
    found: F8 = np.linalg.inv(matrices / both) / both
    return found


def choose(told: Information, count: int, allowed: NDArray[np.intp]) -> list[int]:
    """Return ``count`` of the patterns ``allowed`` that lower the expected error of H most, the most useful first.

    Each next one is the best beside those before; then each is tried against all others until no exchange helps.
    """
    chosen, free = Chosen(told), np.asarray(allowed, np.intp)
    taken = _greedy(chosen, free, count)
    for _ in range(PASSES):
        if not _exchanged(chosen, free, taken):
            break
    for row in taken:
        chosen.remove(row)
    return _greedy(chosen, np.array(taken, np.intp), len(taken))


def _greedy(chosen: Chosen, free: NDArray[np.intp], count: int) -> list[int]:
    taken: list[int] = []
    for _ in range(min(count, len(free))):
        left = np.setdiff1d(free, taken)
        best = int(left[int(np.argmin(chosen.trials(left)))])
        chosen.add(best)
        taken.append(best)
    return taken


def _exchanged(chosen: Chosen, free: NDArray[np.intp], taken: list[int]) -> bool:
    """Exchange patterns for better ones, in place; return whether any was."""
    any_better = False
    for k, row in enumerate(taken):
        before = chosen.error**2
        chosen.remove(row)
        left = np.setdiff1d(free, taken)
        squares = chosen.trials(left) if len(left) else np.array([np.inf])
        best = int(np.argmin(squares))
        if squares[best] < before * (1 - 1e-6):
            taken[k], any_better = int(left[best]), True
        chosen.add(taken[k])
    return any_better
