"""Quality of a plane as shown by its depth-plane sum."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.psf.aperture import Aperture

__all__ = ["EdgeLight", "coverage", "diameter", "edge_light", "off_centre", "spread", "stuck_pixels"]

STUCK = (0.9, 0.3)
"""Fraction of the frames in which a hot pixel is lit, and the excess over its neighbours that is required."""

REACH, MARGIN = 1.25, 3.0
"""Distance beyond which there should be no light: in radii of the lit patch, and in pixels."""

DOUBT = 1.2
"""Ratio of light to the expected tails of the camera up to which the camera explains it."""

CUT_OFF = 10.0
"""Truncation (per cent) above which the corners do not show the dark level."""


def _plateau(shown: NDArray[np.float64]) -> float:
    from scipy import ndimage

    # the largest smoothed value, because the largest pixel may be hot
    return float(ndimage.gaussian_filter(shown, 2.0).max())


def diameter(shown: NDArray[np.float64]) -> float:
    """Return the diameter of the disc with the same second moment as the lit patch of a depth-plane sum (pixels)."""
    # a uniform disc of diameter D has the second moment D²/8 about its centre
    return math.sqrt(8 * spread(shown))


def spread(shown: NDArray[np.float64]) -> float:
    """Return the variance of the light about its centroid, rows and columns together (pixels squared).

    Pixels far outside the lit patch, which contain only noise, are excluded.
    """
    patch = _LitArea.of(shown)
    if patch is None:
        return 0.0
    light = np.where(patch.distance <= REACH * patch.radius + MARGIN, shown, 0.0)
    total = float(light.sum())
    if not total > 0:
        return 0.0
    variance = 0.0
    for axis in (0, 1):
        profile, place = light.sum(1 - axis), np.arange(light.shape[axis])
        mean = float(profile @ place) / total
        variance += float(profile @ (place - mean) ** 2) / total
    return max(0.0, variance)


@dataclass(frozen=True, slots=True)
class _LitArea:
    """The lit patch: its plateau, its outer radius, and every pixel's distance from its middle (pixels)."""

    plateau: float
    radius: float
    distance: NDArray[np.float64]

    @staticmethod
    def of(shown: NDArray[np.float64]) -> _LitArea | None:
        from scipy import ndimage

        top = _plateau(shown)
        if not top > 0:
            return None
        labels, count = ndimage.label(ndimage.gaussian_filter(shown, 1.0) > 0.1 * top)
        if count == 0:
            return None
        # by light instead of area, because noise makes large faint patches
        sizes = np.bincount(labels.ravel(), weights=np.maximum(shown, 0).ravel(), minlength=count + 1)[1:]
        patch = labels == 1 + int(np.argmax(sizes))
        row, column = ndimage.center_of_mass(patch)
        t, s = np.meshgrid(np.arange(shown.shape[0]) - row, np.arange(shown.shape[1]) - column, indexing="ij")
        distance = np.hypot(t, s)
        return _LitArea(top, float(distance[patch].max()), distance)


@dataclass(frozen=True, slots=True)
class EdgeLight:
    """Light in parts of a depth-plane sum that should be dark (per cent); NaN if it cannot be measured.

    Attributes
    ----------
    truncation
        Mean over the two outermost rows or columns at the brightest side, relative to the plateau.
    leak
        Light outside 1.25 radii of the lit patch, relative to the total, minus the contributions of pixel noise and of
        the camera's tails.
    """

    truncation: float = math.nan
    leak: float = math.nan

    @property
    def cut_off(self) -> bool:
        """Whether so much light reaches the edge that the corners do not show the dark level."""
        return self.truncation > CUT_OFF


def edge_light(
    shown: NDArray[np.float64], noise: float = 0.0, expected: NDArray[np.float64] | None = None
) -> EdgeLight:
    """Return truncation and stray light of a background-free depth-plane sum.

    Parameters
    ----------
    shown
        Depth-plane sum ``(nt, ns)``.
    noise
        Standard deviation of the noise of a pixel of ``shown``.
    expected
        Expected light in the depth-plane sum, in any unit; see `lfcal.judge.quality._expected.expected_sum`.
    """
    patch = _LitArea.of(shown)
    if patch is None:
        return EdgeLight()
    # two rows or columns: a single one is noisy, and more would no longer be the edge
    sides = (shown[:2], shown[-2:], shown[:, :2], shown[:, -2:])
    truncation = 100 * max(0.0, max(float(side.mean()) for side in sides)) / patch.plateau
    outside = patch.distance > REACH * patch.radius + MARGIN
    if not outside.mean() > 0.02:  # the patch fills the cutout
        return EdgeLight(truncation)
    # sum of n noisy pixels: sqrt(n) times the noise of one, doubled for certainty
    chance = 2 * noise * math.sqrt(outside.sum())
    leak = 100 * max(0.0, float(shown[outside].sum()) - chance) / float(shown.sum())
    # the camera's own pattern, cut and weighted in the same way
    tails = edge_light(expected).leak if expected is not None else math.nan
    return EdgeLight(truncation, max(0.0, leak - DOUBT * tails) if math.isfinite(tails) else leak)


def off_centre(shown: NDArray[np.float64], aperture: Aperture) -> float:
    """Return the distance of the aperture's centre, or of the light's centroid, from the cutout's centre (pixels)."""
    from scipy import ndimage

    middle = [(n - 1) // 2 for n in shown.shape]
    place = aperture.centre
    if not all(math.isfinite(c) for c in place):
        lit = np.where(shown > 0.1 * _plateau(shown), shown, 0.0)
        if not lit.any():
            return math.nan
        row, column = ndimage.center_of_mass(lit)
        place = (float(row), float(column))
    return math.dist(place, middle)


def coverage(period: tuple[int, ...], cutout: tuple[int, ...]) -> NDArray[np.intp]:
    """Return the number of frames that show each sensor pixel, ``(nt + ny - 1, ns + nx - 1)``."""
    counts = [np.convolve(np.ones(n, np.intp), np.ones(m, np.intp)) for n, m in zip(period, cutout, strict=True)]
    return np.outer(counts[0], counts[1])


def stuck_pixels(lit: NDArray[np.int32], frames: NDArray[np.intp]) -> int:
    """Return the number of hot or dead pixels: lit in almost all frames, or in none, unlike their neighbours.

    Parameters
    ----------
    lit
        Number of frames in which each pixel is lit.
    frames
        Number of frames that show each pixel, of the same shape; pixels that few frames show are left out.
    """
    from scipy import ndimage

    share = np.where(frames > 0, lit / np.maximum(frames, 1), 0.0)
    around = np.ones((3, 3), bool)
    around[1, 1] = False
    # third highest and third lowest of the eight neighbours: two of them may be defects too
    bright = ndimage.rank_filter(share, -3, footprint=around, mode="nearest")
    dim = ndimage.rank_filter(share, 2, footprint=around, mode="nearest")
    # pixels near the edge of the region appear in few cutouts, so their shares are unreliable
    seen = frames >= frames.max() / 2
    hot = (share > STUCK[0]) & (share - bright > STUCK[1])
    dead = (share < 1 - STUCK[0]) & (dim - share > STUCK[1])
    return int(((hot | dead) & seen).sum())
