"""Measure background, noise and clipping in the dark corners of the cutouts."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["DarkCorners", "dark_corners", "darkness"]

MOST_SAMPLES = 2_000_000

DARKEST = (0.02, 0.1)
"""Fractions of a pattern's darkest samples; the difference between these quantiles gives the noise."""

LIT = 0.008
"""Fraction of the peak by which corners exceed the darkest samples, beyond noise, if they are lit."""


@dataclass(frozen=True, slots=True)
class DarkCorners:
    """Dark pixels of a plane.

    Attributes
    ----------
    background
        Mean background: the median of the means of the four corners.
    noise
        Standard deviation of a pixel.
    clipped
        Fraction of exact zeros if noise was clipped at zero; else 0.
    chance
        Standard error of the background.
    """

    background: float
    noise: float
    clipped: float
    chance: float


def dark_corners(plane: NDArray[np.float32]) -> DarkCorners:
    """Measure the corners, which should be dark, of all patterns ``(ny, nx, nt, ns)``."""
    nt, ns = plane.shape[2:]
    b = max(2, round(0.06 * min(nt, ns)))
    every = max(1, plane.shape[0] * plane.shape[1] * 4 * b * b // MOST_SAMPLES)
    frames = plane.reshape(-1, nt, ns)[::every]
    blocks = [frames[:, t, s] for t in (slice(b), slice(-b, None)) for s in (slice(b), slice(-b, None))]
    corners = [c[np.isfinite(c)].astype(np.float64) for c in blocks]
    if not all(c.size for c in corners):
        return DarkCorners(0.0, 0.0, 0.0, 0.0)
    means = np.array([c.mean() for c in corners])  # a pattern that reaches one corner changes only its mean
    noise = float(np.median([_spread(c) for c in corners]))
    chance = 1.25 * noise / math.sqrt(sum(c.size for c in corners))
    return DarkCorners(float(np.median(means)), noise, _cut_off(np.stack(blocks)) if noise > 0 else 0.0, chance)


def darkness(plane: NDArray[np.float32]) -> DarkCorners:
    """Return `dark_corners`, or measure gaps within the patterns ``(ny, nx, nt, ns)`` if patterns fill the corners.

    Otherwise light in the corners would be subtracted from every pattern as background, and dim patterns would have
    no light left.
    """
    corners = dark_corners(plane)
    frames = plane.reshape(-1, plane.shape[2] * plane.shape[3])
    frames = frames[:: max(1, frames.size // MOST_SAMPLES)]
    frames = frames[np.isfinite(frames).all(1)].astype(np.float64)
    if not len(frames):
        return corners
    lowest, low = np.median(np.quantile(frames, DARKEST, axis=1), axis=1)
    # for Gaussian noise, these quantiles are 2.05 and 1.28 standard deviations below the mean
    noise = float(low - lowest) / 0.772
    background = float(lowest) + 2.054 * noise
    peak = float(np.median(frames.max(1))) - background
    if corners.background - background < LIT * peak + noise:
        return corners
    return DarkCorners(background, noise, 0.0, 1.25 * noise / math.sqrt(len(frames)))


def _spread(values: NDArray[np.float64]) -> float:
    """Return the standard deviation from the median deviation or, if that is zero, without the largest deviations."""
    away = np.abs(values - np.median(values))
    half = 1.4826 * float(np.median(away))
    return half if half > 0 else float(values[away <= np.quantile(away, 0.98)].std())


def _cut_off(pixels: NDArray[np.float32]) -> float:
    """Return the fraction of zeros among dark ``pixels (..., columns)`` if they are noise cut off at zero, else 0.

    Noise is cut off where no pixel is negative and zeros fall at random: in a noise-free matrix they lie together.
    """
    zero = pixels == 0
    share = float(zero.mean())
    if not 0.02 < share < 0.9 or float(np.nanmin(pixels)) < 0:
        return 0.0
    together = float((zero[..., 1:] & zero[..., :-1]).mean())
    return share if (together - share**2) / (share - share**2) < 0.3 else 0.0
