"""Edge radius over angle, from the light summed along each ray."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["ANGLES", "RAYS", "edge_profile", "shrink"]

RAYS = 720
"""Number of rays of a profile."""

ANGLES: NDArray[np.float64] = np.linspace(0.0, 2 * np.pi, RAYS, endpoint=False)
"""Directions of the rays, from +column towards +row (rad)."""

HIGHEST = 33
"""Highest harmonic of an iris: the second harmonic of fifteen blades, and a margin."""


def edge_profile(
    flat: NDArray[np.float64], row: float, column: float, radius: float, low: ArrayLike = 0.7, high: ArrayLike = 1.3
) -> NDArray[np.float64]:
    """Return the edge radius along each ray, ``(RAYS,)`` (pixels).

    ``r(theta)² = r0² + 2 ∫ I r dr`` from r0 = low * radius to high * radius: the radius that encloses the ray's light.
    It is linear in the pixels, so it does not require finding an edge and works far below an SNR of 1.

    Parameters
    ----------
    flat
        Image normalised to a lit level of 1 and a background of 0.
    row, column, radius
        Centre and mean radius (pixels).
    low, high
        Limits of the window, common or for each ray (in units of ``radius``).
    """
    from scipy import ndimage

    start = np.broadcast_to(np.asarray(low, float) * radius, RAYS)
    width = np.broadcast_to(np.asarray(high, float) * radius, RAYS) - start
    # steps of half a pixel or less: longer ones would alias the edge
    steps = max(16, int(np.ceil(width.max() / 0.5)))
    r = start + width * np.linspace(0, 1, steps)[:, None]
    places = [row + r * np.sin(ANGLES), column + r * np.cos(ANGLES)]
    light = ndimage.map_coordinates(flat, places, order=1, mode="nearest") * r
    # trapezium rule along each ray
    area = (light[1:] + light[:-1]).sum(0) * (width / (2 * (steps - 1)))
    # noise may make the enclosed light negative, which has no real root
    edge: NDArray[np.float64] = np.sqrt(np.maximum(start**2 + 2 * area, (0.3 * radius) ** 2))
    return edge


def shrink(edge: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a smooth ``edge``: each harmonic is shrunk by its noise, estimated from harmonics that no iris has."""
    spectrum = np.fft.rfft(edge) / RAYS
    power = np.abs(spectrum) ** 2
    # the power of complex Gaussian noise is exponentially distributed: its median is ln 2 times its mean
    noise = float(np.median(power[HIGHEST + 1 : 90])) / np.log(2)
    gain = np.maximum(1 - 3 * noise / (power + 1e-300), 0)
    # size, centre and ellipticity are not changed
    gain[:3] = 1
    gain[HIGHEST + 1 :] = 0
    smooth: NDArray[np.float64] = np.fft.irfft(spectrum * gain, RAYS) * RAYS
    return smooth
