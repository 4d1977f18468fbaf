"""Dark objects inside an aperture."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lfcal.psf.aperture._locate import offsets
from lfcal.psf.aperture._profile import ANGLES
from lfcal.psf.aperture.shape import Obstruction

__all__ = ["dark_place", "find_obstruction"]

DARK = 0.6
"""Fraction of the surrounding light below which a place is obstructed."""

SMALLEST = 0.004
"""Smallest obstruction that is reported, as a fraction of the aperture's area."""

CERTAIN = 6.0
"""Smallest significance of an obstruction, in standard deviations of the noise."""


def find_obstruction(
    flat: NDArray[np.float64], row: float, column: float, edge: NDArray[np.float64], blur_px: float, noise: float
) -> Obstruction | None:
    """Return the largest dark object inside an outline, or None.

    Parameters
    ----------
    flat
        Image normalised to a lit level of 1.
    row, column
        Origin of the outline (pixels).
    edge
        The outline's radius over `lfcal.psf.aperture._profile.ANGLES` (pixels).
    blur_px
        Blur of the edge (pixels); smaller objects are ignored.
    noise
        Noise of a pixel, relative to the lit level.
    """
    from scipy import ndimage

    x, y = offsets(flat.shape, row, column)
    rim = np.interp(np.arctan2(y, x) % (2 * math.pi), ANGLES, edge, period=2 * math.pi)
    inside = np.hypot(x, y) < rim - 3 * blur_px - 1
    area = math.pi * float(np.mean(edge**2))
    # smooth until the noise no longer makes dark spots
    width = max(1.0, blur_px / 2, CERTAIN * noise / (2 * math.sqrt(math.pi) * (1 - DARK)))
    if width > 0.1 * math.sqrt(area):
        return None
    dark = (ndimage.gaussian_filter(flat, width) < DARK) & inside
    labels, count = ndimage.label(dark)
    if not count:
        return None
    sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    largest = int(np.argmax(sizes))
    # spots between the lenslets' images are smaller than the width of the edge
    if sizes[largest] < max(SMALLEST * area, 2 * math.pi * max(blur_px, width) ** 2):
        return None
    centre = ndimage.center_of_mass(labels == largest + 1)
    return Obstruction((float(centre[0]), float(centre[1])), float(sizes[largest]) / area)


def dark_place(
    flat: NDArray[np.float64], row: float, column: float, edge: NDArray[np.float64], blur_px: float
) -> NDArray[np.bool_]:
    """Return a map of the obstructed pixels inside an outline, with a margin for the blur; see `find_obstruction`."""
    from scipy import ndimage

    x, y = offsets(flat.shape, row, column)
    rim = np.interp(np.arctan2(y, x) % (2 * math.pi), ANGLES, edge, period=2 * math.pi)
    inside = np.hypot(x, y) < rim - 3 * blur_px - 1
    dark = (ndimage.gaussian_filter(flat, max(1.0, blur_px)) < DARK) & inside
    wide: NDArray[np.bool_] = ndimage.binary_dilation(dark, iterations=math.ceil(3 * blur_px) + 1) & inside
    return wide
