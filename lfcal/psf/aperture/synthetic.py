"""Depth-plane sums of a known iris, with all that disturbs real ones."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.psf.aperture.shape import Aperture, blade_radius, polygon_area

__all__ = ["Disturbance", "depth_sum_of"]

OVERSAMPLING = 3


@dataclass(frozen=True, slots=True)
class Disturbance:
    """What disturbs a depth-plane sum, in units of its lit level.

    Attributes
    ----------
    noise
        Standard deviation of a pixel.
    blur_px
        Gaussian blur, standard deviation (pixels).
    ripple, ripple_pitch_px
        Amplitude and pitch of what the lenslet lattice leaves (pixels).
    vignetting, tilt
        Fall of light from the centre to the rim; slope of light across a radius.
    hot
        Share of hot pixels.
    ellipticity
        Half the difference of the axes.
    pedestal
        Background.
    """

    noise: float = 0.05
    blur_px: float = 2.0
    ripple: float = 0.04
    ripple_pitch_px: float = 31.0
    vignetting: float = 0.12
    tilt: float = 0.08
    hot: float = 0.002
    ellipticity: float = 0.01
    pedestal: float = 0.05


def depth_sum_of(
    side: int, blades: int, curvature: float, disturbance: Disturbance, rng: np.random.Generator, *, fill: float = 0.42
) -> tuple[NDArray[np.float64], Aperture]:
    """Return a disturbed depth-plane sum ``(side, side)`` and the iris in it; centre and rotation are random.

    Parameters
    ----------
    side
        Side of the cutout (pixels).
    blades, curvature
        Of the iris.
    disturbance
        What disturbs it.
    rng
        Source of all random numbers.
    fill
        Radius of the circle of the iris's area over ``side``.
    """
    from scipy import ndimage

    column, row = (side - 1) / 2 + rng.uniform(-4, 4, 2)
    step = 2 * math.pi / blades
    rotation = rng.uniform(0, step)
    radius = fill * side
    # the circle of the same area has this radius
    apothem = radius * math.sqrt(math.pi / polygon_area(blades, 1.0, curvature))
    # centres of sub-pixels, so that edges are antialiased by their covered area
    fine = (np.arange(side * OVERSAMPLING) + 0.5) / OVERSAMPLING - 0.5
    x = (fine - column)[None, :] * (1 + disturbance.ellipticity)
    y = (fine - row)[:, None] * (1 - disturbance.ellipticity)
    lit = np.hypot(x, y) < blade_radius(np.arctan2(y, x), blades, rotation, apothem, curvature)
    image = lit.reshape(side, OVERSAMPLING, side, OVERSAMPLING).mean((1, 3))
    image = ndimage.gaussian_filter(image, disturbance.blur_px)
    rows, columns = np.indices(image.shape)
    u, v = (columns - column) / radius, (rows - row) / radius
    image *= (1 - disturbance.vignetting * (u * u + v * v)) * (1 + disturbance.tilt * u)
    wave = 2 * math.pi / disturbance.ripple_pitch_px
    phase = rng.uniform(0, 2 * math.pi, 2)
    image *= 1 + disturbance.ripple * np.cos(wave * columns + phase[0]) * np.cos(wave * rows + phase[1])
    image += disturbance.pedestal + rng.normal(0, disturbance.noise, image.shape)
    hot = np.flatnonzero(rng.random(image.shape) < disturbance.hot)
    image.flat[hot] += rng.uniform(0.5, 3, hot.size)
    truth = Aperture(
        blades, (float(row), float(column)), rotation, apothem, math.pi * radius**2, curvature, disturbance.blur_px
    )
    return image, truth
