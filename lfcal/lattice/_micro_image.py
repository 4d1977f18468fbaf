"""The mean micro-image of a white frame, and the position of each lenslet measured with it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, chunks, for_each_chunk, worker_count
from lfcal.lattice._kernels import Support, Template, WhiteLenslets, fold, lenslet_statistics, register

__all__ = ["LensletPlaces", "MicroImage", "light_of", "mean_micro_image", "place_lenslets"]

Array = NDArray[np.float64]
SAMPLES_PER_PIXEL = 4

SPREAD_PX = 0.35
"""Standard deviation (pixels) for spreading samples of the mean micro-image if centres cover a pixel evenly."""

STATISTICS_S, FIT_S = 6e-7, 5e-6
"""Processor time (s) per pixel of a kernel that is interpreted."""

RIPPLE = 0.005
"""Largest remaining modulation of the samples' weights at the pixel period, if centres have similar fractions."""


@dataclass(frozen=True, eq=False, slots=True)
class MicroImage:
    """Mean of all micro-images about their lattice points, scaled to a mean of 1.

    Attributes
    ----------
    table
        ``(n, n)``, `SAMPLES_PER_PIXEL` per pixel, lattice point in the middle.
    slopes
        Derivatives ``(2, n, n)`` along x and y (per pixel).
    radius
        Extent of the table in every direction (pixels).
    """

    table: Array
    slopes: Array
    radius: float

    def off_centre(self, support: Support) -> Array:
        """Return (x, y) from the lattice point to the point of best symmetry of the micro-image (px).

        The micro-image is fitted to its copy rotated by 180 degrees; the result is half the shift between them.

        Raises
        ------
        InputError
            If the micro-image is dark.
        """
        inside = self._inside(support)
        columns = [self.table, np.ones_like(self.table), *self.slopes]
        matrix = np.stack([column[inside] for column in columns], axis=-1)
        answer = np.linalg.lstsq(matrix, self.table[::-1, ::-1][inside], rcond=None)[0]
        if not answer[0]:
            raise InputError.expected("white image", "lit micro-images", "dark ones", "record an evenly lit surface")
        # rotated image = g T(u - d), d = -answer / g; the centre of symmetry lies at -d/2
        shift: Array = answer[2:] / answer[0] / 2
        return shift

    def draw(self, support: Support) -> float:
        """Return the apparent shift of a micro-image per relative gradient of light across it (pixels squared)."""
        inside = self._inside(support)
        n = self.table.shape[0]
        places = (np.arange(n) - n // 2) / SAMPLES_PER_PIXEL
        columns = [self.table, np.ones_like(self.table), *self.slopes]
        matrix = np.stack([column[inside] for column in columns], axis=-1)
        # as for locating a lenslet: g T - g d.grad T + b, fitted to T (1 + x)
        answer = np.linalg.lstsq(matrix, (self.table * (1 + places))[inside], rcond=None)[0]
        return -float(answer[2] / answer[0])

    def _inside(self, support: Support) -> NDArray[np.bool_]:
        n = self.table.shape[0]
        x = (np.arange(n) - n // 2) / SAMPLES_PER_PIXEL
        y = x[:, None]
        inside: NDArray[np.bool_] = support.xx * x * x + 2 * support.xy * x * y + support.yy * y * y <= 1
        return inside

    def symmetric(self) -> MicroImage:
        """Return the mean of the micro-image and its copy rotated by 180 degrees."""
        return _with_slopes((self.table + self.table[::-1, ::-1]) / 2, self.radius)


@dataclass(frozen=True, eq=False, slots=True)
class LensletPlaces:
    """Result of fitting the mean micro-image to each lenslet.

    Attributes
    ----------
    shifts
        ``(n, 2)`` as (x, y) from the lattice point (pixels); NaN if the lenslet cannot be located.
    gains
        Contrast relative to the mean micro-image.
    explained
        Fraction of the variance within the lenslet that the mean micro-image explains.
    """

    shifts: Array
    gains: Array
    explained: Array


def light_of(image: NDArray[np.float32], centres: Array, radius: float, workers: int | None = None) -> Array:
    """Return pixel count, sum and gradient energy ``(n, 3)`` within ``radius`` of each centre (x, y)."""
    result = np.empty((len(centres), 3))
    light = lenslet_statistics.for_work(STATISTICS_S * image.size)
    for_each_chunk(lambda a, b: light(image, centres, radius, result, a, b), len(centres), workers)
    return result


def mean_micro_image(
    image: NDArray[np.float32], centres: Array, scales: Array, radius: float, workers: int | None = None
) -> MicroImage:
    """Return the mean micro-image about ``centres`` (x, y), each divided by its scale (0: left out)."""
    side = 2 * math.ceil(radius) * SAMPLES_PER_PIXEL + 1
    parts = chunks(len(centres), worker_count(workers))
    sums = np.zeros((len(parts), 2, side, side))
    add = fold.for_work(FIT_S * image.size)

    def work(first: int, last: int) -> None:
        for k in range(first, last):
            add(image, WhiteLenslets(centres, radius, SAMPLES_PER_PIXEL), scales, sums[k], *parts[k])

    for_each_chunk(work, len(parts), workers)
    total, count = _spread(sums.sum(0), _spreads(centres[scales > 0]))
    table = np.where(count > 0, total / np.where(count > 0, count, 1), 0.0)
    return _with_slopes(table, radius)


def _spreads(centres: Array) -> Array:
    """Return the spread of samples (pixels; x, y): larger if all centres have similar fractions of a pixel.

    In this case, a micro-image is sampled once per pixel, and a smaller spread would cause steps. Spreading by sigma
    leaves R exp(-2 pi^2 sigma^2) of the modulation at the pixel period, where R is the agreement of the fractions.
    """
    alike = np.abs(np.exp(2j * np.pi * centres).mean(0)) if len(centres) else np.zeros(2)
    wide = np.sqrt(np.log(np.maximum(alike / RIPPLE, 1.0)) / (2 * np.pi**2))
    return np.maximum(wide, SPREAD_PX)


def _spread(sums: Array, pixels: Array) -> Array:
    """Smooth sums and counts alike by (x, y) ``pixels``, so that empty samples are filled from their neighbours."""
    from scipy import ndimage

    x, y = (SAMPLES_PER_PIXEL * pixels).tolist()
    spread: Array = ndimage.gaussian_filter(sums, (0, y, x))
    return spread


def _with_slopes(table: Array, radius: float) -> MicroImage:
    down, right = np.gradient(table, 1 / SAMPLES_PER_PIXEL)
    return MicroImage(np.ascontiguousarray(table), np.ascontiguousarray(np.stack([right, down])), radius)


def place_lenslets(
    image: NDArray[np.float32], centres: Array, micro: MicroImage, support: Support, workers: int | None = None
) -> LensletPlaces:
    """Fit shift and contrast of the mean micro-image to each lenslet within ``support`` of its lattice point."""
    out = np.empty((len(centres), 5))
    lenslets = WhiteLenslets(centres, support.radius, SAMPLES_PER_PIXEL)
    fitted = register.for_work(FIT_S * image.size)

    def work(a: int, b: int) -> None:
        fitted(image, lenslets, Template(micro.table, micro.slopes, support, np.empty((8, 4))), out, a, b)

    for_each_chunk(work, len(centres), workers)
    return LensletPlaces(out[:, :2].copy(), out[:, 2].copy(), out[:, 4].copy())
