"""Find points of light in a frame: the centroid and brightness of each point's micro-images."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError

__all__ = ["Spots", "dark_level", "find_spots"]

Array = NDArray[np.float64]

ABOVE = 6.0
"""Threshold for a point, in standard deviations of smoothed dark pixels."""

DIM = 0.05
"""Smallest light of a point, relative to a typical one; tails of neighbours have less."""

ROUNDS = 4
"""Number of centroid steps, each about the previous centroid."""


@dataclass(frozen=True, eq=False)
class Spots:
    """Points of light whose patterns are completely in the frame.

    Attributes
    ----------
    pixels
        Centroid of the light ``(n, 2)`` as (row, column) (pixels).
    light
        Sum of each pattern above the dark level ``(n,)`` (counts).
    dark
        Dark level of the frame (counts).
    """

    pixels: Array
    light: Array
    dark: float

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.pixels)

    def only(self, which: NDArray[np.bool_] | NDArray[np.intp]) -> Spots:
        """Return the spots selected by a mask ``(n,)`` or by indices."""
        return Spots(self.pixels[which], self.light[which], self.dark)


def dark_level(values: NDArray[np.float64]) -> tuple[float, float]:
    """Return the mode of the values, which is the dark level, and the standard deviation about it.

    The mode is found from half samples (Robertson and Cryer 1974): the densest half of the values, the densest half of
    that, and so on. With patterns over most of a frame, its median would contain light.
    """
    flat = np.sort(values[np.isfinite(values)].ravel())
    flat = flat[:: max(1, len(flat) // 50_000)]
    part = flat
    while len(part) > 64:
        half = len(part) // 2
        width = part[half:] - part[: len(part) - half]
        first = int(width.argmin())
        part = part[first : first + half]
    mode = float(part.mean()) if len(part) else 0.0
    # light is above, noise on both sides; the mode of integer samples is an integer, their mean is not
    noise = 0.0
    for _ in range(3):
        below = mode - flat[flat < mode]
        noise = float(np.sqrt(np.square(below).mean())) if len(below) else 0.0
        near = flat[np.abs(flat - mode) <= 2 * noise]
        mode = float(near.mean()) if len(near) else mode
    return mode, noise


def find_spots(
    values: NDArray[np.float64], radius_px: float, apart_px: float, valid: NDArray[np.bool_] | None = None
) -> Spots:
    """Return the points of light of a frame.

    Smoothing merges the micro-images of a point into one peak, where the search for the centroid starts. Points whose
    patterns are cut off by the border of the frame are left out.

    Parameters
    ----------
    values
        The frame ``(rows, columns)``.
    radius_px
        Half width of a point's pattern (pixels).
    apart_px
        Smallest distance between neighbouring points (pixels).
    valid
        Mask ``(rows, columns)`` of valid pixels. None: all. Saturated pixels may be valid, because they are bright.

    Raises
    ------
    InputError
        If there is no complete pattern.
    """
    from scipy.ndimage import gaussian_filter, maximum_filter

    good = np.isfinite(values) if valid is None else valid & np.isfinite(values)
    mode, noise = dark_level(values[good])
    above = np.where(good, values - mode, 0.0)
    width = radius_px / 2
    smooth = gaussian_filter(above, width, mode="constant")
    tops = (smooth == maximum_filter(smooth, size=max(3, 2 * int(0.45 * apart_px) + 1))) & (smooth > 0)
    # a Gaussian of this width averages 4 pi width² pixels
    tops &= smooth > ABOVE * noise / math.sqrt(4 * math.pi * width**2)
    heights = smooth[tops]
    # a robust typical light: a hole may be much brighter, and many may be dirty
    usual = float(np.median(heights[heights > DIM * heights.max()])) if len(heights) else 0.0
    places = np.argwhere(tops & (smooth > DIM * usual)).astype(float)
    # in a flat region, every pixel is a peak, so require a distance between patterns
    if len(places) > above.size / max(1.0, (0.4 * apart_px) ** 2) + 1:
        places = places[:0]
    found = [_centred(above, place, min(radius_px + 2.0, apart_px / 2)) for place in places]
    pixels = np.array([at for at, _ in found]).reshape(-1, 2)
    light = np.array([sum_ for _, sum_ in found])
    whole = ((pixels >= radius_px) & (pixels <= np.array(values.shape) - 1 - radius_px)).all(axis=1)
    if not whole.any():
        remedy = "check the lamp, and that the frame shows the target"
        raise InputError.expected("points of light in the frame", "complete patterns", "none", remedy)
    order = np.flatnonzero(whole)
    return Spots(pixels[order], light[order], mode)


def _centred(above: Array, start: Array, reach: float) -> tuple[Array, float]:
    """Return the centroid of the light within ``reach`` of the centroid, and the sum of this light."""
    at, total = start, 0.0
    side = math.ceil(reach) + 1
    for _ in range(ROUNDS):
        rows, columns = (
            np.arange(max(0, round(float(c)) - side), min(n, round(float(c)) + side + 1))
            for c, n in zip(at, above.shape, strict=True)
        )
        if not (len(rows) and len(columns)):
            break
        away = np.hypot(rows[:, None] - at[0], columns[None, :] - at[1])
        # a soft edge, because pixels that enter and leave would move the centroid in steps
        part = above[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] * np.clip(reach + 0.5 - away, 0.0, 1.0)
        total = float(part.sum())
        if total <= 0:
            break
        at = np.array([part.sum(1) @ rows, part.sum(0) @ columns]) / total
    return at, total
