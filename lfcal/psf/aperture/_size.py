"""Size of an outline: all its light divided by its lit level, including light beyond the window of the edge.

Lenslets and rims diffract light. Just inside the outline the light rises above the level, and the fit of the shading
mistakes this for shading. Outside, it falls with the inverse square of the distance, beyond the end of the edge's
window. Both make the outline too small.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lfcal.psf.aperture._edge import MODEL, Edge
from lfcal.psf.aperture._locate import LitPatch, offsets
from lfcal.psf.aperture._profile import ANGLES

__all__ = ["measured_area"]

Values = NDArray[np.float64]

RISE = 3.0
"""Distance inside the outline, in blurs, up to which the light may rise."""

LEAST_LEVEL = 0.3
"""Fraction of the radius within which a lit level must be visible; otherwise there is no level."""

NEAR, FAR = 2.5, 6.0
"""Distances beyond the outline, in blurs, between which diffracted light is measured."""

EVEN = 0.01
"""Fraction of the area below which a rise counts as part of the level, as in an aplanatic pupil of high NA."""

FEWEST = 16
"""Number of pixels needed to determine a level."""

CLEAR = 3.0
"""Ratio of a squared correction to its variance above which it is applied (`lfcal.psf.aperture._profile.shrink`)."""


def measured_area(patch: LitPatch, edge: Edge, area: float) -> tuple[float, float]:
    """Return the area inside an outline and its standard error (pixels squared).

    Where noise hides the additional light, the result is ``area``, the area of the outline fitted to the edge. Without
    a lit level, the result is ``area`` with the error NaN.

    Parameters
    ----------
    patch
        The lit patch.
    edge
        Its edge, without ripple or obstruction.
    area
        Area of the fitted outline (pixels squared).
    """
    x, y = offsets(edge.flat.shape, edge.row, edge.column)
    ray = np.arctan2(y, x) % (2 * math.pi)
    radius, blur = math.sqrt(area / math.pi), edge.blur_px
    outside = np.hypot(x, y) - np.interp(ray, ANGLES, edge.smooth, period=2 * math.pi)
    lit, within = outside < -RISE * blur, outside < NEAR * blur
    if radius - RISE * blur < LEAST_LEVEL * radius or lit.sum() < FEWEST:
        return area, math.nan
    light, x, y = edge.flat * edge.shade, x / radius, y / radius
    shaded, variance = _light(light, lit, within, (x, y, x * x + y * y))
    even, _ = _light(light, lit, within, (x, y))
    # a decrease outwards is vignetting; a small increase on a curved level may be the rise at the edge itself
    rise = max(0.0, even - shaded)
    inside = shaded + rise / (1 + (rise / (EVEN * area)) ** 4)
    left, left_variance = _left(light, outside, blur, patch.noise / edge.level)
    # at half the level, a blurred convex outline has lost this much area; pixels are squares
    correction, sigma2 = 0.0, (math.pi * blur**2) ** 2 + (2 * MODEL * area) ** 2
    for found, error2, doubt in (
        (inside - area, variance, (even - shaded) / 2),
        # the unseen part may be as large as the visible part
        (left, left_variance, left),
    ):
        gain = max(0.0, 1 - CLEAR * error2 / max(found**2, 1e-300))
        correction += gain * found
        # the part that is not corrected counts as an error, unless noise explains it
        sigma2 += (gain * doubt) ** 2 + min(error2, found**2 + error2)
    if area + correction <= 0:  # in a pattern that is cut off, the dark part may be brighter than the lit part
        return area, math.nan
    return float(area + correction), math.sqrt(sigma2)


def _left(light: Values, outside: Values, blur: float, noise: float) -> tuple[float, float]:
    """Return the light beyond the edge, inside the cutout and outside, and its variance (pixels squared)."""
    near = NEAR * blur
    # a ring that the border of the cutout does not intersect
    border = _border(outside)
    far = min(FAR * blur, float(border.min()))
    ring = (outside >= near) & (outside < far)
    if not ring.any():
        return 0.0, 0.0
    # an inverse square law, integrated over the ring
    all_of_it = far / (far - near)
    # the error of the background is the error of the median of the cutout's border
    dark = 1.25 * noise / math.sqrt(border.size)
    count = int(ring.sum())
    variance = count * noise**2 + (count * dark) ** 2
    return float(light[ring].sum()) * all_of_it, variance * all_of_it**2


def _border(image: Values) -> Values:
    return np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]])


def _light(
    flat: Values, lit: NDArray[np.bool_], within: NDArray[np.bool_], shades: tuple[Values, ...]
) -> tuple[float, float]:
    """Return the light of the pixels ``within`` divided by the level of those ``lit``, and its variance (pixels²)."""
    terms = np.stack([np.ones(flat.shape), *(np.clip(shade, -1.3, 1.3) for shade in shades)], -1)
    at = terms[lit]
    inverse = np.linalg.inv(at.T @ at)
    level = inverse @ (at.T @ flat[lit])
    residual = flat[lit] - at @ level
    noise2 = float(residual @ residual) / max(1, residual.size - level.size)
    shade = np.clip(terms @ level, 0.3 * level[0], 3 * level[0])
    rim = within & ~lit
    # the level is the mean of the lit pixels, so their scatter about it adds nothing to the error of their light
    light = np.where(within, flat / shade, 0.0)
    change = np.tensordot(np.where(rim, light / shade, 0.0), terms, 2)
    return float(light.sum()), noise2 * (float(change @ inverse @ change) + int(rim.sum()))
