"""What the dark corners of the cutouts say: background, noise, clipping."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Dark", "dark_corners"]

MOST_SAMPLES = 2_000_000


@dataclass(frozen=True, slots=True)
class Dark:
    """Dark pixels of a plane.

    Attributes
    ----------
    background
        Median over the four corners of their means.
    noise
        Standard deviation of a pixel.
    clipped
        Share of exact zeros among pixels none of which is negative while some are positive; else 0.
    """

    background: float
    noise: float
    clipped: float


def dark_corners(plane: NDArray[np.float32]) -> Dark:
    """Measure the corners of all patterns ``(ny, nx, nt, ns)``, where no light should be."""
    nt, ns = plane.shape[2:]
    b = max(2, round(0.06 * min(nt, ns)))
    every = max(1, plane.shape[0] * plane.shape[1] * 4 * b * b // MOST_SAMPLES)
    frames = plane.reshape(-1, nt, ns)[::every]
    corners = [frames[:, t, s].ravel() for t in (slice(b), slice(-b, None)) for s in (slice(b), slice(-b, None))]
    corners = [c[np.isfinite(c)].astype(np.float64) for c in corners]
    if not all(c.size for c in corners):
        return Dark(0.0, 0.0, 0.0)
    means = np.array([c.mean() for c in corners])
    pixels = np.concatenate(corners)
    noise = float(np.median([1.4826 * np.median(np.abs(c - np.median(c))) for c in corners]))
    if noise == 0:  # more than half the pixels are equal: clipped or rounded noise, or none
        noise = float(np.median([c[np.abs(c - np.median(c)) <= np.quantile(np.abs(c - np.median(c)), 0.98)].std()
                                 for c in corners]))  # fmt: skip
    zeros = float(np.mean(pixels == 0))
    clipped = zeros if pixels.min() >= 0 and 0.02 < zeros < 0.9 and noise > 0 else 0.0
    return Dark(float(np.median(means)), noise, clipped)
