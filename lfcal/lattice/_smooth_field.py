"""A smooth surface over the field, fitted to values of single lenslets."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError

__all__ = ["SmoothField", "determined_degree", "fit_field"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, slots=True)
class SmoothField:
    """A polynomial of row and column, both scaled to [-1, 1] over the frame.

    Attributes
    ----------
    shape
        Rows and columns of the frame.
    powers
        ``(n, 2)``: powers of row and column of each term.
    terms
        ``(n,)``: coefficients.
    """

    shape: tuple[int, int]
    powers: NDArray[np.intp]
    terms: Array

    def at(self, row: ArrayLike, column: ArrayLike) -> Array:
        """Return the values at image points."""
        points = np.stack(np.broadcast_arrays(np.asarray(row, float), np.asarray(column, float)), axis=-1)
        values: Array = _matrix(points, self.shape, self.powers) @ self.terms
        return values

    def frame(self) -> NDArray[np.float32]:
        """Return the surface on every pixel, ``(rows, columns)`` float32."""
        # separable: powers of the row, coefficients, powers of the column
        degree = int(self.powers.max())
        grid = np.zeros((degree + 1, degree + 1))
        grid[self.powers[:, 0], self.powers[:, 1]] = self.terms
        rows, columns = ((2 * np.arange(n) / max(n - 1, 1) - 1)[:, None] ** np.arange(degree + 1) for n in self.shape)
        surface: NDArray[np.float32] = (rows @ grid).astype(np.float32) @ columns.T.astype(np.float32)
        return surface


def _matrix(points: Array, shape: tuple[int, int], powers: NDArray[np.intp]) -> Array:
    scaled = 2 * points / np.maximum(np.array(shape) - 1, 1) - 1
    product: Array = (scaled[..., None, 0] ** powers[:, 0]) * (scaled[..., None, 1] ** powers[:, 1])
    return product


POINTS_PER_TERM = 3


def determined_degree(count: int, degree: int = 4) -> int:
    """Return the largest degree of a polynomial, at most ``degree``, that ``count`` points determine."""
    while degree and count < POINTS_PER_TERM * (degree + 1) * (degree + 2) // 2:
        degree -= 1
    return degree


def fit_field(points: Array, values: Array, shape: tuple[int, int], degree: int = 4, rounds: int = 6) -> SmoothField:
    """Fit a polynomial, robust to outliers, to ``values`` at image points ``(n, 2)`` (row, column).

    Its degree is ``degree``, or less if there are fewer than three points per term.

    Raises
    ------
    InputError
        If there are fewer than three points.
    """
    if len(points) < POINTS_PER_TERM:
        raise InputError.expected(
            "lenslets for a smooth field", f"at least {POINTS_PER_TERM}", len(points), "use a larger part of the frame"
        )
    degree = determined_degree(len(points), degree)
    powers = np.array([(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)], np.intp)
    matrix = _matrix(points, shape, powers)
    weight: Array = np.ones(len(values))
    terms: Array = np.zeros(len(powers))
    for _ in range(rounds):
        # much faster than an SVD of all points, and as accurate for few powers of coordinates within [-1, 1]
        heavy = matrix * (weight**2)[:, None]
        terms = np.asarray(np.linalg.lstsq(heavy.T @ matrix, heavy.T @ values, rcond=None)[0], np.float64)
        distance = np.abs(values - matrix @ terms)
        sigma = max(1.4826 * float(np.median(distance)), 1e-12 * float(np.abs(values).max()), math.ulp(0.0))
        # Tukey's biweight: distant outliers, such as dead lenslets, get no weight
        weight = np.asarray(np.maximum(1 - (distance / (4.7 * sigma)) ** 2, 0.0), np.float64)
    return SmoothField(shape, powers, terms)
