"""Combinations of unknowns that frames determine, and those that they do not, along which a fit must not move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Modes"]

F8 = NDArray[np.float64]

LEAST = 3.0
"""Least information about a mode, relative to that of the prior: the prior's standard deviation is then halved."""

SHARE = 0.3
"""Component of an unknown in a mode, relative to the largest, above which the mode is named after it."""


@dataclass(frozen=True, eq=False)
class Modes:
    """Uncorrelated combinations of unknowns, each measured in standard deviations of the prior.

    Attributes
    ----------
    values
        Information of the frames about each mode ``(k,)``.
    vectors
        Components ``(k, k)`` of the modes, one mode per column.
    root
        Square root of the prior precision of each unknown ``(k,)``.
    """

    values: F8
    vectors: F8
    root: F8

    @classmethod
    def of(cls, information: F8, precision: F8) -> Modes:
        """Return the modes of an information matrix ``(k, k)``, given the prior precisions ``(k,)``."""
        root = np.sqrt(precision)
        values, vectors = np.linalg.eigh(information / np.outer(root, root))
        return cls(values, vectors, root)

    @property
    def known(self) -> NDArray[np.bool_]:
        """Whether the frames determine each mode ``(k,)``."""
        return self.values >= LEAST

    def estimate(self, weighted: F8) -> F8:
        """Return the unknowns for a gradient of the score at 0, ``(k,)``; undetermined modes stay at 0."""
        along = self.vectors.T @ (weighted / self.root) / (self.values + 1)
        found: F8 = self.vectors @ np.where(self.known, along, 0.0) / self.root
        return found

    @property
    def covariance(self) -> F8:
        """Covariance of the unknowns ``(k, k)``; undetermined modes have that of the prior."""
        scaled = self.vectors / self.root[:, None]
        found: F8 = (scaled / np.where(self.known, self.values + 1, 1.0)) @ scaled.T
        return found

    def undetermined(self, names: Sequence[str]) -> tuple[tuple[str, ...], ...]:
        """Return the names of the unknowns in each undetermined mode."""
        found = []
        for column in np.abs(self.vectors.T[~self.known]):
            found.append(tuple(name for name, c in zip(names, column, strict=True) if c > SHARE * column.max()))
        return tuple(found)
