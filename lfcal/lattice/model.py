"""A lattice of five numbers, and its robust fit to measured places."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["LatticeModel", "fit_model", "free_shear", "neighbour_median"]

Array = NDArray[np.float64]
HUBER = 1.5
"""Residuals beyond this many standard deviations are weighed down."""


@dataclass(frozen=True, eq=False, slots=True)
class LatticeModel:
    """Square or hexagonal lattice: origin, vector along a row, and row pitch over pitch.

    Attributes
    ----------
    kind
        ``"square"`` or ``"hexagonal"``.
    origin, along
        Origin and vector to the next lenslet of the row, as (x, y) (pixels).
    ratio
        Row pitch over pitch.
    """

    kind: str
    origin: Array
    along: Array
    ratio: float

    @classmethod
    def of(cls, kind: str, basis: Array, origin: Array) -> LatticeModel:
        """Return the model nearest to lattice vectors ``basis`` (rows, x and y)."""
        along = basis[0]
        length = float(np.linalg.norm(along))
        across = (along[0] * basis[1, 1] - along[1] * basis[1, 0]) / length
        return cls(kind, np.asarray(origin, float), along, float(across / length))

    @property
    def pitch(self) -> float:
        """Distance of neighbours along a row (pixels)."""
        return float(np.linalg.norm(self.along))

    @property
    def row_pitch(self) -> float:
        """Distance of neighbouring rows (pixels)."""
        return self.ratio * self.pitch

    @property
    def rotation(self) -> float:
        """Angle of the rows from +x towards +y (rad)."""
        return math.atan2(self.along[1], self.along[0])

    @property
    def lean(self) -> float:
        """How far the next row is shifted along, in pitches: 1/2 for a hexagonal lattice."""
        return 0.5 if self.kind == "hexagonal" else 0.0

    def basis(self) -> Array:
        """Return the lattice vectors as rows (x, y)."""
        normal = np.array([-self.along[1], self.along[0]])
        return np.stack([self.along, self.lean * self.along + self.ratio * normal])

    def places(self, index: NDArray[np.intp]) -> Array:
        """Return places ``(n, 2)`` as (x, y) of lattice indices (q, r)."""
        result: Array = index @ self.basis() + self.origin
        return result

    def moved(self, by: Array) -> LatticeModel:
        """Return the lattice shifted by (x, y)."""
        return LatticeModel(self.kind, self.origin + by, self.along, self.ratio)

    def centred_on(self, point: Array) -> LatticeModel:
        """Return the same lattice counted from the lenslet nearest to ``point``."""
        index = np.rint((point - self.origin) @ np.linalg.inv(self.basis())).astype(np.intp)
        return LatticeModel(self.kind, self.places(index), self.along, self.ratio)

    def within(self, shape: tuple[int, int], margin: float) -> NDArray[np.intp]:
        """Return the indices (q, r) of all lenslets at least ``margin`` pixels inside a frame of ``shape``."""
        far = np.array([shape[1] - 1, shape[0] - 1], float)
        corners = np.array([(x, y) for x in (0.0, far[0]) for y in (0.0, far[1])])
        index = (corners - self.origin) @ np.linalg.inv(self.basis())
        low, high = np.floor(index.min(0)).astype(int), np.ceil(index.max(0)).astype(int)
        q, r = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
        every = np.stack([q.ravel(), r.ravel()], axis=-1)
        places = self.places(every)
        inside: NDArray[np.intp] = every[((places >= margin) & (places <= far - margin)).all(1)]
        return inside


def fit_model(
    model: LatticeModel, index: NDArray[np.intp], places: Array, rounds: int = 8
) -> tuple[LatticeModel, Array, float]:
    """Fit the lattice to measured ``places`` (x, y) with Huber weights (Gauss-Newton).

    Returns
    -------
    tuple
        The fitted lattice, the residuals ``(n, 2)`` and the standard error of the pitch (pixels).
    """
    q, r = index[:, 0].astype(float), index[:, 1].astype(float)
    error = math.inf
    for _ in range(rounds):
        residual = places - model.places(index)
        distance = np.hypot(*residual.T)
        # the median distance of a two-dimensional Gaussian is sigma sqrt(2 ln 2) = 1.1774 sigma
        sigma = max(float(np.median(distance)) / 1.1774, 1e-6)
        weight = np.minimum(1.0, HUBER / np.maximum(distance / sigma, 1e-9))
        across = model.lean * r + q
        up = model.ratio * r
        (ax, ay), one, zero = model.along, np.ones_like(q), np.zeros_like(q)
        jacobian = np.stack(
            [np.stack([one, zero, across, -up, -r * ay], axis=-1), np.stack([zero, one, up, across, r * ax], axis=-1)]
        ).reshape(-1, 5)
        # one weight for both axes: an outlier is a lenslet, not a coordinate
        heavy = np.concatenate([weight, weight])
        target = residual.T.ravel()
        normal = jacobian.T @ (heavy[:, None] * jacobian)
        step = np.linalg.solve(normal, jacobian.T @ (heavy * target))
        model = LatticeModel(model.kind, model.origin + step[:2], model.along + step[2:4], model.ratio + float(step[4]))
        unit = np.array([0, 0, *(model.along / model.pitch), 0])
        error = sigma * math.sqrt(float(unit @ np.linalg.solve(normal, unit)))
        if np.abs(step[2:4]).max() < 1e-9:
            break
    return model, places - model.places(index), error


def free_shear(model: LatticeModel, index: NDArray[np.intp], places: Array) -> float:
    """Return by how much the rows' angle to the columns departs from the ideal in a free affine fit (rad)."""
    matrix = np.column_stack([np.ones(len(index)), index])
    answer = np.linalg.lstsq(matrix, places, rcond=None)[0]
    along, across = answer[1], answer[2]
    length = float(np.linalg.norm(along))
    lean = float(across @ along) / length - model.lean * length
    height = float(along[0] * across[1] - along[1] * across[0]) / length
    return lean / height


def neighbour_median(index: NDArray[np.intp], values: Array, reach: int = 2) -> Array:
    """Return for each lenslet the median of ``values`` over the lenslets up to ``reach`` indices away."""
    place = index - index.min(0) + reach
    grid = np.full(place.max(0) + reach + 1, np.nan)
    grid[place[:, 0], place[:, 1]] = values
    steps = range(-reach, reach + 1)
    around = np.stack([grid[place[:, 0] + i, place[:, 1] + j] for i in steps for j in steps])
    around[:, ~np.isfinite(around).any(0)] = 0.0
    result: Array = np.nanmedian(around, axis=0)
    return result
