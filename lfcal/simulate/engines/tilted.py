"""Fields on an array that is not parallel to the sensor, so that each sample is at a different distance.

A field of directions s changes over a distance d by exp(i 2 pi d (sqrt(1 - s²) - 1)/lambda), which is smooth in d.
Over the distances of the whole array it is a polynomial in d with a few orders, each of which is one Fourier
transform. With K orders, interpolated at Chebyshev nodes, the error is 2 (phi/2)^K/K! for a phase of +-phi at the
steepest light.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy.fft as sf
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.simulate.engines._propagator import sensor_propagator
from lfcal.simulate.engines.extent import MAX_ORDERS
from lfcal.simulate.engines.tables import steepest_sine
from lfcal.simulate.scene import Scene

__all__ = ["TiltedArray", "orders_of"]

CLOSE = 3e-4
"""Largest error of the steepest light, relative to its amplitude."""

Complex = NDArray[Any]


def _farthest(scene: Scene, reach_um: float) -> float:
    """Return the largest additional distance, relative to the middle of the period, of lenslets that are lit (µm)."""
    height, width = ((n - 1) / 2 * px for n, px in zip(scene.period, (scene.row_um, scene.pixel_um), strict=True))
    return sum(
        abs(tilt) * (half / scene.scale + reach_um) for tilt, half in zip(scene.tilt, (height, width), strict=True)
    )


def orders_of(scene: Scene, reach_um: float) -> int:
    """Return the number of polynomial orders that the steepest light needs on a tilted array.

    ``reach_um`` is the largest distance of lit lenslets from a position (µm). The result is `MAX_ORDERS` + 1 if
    `MAX_ORDERS` are not enough.
    """
    slower = 1 - math.sqrt(1 - steepest_sine(scene) ** 2)
    phase = 2 * math.pi / scene.wavelength_um * _farthest(scene, reach_um) * slower
    error, orders = 2.0, 0
    while error > CLOSE or orders < 2:
        orders += 1
        error *= phase / 2 / orders
        if orders > MAX_ORDERS:
            break
    return orders


class TiltedArray:
    """Propagation of fields from a plane parallel to the sensor to a tilted array and back.

    The plane and the array intersect in the middle of the period.

    Parameters
    ----------
    scene
        Scene with the tilt.
    n, dx
        Samples per side of a field, and their spacing (µm).
    reach_um
        Radius around a position within which lenslets are lit (µm).
    dtype
        Type of the fields, complex64 or complex128.

    Raises
    ------
    InputError
        If the tilt needs more than `MAX_ORDERS` orders.
    """

    def __init__(self, scene: Scene, n: int, dx: float, reach_um: float, dtype: Any) -> None:
        orders = orders_of(scene, reach_um)
        if orders > MAX_ORDERS:
            got = f"{math.hypot(*scene.tilt):.3g} rad over {2 * reach_um:.4g} µm"
            raise InputError.expected(
                "array tilt", "a smaller tilt over the lit lenslets", got, "choose a depth that lights fewer lenslets"
            )
        self._farthest = _farthest(scene, reach_um)
        self._real = np.zeros(0, dtype).real.dtype
        u = np.cos(np.pi * (np.arange(orders) + 0.5) / orders)
        to_powers = np.linalg.inv(np.vander(u, increasing=True))
        f = sf.fftfreq(n, dx)
        self._orders = np.zeros((orders, n, n), dtype)
        for k in range(orders):
            turn, separable = sensor_propagator(f, scene.wavelength_um, u[k] * self._farthest, scene.exact_rays)
            turn = turn[:, None] * turn[None, :] if separable else turn
            for m in range(orders):
                self._orders[m] += (to_powers[m, k] * turn).astype(dtype)

    def heights(self, farther_um: NDArray[np.float64]) -> Complex:
        """Return ``farther_um`` divided by the largest additional distance of a lit lenslet, clipped to -1 and 1.

        ``farther_um`` ``(n, n)`` is the additional distance of the array from the sensor (µm), as in
        `Scene.farther_at`. The other methods use distances in this form. They are clipped because the polynomial would
        diverge beyond the lit area.
        """
        found: Complex = np.clip(farther_um / self._farthest, -1.0, 1.0).astype(self._real)
        return found

    def parts(self, field: Complex) -> Complex:
        """Return the parts ``(orders, n, n)`` from which `met` computes the field on the array.

        ``field`` is the field on the plane, ``(n, n)``. The parts can be used for any `heights`.
        """
        spectrum = sf.fft2(field, workers=1)
        # towards the image: an array that is farther from the sensor is reached earlier
        signs = (-1.0) ** np.arange(len(self._orders))
        return np.stack(
            [
                sf.ifft2(spectrum * (order * self._real.type(sign)), overwrite_x=True, workers=1)
                for order, sign in zip(self._orders, signs, strict=True)
            ]
        )

    @staticmethod
    def met(parts: Complex, heights: Complex) -> Complex:
        """Return the field on the array, ``(n, n)``, from the `parts` of a field on the plane.

        ``heights`` are as returned by `heights`.
        """
        found: Complex = parts[-1].copy()
        for part in parts[-2::-1]:
            found *= heights
            found += part
        return found

    def left(self, behind: Complex, heights: Complex) -> Complex:
        """Propagate the field ``behind`` the array back to the plane, and return its spectrum there, ``(n, n)``.

        ``heights`` are as returned by `heights`. ``behind``, ``(n, n)``, is overwritten.
        """
        spectrum = np.zeros_like(behind)
        for k, order in enumerate(self._orders):
            if k:
                behind *= heights
            spectrum += order * sf.fft2(behind, workers=1)
        return spectrum
