"""Lattice model of the fit: five or six parameters, with an optional distortion."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.base import check_number
from lfcal.camera import LatticeDistortion

__all__ = [
    "MIN_PITCH",
    "LatticeModel",
    "check_row_pitch",
    "class_light",
    "class_median",
    "neighbour_mean",
    "neighbour_median",
]

Array = NDArray[np.float64]

MIN_PITCH, MIN_ROW_PITCH = 4.0, 3.0
"""Smallest pitch along a row, and smallest distance of rows (pixels): hexagonal rows are 0.87 pitches apart."""


def check_row_pitch(row_pitch_px: float) -> None:
    """Raise `InputError` if rows are too close to be measured, written or read."""
    check_number("row_pitch_px", row_pitch_px, at_least=MIN_ROW_PITCH)


DIM_CLASS = 0.75
"""Smallest light of a class of lenslets, relative to the brightest class, for comparisons across classes."""

MAX_LIGHT = 3.0
"""Largest light of a lenslet, relative to its surroundings, that counts in the mean of its class."""

CLASS_REACH = 2
"""Number of lenslets on each side whose mean light normalises the light of a class."""


@dataclass(frozen=True, eq=False, slots=True)
class LatticeModel:
    """Square or hexagonal lattice: origin, vector along a row, row pitch over pitch, shear and distortion.

    Attributes
    ----------
    kind
        ``"square"`` or ``"hexagonal"``.
    origin, along
        Origin and vector to the next lenslet of the row, as (x, y) (pixels).
    ratio
        Row pitch over pitch.
    shear
        Additional shift of a row along itself, compared with the ideal lattice, in row pitches.
    distortion
        Displacement from the undistorted lattice (pixels), or None.
    """

    kind: str
    origin: Array
    along: Array
    ratio: float
    shear: float = 0.0
    distortion: LatticeDistortion | None = None

    @classmethod
    def of(cls, kind: str, basis: Array, origin: Array) -> LatticeModel:
        """Return the model nearest to lattice vectors ``basis`` (rows, x and y)."""
        along = basis[0]
        length = float(np.linalg.norm(along))
        across = (along[0] * basis[1, 1] - along[1] * basis[1, 0]) / length
        return cls(kind, np.asarray(origin, float), along, float(across / length))

    @property
    def pitch(self) -> float:
        """Distance between neighbours along a row (pixels)."""
        return float(np.linalg.norm(self.along))

    @property
    def row_pitch(self) -> float:
        """Distance between neighbouring rows (pixels)."""
        return self.ratio * self.pitch

    @property
    def rotation(self) -> float:
        """Angle of the rows from +x towards +y (rad)."""
        return math.atan2(self.along[1], self.along[0])

    @property
    def lean(self) -> float:
        """Shift of the next row along the rows, in pitches: 1/2 for a hexagonal lattice."""
        return 0.5 if self.kind == "hexagonal" else 0.0

    def basis(self) -> Array:
        """Return the basis vectors of the undistorted lattice as rows (x, y)."""
        normal = np.array([-self.along[1], self.along[0]])
        return np.stack([self.along, (self.lean + self.ratio * self.shear) * self.along + self.ratio * normal])

    def straight(self, index: NDArray[np.intp]) -> Array:
        """Return the positions ``(n, 2)`` as (x, y) of lattice indices (q, r) without distortion (pixels)."""
        result: Array = index @ self.basis() + self.origin
        return result

    def places(self, index: NDArray[np.intp]) -> Array:
        """Return the positions ``(n, 2)`` as (x, y) of lattice indices (q, r) (pixels)."""
        straight = self.straight(index)
        return straight if self.distortion is None else self.distortion.apply(straight)

    def indices(self, places: Array) -> Array:
        """Return the fractional lattice indices ``(..., 2)`` of positions (x, y), the inverse of `places`."""
        straight = places if self.distortion is None else self.distortion.invert(places)
        result: Array = (straight - self.origin) @ np.linalg.inv(self.basis())
        return result

    def moved(self, by: Array) -> LatticeModel:
        """Return the lattice shifted by (x, y)."""
        return replace(self, origin=self.origin + by)

    def centred_on(self, point: Array) -> LatticeModel:
        """Return the same lattice with index (0, 0) at the lenslet nearest to ``point``."""
        index = np.rint(self.indices(point)).astype(np.intp)
        return replace(self, origin=self.straight(index))

    def whole(self, shape: tuple[int, int]) -> NDArray[np.intp]:
        """Return the indices (q, r) of all lenslets that are completely in a frame of ``shape``."""
        return self.within(shape, 0.5 * max(self.pitch, self.row_pitch))

    def within(self, shape: tuple[int, int], margin: float) -> NDArray[np.intp]:
        """Return the indices (q, r) of all lenslets at least ``margin`` pixels inside a frame of ``shape``."""
        far = np.array([shape[1] - 1, shape[0] - 1], float)
        side = np.linspace(0, 1, 9)
        outline = np.array([(a, b) for a in side for b in (0, 1)] + [(a, b) for a in (0, 1) for b in side]) * far
        index = self.indices(outline)
        low, high = np.floor(index.min(0)).astype(int) - 1, np.ceil(index.max(0)).astype(int) + 1
        q, r = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
        every = np.stack([q.ravel(), r.ravel()], axis=-1)
        places = self.places(every)
        inside: NDArray[np.intp] = every[((places >= margin) & (places <= far - margin)).all(1)]
        return inside


def class_light(index: NDArray[np.intp], light: Array) -> Array:
    """Return the typical ``light`` ``(n,)`` of the class of each lenslet; NaN in ``light`` is left out.

    Coatings and polarisers may dim alternate rows, columns or diagonals, and focal lengths may dim one of three types.
    ``light`` is relative to the surroundings. Classes extend over the whole array, so an edge of the light does not
    form one.
    """
    usual = np.ones(len(light))
    for classes in (2 * (index[:, 0] % 2) + index[:, 1] % 2, (index[:, 0] - index[:, 1]) % 3):
        for one in np.unique(classes):
            mine = classes == one
            known = (light / usual)[mine & np.isfinite(light)]
            # a median would follow one half of a class divided by an object, a plain mean would follow one bright speck
            middle = float(np.clip(known, 0, MAX_LIGHT).mean()) if known.size else 1.0
            usual[mine] *= middle if middle > 0 else 1.0
    return usual


def class_median(index: NDArray[np.intp], values: Array) -> Array:
    """Return for each lenslet the median of ``values`` around it, corrected for differences between classes."""
    near = neighbour_mean(index, values, CLASS_REACH)
    usual = class_light(index, np.where(near > 0, values / np.where(near > 0, near, 1), np.nan))
    if usual.min() > DIM_CLASS * usual.max():
        return neighbour_median(index, values)
    return neighbour_median(index, values / usual) * usual


def neighbour_mean(index: NDArray[np.intp], values: Array, reach: int) -> Array:
    """Return for each lenslet the mean of ``values`` over the lenslets up to ``reach`` indices away."""
    return np.asarray(np.nanmean(_neighbours(index, values, reach), axis=-1))


def neighbour_median(index: NDArray[np.intp], values: Array, reach: int = 2) -> Array:
    """Return for each lenslet the median of ``values`` over the lenslets up to ``reach`` indices away."""
    around = _neighbours(index, values, reach)
    around[~np.isfinite(around)] = np.nan
    # sorting puts NaN last, and is much faster than numpy's nanmedian
    around.sort(axis=-1)
    count = np.isfinite(around).sum(axis=-1)
    middle = [np.take_along_axis(around, k[:, None], -1)[:, 0] for k in (np.maximum(count - 1, 0) // 2, count // 2)]
    result: Array = np.where(count > 0, (middle[0] + middle[1]) / 2, 0.0)
    return result


def _neighbours(index: NDArray[np.intp], values: Array, reach: int) -> Array:
    """Return ``values`` of the lenslets up to ``reach`` indices from each one ``(n, (2 reach + 1)²)``; NaN: none."""
    place = index - index.min(0) + reach
    grid = np.full(place.max(0) + reach + 1, np.nan)
    grid[place[:, 0], place[:, 1]] = values
    steps = range(-reach, reach + 1)
    return np.stack([grid[place[:, 0] + i, place[:, 1] + j] for i in steps for j in steps], axis=-1)
