"""Propagation of a field from one plane to a parallel plane."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lfcal.simulate._symmetry import folded

__all__ = ["sensor_propagator"]

Complex = NDArray[np.complex128]


def sensor_propagator(
    f: NDArray[np.float64], wavelength: float, gap: float, exact: bool, glass: tuple[float, float] = (0.0, 1.0)
) -> tuple[Complex, bool]:
    """Return the transfer function over a distance ``gap`` at the frequencies ``f`` (n,), and whether it is separable.

    A separable function is that of one axis (n,), otherwise it is that of both axes (n, n).

    ``glass`` is thickness and index of a plate; the gap is the equivalent one in air, with the same Fresnel integral.

    Fresnel: exp(-i pi lambda B f^2) per axis. Exact: 2 pi B (sqrt(1/lambda^2 - f^2) - 1/lambda) in a form without
    cancellation, zero for evanescent waves, band-limited to 1/(lambda sqrt((2 B/L)^2 + 1)) per axis (Matsushima and
    Shimobaba 2009, eq. 13).
    """
    if not exact:
        return np.exp(-1j * np.pi * wavelength * gap * f * f), True
    length = 1 / (f[1] - f[0])
    limit = 1 / (wavelength * math.sqrt((2 * gap / length) ** 2 + 1))
    distances, places = folded(f)
    k2 = distances[:, None] ** 2 + distances[None, :] ** 2
    s = wavelength**2 * k2
    thick, index = glass
    air = (gap - thick / index) / (1 + np.sqrt(np.maximum(1 - s, 0)))
    phase = -2 * np.pi * wavelength * k2 * (air + thick / (index + np.sqrt(np.maximum(index**2 - s, 0))))
    seen = (distances < limit)[:, None] & (distances < limit)[None, :] & (s < 1)
    return np.where(seen, np.exp(1j * phase), 0)[np.ix_(places, places)], False
