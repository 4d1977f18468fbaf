"""Depth by views: the plane on which they agree at each sample of the central view."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, Work, for_each_chunk
from lfcal.lattice._depth_kernels import Matching, match_views, sweep_rows
from lfcal.lattice._depth_map import FLOOR, METHODS, DepthMap, confidence_of, supported

__all__ = ["MovedViews", "iter_swept", "map_of_views", "planes_between"]

Image = NDArray[np.float32]
Array = NDArray[np.float64]

VIEW_STEP = 0.2
"""Step of the shift of the outermost views (samples)."""

SHARED = 2.0
"""Number of samples of interpolated views that share the noise of one."""

BIAS = 0.03
"""Systematic error of the disparity due to interpolation, added to the standard error (samples)."""

MIN_VIEWS = 5
"""Smallest number of views that are compared at a sample, if there are as many."""

BAND_BYTES = 1 << 28
"""Memory for the planes of the rows that are processed together (bytes)."""


class MovedViews(NamedTuple):
    """Views, and their displacements from the central view.

    ``light`` ``(n, rows, columns)`` contains the views, and ``good`` the weight of each sample: the inverse of its
    noise variance, or 0 if the sample is not used. A point on the plane of slope w that is at S in the central view is
    at ``S + fixed[k] + w * moves[k]`` in view k. ``moves`` and ``fixed``, ``(n, 2)``, are in samples (row, column).
    """

    light: Image
    good: Image
    moves: Array
    fixed: Array


def planes_between(low: float, high: float, shift: float) -> Array:
    """Return slopes at equal steps, one step beyond the range at both ends.

    ``shift`` is the disparity (samples) between the outermost and the central view at a slope of 1.
    """
    step = VIEW_STEP / shift
    return np.arange(low - step, high + 1.5 * step, step)


def iter_swept(views: MovedViews, planes: Array, half: int, workers: int | None) -> Work[Image]:
    """Return the slope at which the views agree best, and its error, ``(2, rows, columns)``; NaN if unknown.

    ``half`` is half the side of the windows (samples). Bands of rows limit the memory.
    """
    count, rows, columns = views.light.shape
    fewest = min(MIN_VIEWS, count)
    how = Matching(planes, np.ones((1, 3, 3), np.float32), half, 0.0, FLOOR**2, SHARED)
    found = np.full((2, rows, columns), np.nan, np.float32)
    band = max(16 * half, BAND_BYTES // (8 * len(planes) * columns))
    starts = range(0, rows, band)
    clock = Clock("compare views", len(planes) * len(starts))
    for number, first in enumerate(starts):
        last = min(first + band, rows)
        # windows extend beyond the band
        top, bottom = max(first - half, 0), min(last + half, rows)
        volume = np.zeros((len(planes), 2, bottom - top, columns), np.float32)
        for k, plane in enumerate(volume):
            _sweep(views, planes[k], plane, top, fewest, workers)
            _box(plane, half)
            yield clock.at(number * len(planes) + k + 1)
        _match(volume, how, found[:, top:bottom], (first - top, last - top), fewest, workers)
    return found


def _sweep(views: MovedViews, slope: float, out: Image, top: int, fewest: int, workers: int | None) -> None:
    """Compare rows of the views from ``top`` on one plane."""
    moves = views.fixed + slope * views.moves

    def sweep(a: int, b: int) -> None:
        sweep_rows(views.light, views.good, moves, out[:, a:b], (top + a, top + b), fewest)

    for_each_chunk(sweep, out.shape[1], workers)


def _box(sums: Image, half: int) -> None:
    """Replace both images by their sums over windows of side 2 half + 1."""
    from lfcal.base import cv2

    for one in sums:
        one[:] = cv2.boxFilter(one, -1, (2 * half + 1,) * 2, normalize=False, borderType=cv2.BORDER_CONSTANT)


def _match(volume: Image, how: Matching, found: Image, rows: tuple[int, int], fewest: int, workers: int | None) -> None:
    """Find the best plane in some rows of a band."""

    def match(a: int, b: int) -> None:
        match_views(volume, how, found, (rows[0] + a, rows[0] + b), fewest)

    for_each_chunk(match, rows[1] - rows[0], workers)


def map_of_views(
    found: Image,
    shift: float,
    seen: NDArray[np.bool_],
    image: Image,
    place: tuple[tuple[float, float], tuple[float, float]],
) -> DepthMap:
    """Return the depth map of the result of `iter_swept`.

    Parameters
    ----------
    found
        Slope and standard error ``(2, rows, columns)``.
    shift
        As in `planes_between`.
    seen, image
        Samples that the central view shows, and their light.
    place
        Position (row, column) of the first sample on the frame, and spacing of the samples (pixels).
    """
    error = np.hypot(found[1], np.float32(BIAS / shift))
    confidence = np.where(seen, confidence_of(error * np.float32(shift)), 0).astype(np.float32)
    return supported(DepthMap(found[0], error, confidence, image, METHODS[2], *place, shift))
