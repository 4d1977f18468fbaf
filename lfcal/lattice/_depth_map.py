"""Depth maps in the central view: their values, their confidence, and the choice of the samples that are known."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

__all__ = ["FLOOR", "METHODS", "DepthMap", "confidence_of", "half_window", "supported"]

Image = NDArray[np.float32]
Array = NDArray[np.float64]

METHODS = ("auto", "micro-images", "views")

FLOOR = 2e-3
"""Variation of the light that is always assumed, relative to its mean, due to interpolation and to the sensor."""

GOOD_PX = 0.3
"""Disparity error (pixels); the confidence is the probability that the error is smaller."""

MIN_CONFIDENCE = 0.3
"""Smallest confidence of a known depth."""


@dataclass(frozen=True, eq=False)
class DepthMap:
    """Depth map of a scene in the central view; NaN where the depth is unknown.

    Attributes
    ----------
    slope
        Slope w of each sample, ``(rows, columns)`` float32: the depth in the dimensionless form of `sensor_slope`.
    sigma
        Standard error of `slope`, in the same shape.
    confidence
        Probability (0 to 1) that the error of the disparity is less than 0.3 px, in the same shape; 0 where the depth
        is unknown. It is estimated from the standard error and, for micro-images, from the fraction of their depths
        that agree.
    image
        All-in-focus image of the central view, in the same shape.
    method
        Method of `depth_map` that was used: ``"micro-images"`` or ``"views"``.
    corner_px, step_px
        Position (row, column) of sample (0, 0) on the frame, and spacing of the samples (rows, columns), in px.
    disparity_px
        Scale of the disparity. For micro-images: the product of the slope and the disparity of adjacent micro-images,
        which equals the pitch (px). For views: the disparity between the outermost and the central view at a slope of 1
        (samples).
    z_um, z_sigma_um
        Depth of each sample relative to the working plane, positive away from the camera, and its standard error (µm);
        None unless `metric_depth` has been applied.
    across_um
        Position (down, right) of each sample in object space relative to the optical axis (µm), ``(rows, columns, 2)``;
        None unless `metric_depth` has been applied.
    """

    slope: Image = field(repr=False)
    sigma: Image = field(repr=False)
    confidence: Image = field(repr=False)
    image: Image = field(repr=False)
    method: str
    corner_px: tuple[float, float]
    step_px: tuple[float, float]
    disparity_px: float
    z_um: Image | None = field(repr=False, default=None)
    z_sigma_um: Image | None = field(repr=False, default=None)
    across_um: Array | None = field(repr=False, default=None)

    @property
    def known(self) -> NDArray[np.bool_]:
        """Boolean mask of the samples whose depth is known, ``(rows, columns)``."""
        return np.isfinite(self.slope)

    @property
    def disparity(self) -> Image:
        """Disparity of adjacent micro-images (px), or between the outermost and the central view (samples)."""
        if self.method == "views":
            return self.slope * np.float32(self.disparity_px)
        return np.float32(self.disparity_px) / self.slope

    @property
    def disparity_sigma(self) -> Image:
        """Standard error of `disparity`, in the same unit."""
        if self.method == "views":
            return self.sigma * np.float32(self.disparity_px)
        return self.sigma / self.slope**2 * np.float32(self.disparity_px)

    def places_px(self) -> Array:
        """Return the positions (row, column) of the samples on the frame, ``(rows, columns, 2)`` (px)."""
        steps = zip(self.corner_px, self.step_px, self.slope.shape, strict=True)
        rows, columns = (corner + step * np.arange(n) for corner, step, n in steps)
        return np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1)

    def points(self) -> tuple[Array, NDArray[np.bool_]]:
        """Return the points (x, y, z) of known depth, ``(n, 3)``, and a mask ``(rows, columns)`` of their samples.

        Coordinates are in µm if `z_um` is known; otherwise, x and y are in pixels of the frame, and z is the slope.
        """
        if self.z_um is None or self.across_um is None:
            chosen, across, depth = self.known, self.places_px(), self.slope
        else:
            chosen, across, depth = self.known & np.isfinite(self.z_um), self.across_um, self.z_um
        return np.column_stack([across[chosen][:, ::-1], depth[chosen]]), chosen


def half_window(radius: float) -> int:
    """Return half the side of the windows: 5 x 5 pixels, or 3 x 3 in small micro-images."""
    return 2 if radius >= 6 else 1


def confidence_of(error: Image) -> Image:
    """Return the probability that a disparity with a standard error (pixels) is wrong by less than `GOOD_PX`."""
    from scipy.special import erf

    known = np.isfinite(error)
    return np.where(known, erf(GOOD_PX / math.sqrt(2) / np.where(known, np.maximum(error, 1e-6), 1)), 0).astype(
        np.float32
    )


def supported(found: DepthMap) -> DepthMap:
    """Return a map without depths of little confidence, and without those that too few neighbours confirm.

    A neighbour within two samples confirms a depth if both agree within three standard errors and half a `GOOD_PX`. At
    least three neighbours and half of those with enough confidence must confirm it.
    """
    known = found.confidence >= MIN_CONFIDENCE
    disparity, error = np.pad(found.disparity, 2), np.pad(found.disparity_sigma, 2)
    usable = np.pad(known, 2)
    rows, columns = known.shape
    agree, near = np.zeros(known.shape, np.int16), np.zeros(known.shape, np.int16)
    for i in range(5):
        for j in range(5):
            part = (slice(i, i + rows), slice(j, j + columns))
            off = np.abs(disparity[part] - found.disparity)
            limit = GOOD_PX / 2 + 3 * np.hypot(error[part], found.disparity_sigma)
            near += usable[part]
            agree += usable[part] & (off <= limit)
    # the sample itself is among both
    known &= (agree >= 4) & (2 * agree >= near)
    unknown = ~known
    slope, sigma = found.slope.copy(), found.sigma.copy()
    slope[unknown], sigma[unknown] = np.nan, np.nan
    return replace(found, slope=slope, sigma=sigma, confidence=np.where(known, found.confidence, 0).astype(np.float32))
