"""Working f-number from the growth of the aperture's shadow with depth."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lfcal.base import InputError, format_count

__all__ = ["FNumber", "working_f_number"]


@dataclass(frozen=True, slots=True)
class FNumber:
    """A fitted working f-number with its uncertainty.

    Attributes
    ----------
    value
        Working f-number: image distance divided by pupil diameter.
    standard_error
        Standard error of ``value``, the larger of two estimates: from the scatter about the fitted line, and from the
        errors of the diameters. NaN for two depths without errors of the diameters.
    offset_um
        Distance of the image behind the lenslets at which the fitted diameter is zero (µm); 0 if the depths are
        correct.
    residual_px
        Rms deviation of the diameters from the fitted line (px).

    Examples
    --------
    >>> from lfcal.psf.aperture import FNumber, working_f_number
    >>> found: FNumber = working_f_number([10.2, 19.9, 30.1], [264, 528, 792], pixel_um=5.5)
    >>> print(f"N = {found.value:.2f} ± {found.standard_error:.2f}, scatter {found.residual_px:.2f} px")
    N = 4.82 ± 0.07, scatter 0.12 px
    """

    value: float
    standard_error: float
    offset_um: float
    residual_px: float


def working_f_number(
    diameters_px: ArrayLike, image_shifts_um: ArrayLike, pixel_um: float, errors_px: ArrayLike | None = None
) -> FNumber:
    """Return the working f-number N, fitted to the diameters ``D = |a| / N`` of the iris's shadow at several depths.

    A line is fitted to sign(a) D as a function of a, the distance of the image behind the lenslets. Planes on both
    sides of the native plane, where a = 0, then have the same slope. A constant error of the depths does not affect the
    slope. A constant error of the diameters, such as from the blur of the edge, does not affect it if all planes are on
    one side. Diameters that deviate by more than three robust standard deviations from the line have a lower weight.

    Parameters
    ----------
    diameters_px
        Diameter of the circle with the same area as the shadow (px), one for each plane; D is this diameter in µm.
    image_shifts_um
        Distance a of the image of each plane behind the lenslets (µm), as returned by
        `lfcal.camera.Camera.image_shift_um`.
    pixel_um
        Pixel pitch (µm).
    errors_px
        Standard error of each diameter (px). None: unknown.

    Raises
    ------
    InputError
        If there are fewer than two different depths, ``diameters_px`` and ``image_shifts_um`` differ in length or are
        not finite, or the diameter does not change with depth.

    Examples
    --------
    >>> from lfcal.psf.aperture import working_f_number
    >>> # 264 µm behind the lenslets a shadow of 10 pixels: N = 264 / (10 x 5.5)
    >>> found = working_f_number([10, 20, 10], [264, 528, -264], pixel_um=5.5)
    >>> print(f"N = {found.value:.3f}")
    N = 4.800
    """
    a = np.asarray(image_shifts_um, float).ravel()
    d = np.asarray(diameters_px, float).ravel() * pixel_um
    if a.shape != d.shape or a.size < 2:
        raise InputError.expected(
            "diameters over depth",
            "one diameter for each of two or more depths",
            f"{format_count(d.size, 'diameter', 'diameters')} and {format_count(a.size, 'depth', 'depths')}",
            "give one diameter for each plane",
        )
    if not np.isfinite([a, d]).all():
        remedy = "leave out the planes without a finite diameter or depth"
        raise InputError.expected("diameters over depth", "finite numbers", "NaN or infinity", remedy)
    if np.ptp(a) == 0:
        remedy = "give planes of different depths"
        raise InputError.expected("diameters over depth", "two or more different depths", "equal depths", remedy)
    # with the sign of a, planes on both sides of the native plane lie on one line
    signed = d * np.where(a < 0, -1.0, 1.0)
    weight = np.ones(a.size)
    for _ in range(10):
        matrix = np.stack([a, np.ones(a.size)], 1) * weight[:, None]
        slope, constant = np.linalg.lstsq(matrix, signed * weight, rcond=None)[0]
        residual = signed - slope * a - constant
        scale = 1.4826 * float(np.median(np.abs(residual)))
        # if all diameters lie on the line to rounding, another iteration would divide by zero
        if scale <= 1e-12 * float(np.abs(d).max()):
            break
        # Huber weights: square roots, because lstsq squares them
        weight = 1.0 / np.sqrt(np.maximum(1.0, np.abs(residual) / (3.0 * scale)))
    # a constant diameter leaves a slope of rounding errors
    if not abs(slope) * np.ptp(a) > 1e-9 * np.abs(d).max() or not math.isfinite(slope):
        raise InputError.expected(
            "diameters over depth",
            "diameters that change with depth",
            "a constant diameter",
            "choose planes of different blur",
        )
    rms = float(np.sqrt(np.mean(residual**2)))
    error = math.nan
    if a.size > 2:
        spread = float(((a - a.mean()) ** 2).sum())
        # error propagation: N = 1/slope, dN = d(slope)/slope²
        error = math.sqrt(float((residual**2).sum()) / (a.size - 2) / spread) / slope**2
    if errors_px is not None:
        own = np.asarray(errors_px, float).ravel() * pixel_um
        # the slope is a weighted sum of the diameters
        away = a - float((weight**2 * a).sum() / (weight**2).sum())
        share = weight**2 * away / float((weight**2 * away**2).sum())
        stated = math.sqrt(float((share**2 * own**2).sum())) / slope**2
        error = stated if math.isnan(error) else max(error, stated)
    return FNumber(float(1.0 / abs(slope)), float(error), float(-constant / slope), float(rms / pixel_um))
