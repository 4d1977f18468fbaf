"""Residuals of patterns relative to their camera, accumulated at their positions on the sensor."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from lfcal.judge.evidence import Evidence

__all__ = ["Lines", "SensorMap", "sensor_map"]

F8 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Lines:
    """Offsets and gains of lines ``(n,)`` or pixels ``(rows, columns)`` of the sensor.

    Attributes
    ----------
    offset, offset_sigma
        Counts added to the light, and their standard deviation; infinite if nothing was measured.
    gain, gain_sigma
        Relative change of the light, and its standard deviation.
    """

    offset: F8
    offset_sigma: F8
    gain: F8
    gain_sigma: F8


@dataclass(frozen=True, eq=False)
class SensorMap:
    """Sums over all patterns at each sensor pixel that cutouts cover ``(rows, columns)``.

    Attributes
    ----------
    residual, weight
        Sum of the residual divided by its variance, and of 1/variance.
    by_light, light
        Sum of the residual times the light divided by the variance, and of the squared light divided by it.
    mixed
        Sum of the light divided by the variance.
    """

    residual: F8
    weight: F8
    by_light: F8
    light: F8
    mixed: F8

    def lines(self, axis: int) -> Lines:
        """Return offsets and gains of rows (0) or columns (1)."""
        return _reported(*(part.sum(1 - axis) for part in self._parts))

    def pixels(self) -> Lines:
        """Return the offsets and gains of single pixels ``(rows, columns)``."""
        return _reported(*self._parts)

    def classes(self, rows: int, columns: int) -> Lines:
        """Return the offsets and gains of pixels with equal positions modulo rows and columns, ``(rows, columns)``."""
        every = [(i, j) for i in range(rows) for j in range(columns)]
        sums = [np.array([p[i::rows, j::columns].sum() for i, j in every]).reshape(rows, columns) for p in self._parts]
        return _reported(*sums)

    @property
    def _parts(self) -> tuple[F8, ...]:
        return self.residual, self.weight, self.by_light, self.light, self.mixed


def _reported(residual: F8, weight: F8, by_light: F8, light: F8, mixed: F8) -> Lines:
    """Solve for offset and gain together, which are hard to distinguish where there is little light."""
    inside = weight * light - mixed**2
    good = inside > 1e-9 * weight * light
    one = np.where(good, inside, 1.0)
    alone = (weight > 0) & ~good  # without light, only an offset can be determined
    some = np.where(weight > 0, weight, 1.0)
    offset = np.where(good, (light * residual - mixed * by_light) / one, np.where(alone, residual / some, 0.0))
    gain = np.where(good, (weight * by_light - mixed * residual) / one, 0.0)
    offset_sigma = np.where(good, np.sqrt(light / one), np.where(alone, 1 / np.sqrt(some), np.inf))
    return Lines(offset, offset_sigma, gain, np.where(good, np.sqrt(weight / one), np.inf))


@lru_cache(maxsize=1)
def sensor_map(evidence: Evidence) -> SensorMap:
    """Return the sums of the residuals of patterns relative to their best fit."""
    ny, nx = evidence.plan.period
    nt, ns = evidence.plan.cutout
    maps = np.zeros((5, ny + nt - 1, nx + ns - 1))
    left, weight, light = evidence.left, evidence.weight, evidence.light
    for k, (row, column) in enumerate(evidence.corners().tolist()):
        place = slice(row, row + nt), slice(column, column + ns)
        w, v, r = (part[k].astype(np.float64) for part in (weight, light, left))
        for target, part in zip(maps, (w * r, w, w * r * v, w * v * v, w * v), strict=True):
            target[place] += part
    return SensorMap(*maps)
