"""Find the lit patch with its background, noise and rough outline, and remove vignetting."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["LitPatch", "despike", "find_patch", "mad", "offsets", "shading"]

Image = NDArray[np.float64]

HOLE = 0.03
"""Half width of the smallest hole that is taken into account, as a fraction of the radius."""

FEWEST = 16
"""Number of pixels needed to determine a lit level."""


@dataclass(frozen=True, slots=True)
class LitPatch:
    """A lit patch of a depth-plane sum.

    Attributes
    ----------
    background, noise
        Median of the cutout's border, and standard deviation estimated from its median absolute deviation.
    level
        Lit level above the background.
    row, column, radius
        Centroid and radius of the circle of the same area (pixels).
    mask
        Pixels above half the lit level, holes filled.
    hole
        Pixels of large filled holes, such as that of an annular stop, with a margin for the blur.
    """

    background: float
    noise: float
    level: float
    row: float
    column: float
    radius: float
    mask: NDArray[np.bool_]
    hole: NDArray[np.bool_]


def offsets(shape: tuple[int, ...], row: float, column: float) -> tuple[Image, Image]:
    """Return each pixel's column and row from a centre, two arrays of ``shape`` (pixels)."""
    y, x = np.meshgrid(np.arange(shape[0]) - row, np.arange(shape[1]) - column, indexing="ij")
    return x, y


def mad(values: NDArray[np.float64]) -> float:
    """Return the standard deviation of normally distributed values, estimated from the median absolute deviation."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))


def despike(image: Image) -> Image:
    """Return ``image`` with outliers replaced: pixels that differ from their 5 x 5 neighbourhood by six deviations.

    Where the noise is small, a pixel of an edge or a corner also differs strongly from the median. However, it is
    within the range of its neighbours. Only a pixel beyond all but two of them is an outlier.
    """
    from lfcal.base import cv2

    # float32, because OpenCV's median of 5 x 5 takes no doubles
    smooth = cv2.medianBlur(image.astype(np.float32), 5).astype(np.float64)
    difference = image - smooth
    # below a few per cent of the light, a spike does no harm, and the tip of an intact corner would look like one
    limit = max(6 * mad(difference), 0.03 * float(np.ptp(smooth)))
    if limit == 0:
        return image
    row, column = np.nonzero(np.abs(difference) > limit)
    around = np.lib.stride_tricks.sliding_window_view(np.pad(image, 2, mode="edge"), (5, 5))[row, column]
    ranked = np.sort(around.reshape(-1, 25), axis=1)
    value = image[row, column]
    spike = (value > ranked[:, -4] + limit) | (value < ranked[:, 3] - limit)
    clean = image.copy()
    clean[row[spike], column[spike]] = smooth[row[spike], column[spike]]
    return clean


def find_patch(image: Image) -> LitPatch | None:
    """Return the lit patch of a depth-plane sum, or None if nothing stands out from the noise.

    The image is smoothed until the patch is eight deviations above the noise. The noise is that of the border,
    assumed white and filtered by a Gaussian.
    """
    from scipy import ndimage

    side = min(image.shape)
    # at least two pixels, so that the border of a small cutout still gives a median
    edge = max(2, int(0.03 * side))
    border = np.ones(image.shape, bool)
    border[edge:-edge, edge:-edge] = False
    background = float(np.median(image[border]))
    noise = mad(image[border])
    sigma = max(0.3, side / 128)
    while True:
        smooth = ndimage.gaussian_filter(image - background, sigma)
        # the 97th percentile, because a single bright pixel would determine the maximum
        top = float(np.percentile(smooth, 97))
        # a Gaussian of width sigma reduces the standard deviation of white noise to 1/(2 sqrt(pi) sigma)
        floor = noise / (2 * math.sqrt(math.pi) * sigma)
        if top > 8 * floor or sigma > side / 12:
            break
        sigma *= 1.4
    # the second limit is for an even image without noise, whose rounding errors would look like light
    if not top > max(4 * floor, 1e-12 * abs(background)):
        return None
    level = float(np.median(smooth[smooth > 0.6 * top]))
    labels, count = ndimage.label(smooth > 0.5 * level)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    # hot or dead pixels and the gaps between lenslets leave holes
    mask = ndimage.binary_fill_holes(labels == 1 + int(np.argmax(sizes)))
    row, column = ndimage.center_of_mass(mask)
    radius = math.sqrt(float(mask.sum()) / math.pi)
    hole = _hole(mask & (labels != 1 + int(np.argmax(sizes))), radius)
    return LitPatch(background, noise, level, float(row), float(column), radius, mask, hole)


def _hole(dark: NDArray[np.bool_], radius: float) -> NDArray[np.bool_]:
    """Return the large holes among the filled pixels of a patch, with a margin."""
    from scipy import ndimage

    # smaller holes are hot or dead pixels and gaps between the lenslets' images
    large = ndimage.binary_opening(dark, iterations=max(1, round(HOLE * radius)))
    wide: NDArray[np.bool_] = ndimage.binary_dilation(large, iterations=max(2, round(2 * HOLE * radius)))
    return wide


def shading(image: Image, patch: LitPatch, row: float, column: float, radius: float) -> tuple[Image, float, float]:
    """Return the smooth lit level of an image, the level at the centre, and its relative decrease to the radius.

    A plane plus a paraboloid is fitted robustly inside three quarters of ``radius``, holes left out, and continued
    outwards.
    """
    x, y = offsets(image.shape, row, column)
    background = patch.background
    # normalised by the radius, so that the four terms are of one order
    x, y = x / radius, y / radius
    r2 = x * x + y * y
    inside = (r2 < 0.75**2) & ~patch.hole
    if 2 * inside.sum() < (r2 < 0.75**2).sum():
        # a paraboloid is not determined at the centre of a ring, as a wide hole leaves it
        inside, r2 = (r2 < 0.9**2) & ~patch.hole, np.zeros_like(r2)
    if inside.sum() < FEWEST:
        return np.ones_like(image), 0.0, 0.0
    terms = np.stack([np.ones(int(inside.sum())), x[inside], y[inside], r2[inside]], 1)
    values = image[inside] - background
    weight = np.ones(values.size)
    for _ in range(4):
        # normal equations: four unknowns, thousands of pixels
        weighted = terms * weight[:, None]
        p = np.linalg.solve(terms.T @ weighted + 1e-9 * np.eye(4), weighted.T @ values)
        residual = values - terms @ p
        # Cauchy weights: pixels far from the surface have almost no weight
        weight = 1.0 / (1.0 + (residual / max(2.5 * mad(residual), 1e-100)) ** 2)
    # a paraboloid continued far outwards would become negative
    lit = p[0] + p[1] * np.clip(x, -1.2, 1.2) + p[2] * np.clip(y, -1.2, 1.2) + p[3] * np.minimum(r2, 1.3**2)
    top = max(float(p[0]), 1e-300)
    return np.clip(lit, 0.3 * top, 3 * top), float(p[0]), -float(p[3] / top)
