"""The lit part of a white image, and lattices of a few large lenslets in it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError

__all__ = ["LitPart", "blurred", "large_lattices", "lit_part"]

Array = NDArray[np.float64]

CROP = 1536
"""Side of the part that is analysed (pixels): fast, with enough lenslets of any camera."""

COARSE = 256
"""Side of the coarse image in which the lit part and large lenslets are found (pixels)."""

DARK = 0.15
"""Light relative to the brightest places, above the darkest, that counts as lit."""

MOSTLY_LIT = 0.6
"""Lit fraction of the frame above which the middle of the frame is analysed."""

SPREADS = 10
"""Number of standard deviations of the Gaussian that removes slow variations, along the shorter side."""

RING_LEVELS = (0.4, 0.55, 0.7, 0.8)
"""Levels between the darkest and the brightest places at which micro-images may be separate rings."""

MIN_RINGS = 4
MIN_ISLAND = 12.0
"""Smallest area of a bright island (square pixels)."""

HOLE_SHARE = 0.03
"""Smallest area of the hole of a ring, relative to the area within its outline."""

MOSTLY_RINGS = 0.7
"""Fraction of the bright islands that must have one hole."""

MIN_LAG_PEAK = 0.1
"""Smallest autocorrelation at a lattice vector, relative to that without a lag."""

MAX_LAGS = 12
"""Number of the shortest lags that form lattices."""

INDEX_TOLERANCE = 0.15
"""Largest distance of a lag from an integer combination of the lattice vectors."""

MIN_EXPLAINED = 0.8
"""Fraction of the heights of all lags that a lattice must explain."""


@dataclass(frozen=True, eq=False, slots=True)
class LitPart:
    """The part of a white image in which the first lattice is found.

    Attributes
    ----------
    image
        ``(rows, columns)`` of this part.
    middle
        Its well-lit middle as (x, y), in pixels of the part.
    origin
        First pixel of the part in the whole image as (x, y).
    """

    image: NDArray[np.float32]
    middle: Array
    origin: Array

    def flattened(self) -> LitPart:
        """Return the part without variations slower than the coarsest lattice, in brightness and in contrast."""
        crop = self.image
        sigma = min(crop.shape) / SPREADS
        # uneven light would put power near zero frequency, and bright corners would dominate
        flat = crop - blurred(crop, sigma)
        spread = np.sqrt(blurred(flat * flat, sigma))
        top = float(spread.max())
        if not top > 1e-6 * float(np.abs(crop).max()):
            raise InputError.expected("white image", "micro-images", "a blank image", "switch the light on")
        return replace(self, image=(flat / np.maximum(spread, 0.05 * top)).astype(np.float32))

    def without_holes(self) -> LitPart:
        """Return the part with rings filled if its micro-images are rings, as behind a main lens with an obstruction.

        The dark middle of a ring resembles a gap, so the lattice of the gaps could be mistaken for that of the
        lenslets.
        """
        flat = self.flattened().image
        holes = _holes(flat)
        if holes is None:
            return self
        bright = ((flat > 0) & ~holes).astype(np.float32)
        sigma = min(flat.shape) / SPREADS
        light = blurred(self.image * bright, sigma) / np.maximum(blurred(bright, sigma), 1e-6)
        return replace(self, image=np.where(holes, light, self.image))

    def scaled(self) -> LitPart:
        """Return the part with a mean of 0 and a standard deviation of 1."""
        image = self.image - self.image.mean(dtype=np.float64)
        return replace(self, image=(image / max(float(image.std()), 1e-30)).astype(np.float32))


def _holes(flat: NDArray[np.float32]) -> NDArray[np.bool_] | None:
    """Return the pixels in the dark middles of rings; None if the micro-images are not rings."""
    from lfcal.base import cv2

    smooth = cv2.GaussianBlur(flat, (0, 0), 0.7)
    low, high = (float(v) for v in np.percentile(smooth, (5, 95)))
    for level in RING_LEVELS:
        mask = (smooth > low + level * (high - low)).astype(np.uint8)
        contours, links = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
        areas = np.array([cv2.contourArea(c) for c in contours])
        parents = np.array([link[3] for link in links[0]]) if len(contours) else np.zeros(0, int)
        inner = np.flatnonzero(parents >= 0)
        inner = inner[areas[inner] > HOLE_SHARE * areas[parents[inner]]]
        outer = np.flatnonzero((parents < 0) & (areas > MIN_ISLAND))
        rings = np.bincount(parents[inner], minlength=len(contours))[outer] == 1
        if len(outer) >= MIN_RINGS and rings.mean() > MOSTLY_RINGS:
            filled = np.zeros(mask.shape, np.uint8)
            cv2.drawContours(filled, [contours[k] for k in inner], -1, 1, cv2.FILLED)
            holes: NDArray[np.bool_] = filled > 0
            return holes
    return None


def lit_part(image: NDArray[np.float32]) -> LitPart:
    """Return the middle of the frame, or the lit part if much of the frame is dark."""
    rows, columns = image.shape
    lit, step = _lit(image)
    middle = (np.array([columns, rows]) - 1) / 2
    low, high = np.zeros(2), np.array([columns, rows], float)
    if lit.mean() < MOSTLY_LIT and lit.any():
        low, high, middle = _around(lit, step, (columns, rows))
    near = np.maximum(np.minimum(CROP, high - low), 1)
    first = np.clip(np.floor(middle - (near - 1) / 2), low, high - near).astype(int)
    last = first + near.astype(int)
    crop = image[first[1] : last[1], first[0] : last[0]]
    return LitPart(crop, middle - first, first.astype(float))


def _lit(image: NDArray[np.float32]) -> tuple[NDArray[np.bool_], float]:
    """Return the lit parts of a coarse image, and the pixels per sample."""
    from lfcal.base import cv2

    step = max(1.0, max(image.shape) / COARSE)
    size = (max(1, round(image.shape[1] / step)), max(1, round(image.shape[0] / step)))
    floor = float(np.percentile(image[:: max(1, int(step / 2)), :: max(1, int(step / 2))], 2))
    # squares, because small spots on a dark ground are lit areas too
    square = cv2.resize(np.square(image - np.float32(floor)), size, interpolation=cv2.INTER_AREA)
    light = np.sqrt(cv2.GaussianBlur(square, (0, 0), max(1.0, 0.04 * min(square.shape))))
    lit: NDArray[np.bool_] = light > DARK * np.percentile(light, 99)
    return lit, step


def _around(lit: NDArray[np.bool_], step: float, size: tuple[int, int]) -> tuple[Array, Array, Array]:
    """Return the bounds (x, y) of the largest lit part, and the point that is farthest from the dark."""
    from lfcal.base import cv2

    _, labels, stats, _ = cv2.connectedComponentsWithStats(lit.astype(np.uint8))
    mine = (labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))).astype(np.uint8)
    depth = cv2.distanceTransform(np.pad(mine, 1), cv2.DIST_L2, 5)[1:-1, 1:-1]
    y, x = np.unravel_index(int(np.argmax(depth)), depth.shape)
    j, i = np.nonzero(mine)
    low = np.floor(np.array([i.min(), j.min()]) * step)
    high = np.minimum(np.ceil(np.array([i.max() + 1, j.max() + 1]) * step), size)
    return low, high, np.clip((np.array([x, y]) + 0.5) * step - 0.5, low, high - 1)


def blurred(image: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    """Return ``image`` after a wide Gaussian of ``sigma`` pixels, computed on a coarser grid."""
    from lfcal.base import cv2

    rows, columns = image.shape
    factor = max(1, int(sigma / 6))
    small = cv2.resize(image, (-(-columns // factor), -(-rows // factor)), interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), sigma / factor, borderType=cv2.BORDER_REFLECT)
    result: NDArray[np.float32] = cv2.resize(small, (columns, rows), interpolation=cv2.INTER_LINEAR)
    return result


def large_lattices(part: LitPart) -> list[Array]:
    """Return bases ``(2, 2)`` (rows, x and y) of lattices that explain the autocorrelation; the finest one is first.

    A few micro-images have broad spectral peaks, which overlap with those of the shape of a micro-image. Their
    autocorrelation has maxima at the differences of their positions, even if lenslets are missing.
    """
    lags, heights = _lags(part.image)
    found = [np.stack(pair) for pair in combinations(lags[:MAX_LAGS], 2)]
    return sorted((b for b in found if _explains(b, lags, heights)), key=lambda b: abs(np.linalg.det(b)))


def _explains(basis: Array, lags: Array, heights: Array) -> bool:
    if abs(np.linalg.det(basis)) < 0.3 * np.prod(np.linalg.norm(basis, axis=1)):
        return False
    index = lags @ np.linalg.inv(basis)
    whole = np.abs(index - np.rint(index)).max(1) < INDEX_TOLERANCE
    return bool(heights[whole].sum() > MIN_EXPLAINED * heights.sum())


def _lags(image: NDArray[np.float32]) -> tuple[Array, Array]:
    """Return the lags ``(n, 2)`` (x, y) and heights of maxima of the autocorrelation, shortest first, one of a pair."""
    from scipy import fft, ndimage

    from lfcal.base import cv2

    step = max(1.0, max(image.shape) / COARSE)
    # what is smoothed away here must not return as moiré
    smooth = cv2.GaussianBlur(image, (0, 0), step)
    rows, columns = (max(2, round(n / step)) for n in image.shape)
    coarse = cv2.resize(smooth, (columns, rows), interpolation=cv2.INTER_LINEAR)
    coarse -= coarse.mean()
    padded = fft.rfft2(coarse, (2 * rows, 2 * columns), workers=1)
    product = fft.fftshift(fft.irfft2(np.abs(padded) ** 2, (2 * rows, 2 * columns), workers=1))
    whole = float(np.square(image - image.mean()).mean()) * coarse.size
    top = (product == ndimage.maximum_filter(product, 5)) & (product > MIN_LAG_PEAK * whole)
    j, i = np.nonzero(top)
    heights = product[j, i]
    i, j = i - columns, j - rows
    half = ((j > 0) | ((j == 0) & (i > 0))) & (np.abs(j) < 0.75 * rows) & (np.abs(i) < 0.75 * columns)
    lags = np.stack([i[half], j[half]], axis=-1) * np.array([image.shape[1] / columns, image.shape[0] / rows])
    order = np.argsort(np.hypot(*lags.T), kind="stable")
    return lags[order], heights[half][order]
