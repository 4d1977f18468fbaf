"""Measurements in an image: histogram, line profile with its width, region. Pure functions, no Qt."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal_gui.models.display import above

MOST = 1 << 17
"""Largest number of values sampled from a large image for a histogram, so that the window stays responsive."""

Place = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Profile:
    """Values along a line: ``distance`` from its start (px), ``values``, and ``fwhm`` (px), as returned by `fwhm`."""

    distance: NDArray[np.float64]
    values: NDArray[np.float64]
    fwhm: float | None

    def words(self) -> str:
        """Return length and width as text."""
        width = "no peak on the line" if self.fwhm is None else f"FWHM {self.fwhm:.2f} px"
        return f"{self.distance[-1]:.1f} px long, {width}"


def line_profile(image: NDArray[Any], first: Place, last: Place) -> Profile:
    """Return the values from ``first`` to ``last`` (row, column), one per pixel, interpolated linearly.

    Values outside ``image`` are not-a-number.
    """
    from scipy.ndimage import map_coordinates

    length = math.dist(first, last)
    steps = max(2, math.ceil(length) + 1)
    places = np.linspace(first, last, steps).T
    values = map_coordinates(image, places, np.float64, order=1, mode="constant", cval=math.nan, prefilter=False)
    distance = np.linspace(0.0, length, steps)
    return Profile(distance, values, fwhm(distance, values))


def fwhm(distance: NDArray[np.float64], values: NDArray[np.float64]) -> float | None:
    """Return the full width at half maximum of the highest peak above the lowest value.

    Values are interpolated linearly. The result is None if one side of the peak does not fall to half on the line.
    """
    known = np.isfinite(values)
    x, y = distance[known], values[known]
    if len(y) < 3 or y.max() <= y.min():
        return None
    half, peak = (float(y.max()) + float(y.min())) / 2, int(np.argmax(y))
    below = np.flatnonzero(y <= half)
    left, right = below[below < peak], below[below > peak]
    if not len(left) or not len(right):
        return None

    def crossing(low: int, high: int) -> float:
        return float(x[low] + (half - y[low]) / (y[high] - y[low]) * (x[high] - x[low]))

    return crossing(int(right[0]), int(right[0]) - 1) - crossing(int(left[-1]), int(left[-1]) + 1)


@dataclass(frozen=True)
class RegionNumbers:
    """Statistics of a rectangle.

    Attributes
    ----------
    rows, columns
        First index, and last index plus one.
    mean, deviation, low, high, total
        Mean, standard deviation, smallest, largest and sum of the values.
    centre
        Centroid (row, column) of the values minus the smallest one; None if all are equal.
    """

    rows: tuple[int, int]
    columns: tuple[int, int]
    mean: float
    deviation: float
    low: float
    high: float
    total: float
    centre: Place | None

    def words(self, quantity: str) -> str:
        """Return the statistics of ``quantity`` (with its unit) as text, one item per line."""
        height, width = self.rows[1] - self.rows[0], self.columns[1] - self.columns[0]
        lines = [
            f"{width} × {height} px, rows {self.rows[0]} to {self.rows[1] - 1}, "
            f"columns {self.columns[0]} to {self.columns[1] - 1}",
            f"{quantity}: mean {self.mean:.5g}, standard deviation {self.deviation:.4g}",
            f"smallest {self.low:.5g}, largest {self.high:.5g}, sum {self.total:.6g}",
        ]
        if self.centre is not None:
            lines.append(f"centroid row {self.centre[0]:.2f}, column {self.centre[1]:.2f}")
        return "\n".join(lines)


def region_numbers(
    image: NDArray[Any], rows: tuple[float, float], columns: tuple[float, float]
) -> RegionNumbers | None:
    """Return statistics of the pixels whose centres are within ``rows`` and ``columns``; None if there are none."""
    (top, bottom), (left, right) = (
        (max(0, math.ceil(low)), min(n, math.floor(high) + 1))
        for (low, high), n in zip((rows, columns), image.shape, strict=True)
    )
    if bottom <= top or right <= left:
        return None
    part = np.asarray(image[top:bottom, left:right], np.float64)
    known = part[np.isfinite(part)]
    if not len(known):
        return None
    light = np.nan_to_num(part - known.min(), nan=0.0, posinf=0.0, neginf=0.0)
    centre = None
    if light.sum() > 0:
        r, c = np.arange(top, bottom), np.arange(left, right)
        centre = float(light.sum(1) @ r / light.sum()), float(light.sum(0) @ c / light.sum())
    low, high = float(known.min()), float(known.max())
    return RegionNumbers(
        (top, bottom), (left, right), float(known.mean()), float(known.std()), low, high, float(known.sum()), centre
    )


def sampled(image: NDArray[Any]) -> NDArray[np.float64]:
    """Return the finite values of every n-th row and column, at most `MOST` of them."""
    step = max(1, math.ceil(math.sqrt(image.size / MOST)))
    values = np.asarray(image[::step, ::step], np.float64)
    return values[np.isfinite(values)]


def value_histogram(image: NDArray[Any], bins: int = 200) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Return the centres of the bins, and the number of values of `sampled` in each bin."""
    values = sampled(image)
    if not len(values):
        return np.zeros(0), np.zeros(0, np.intp)
    low, high = float(values.min()), float(values.max())
    span = high - low or above(low) - low
    # not of the values themselves: bins of large ones that hardly differ have no width
    counts, edges = np.histogram((values - low) / span, bins, (0.0, 1.0))
    return low + span * (edges[:-1] + edges[1:]) / 2, counts
