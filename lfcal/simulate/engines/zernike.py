"""Zernike polynomials."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

__all__ = ["zernike_radial", "zernike_wavefront"]


def zernike_radial(n: int, m: int, rho: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the radial Zernike polynomial R_n^m(rho) for m >= 0 and even n - m; it is 1 at rho = 1, the rim."""
    total = np.zeros_like(rho)
    for k in range((n - m) // 2 + 1):
        top = (-1) ** k * math.factorial(n - k)
        bottom = math.factorial(k) * math.factorial((n + m) // 2 - k) * math.factorial((n - m) // 2 - k)
        total += top / bottom * rho ** (n - 2 * k)
    return total


def zernike_wavefront(
    terms: Iterable[tuple[int, int, float]], ux: NDArray[np.float64], uy: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the sum of Zernike terms ``(n, m, waves)`` at pupil points (ux, uy) in pupil radii.

    A term is ``waves`` times R_n^|m|(rho) cos(m theta), or sin(|m| theta) for m < 0.

    R_n^m(rho) exp(i m theta) is (ux + i uy)^m times a polynomial in rho², so no angle or root is needed.
    """
    rho2 = ux * ux + uy * uy
    total = np.zeros_like(rho2)
    turned: dict[int, NDArray[np.complex128]] = {}
    for n, m, waves in terms:
        if waves == 0:
            continue
        order = abs(m)
        part = np.full_like(rho2, 0.0)
        for k in range((n - order) // 2 + 1):  # Horner, from the highest power down
            bottom = math.factorial(k) * math.factorial((n + order) // 2 - k) * math.factorial((n - order) // 2 - k)
            part *= rho2
            part += (-1) ** k * math.factorial(n - k) / bottom
        if order:
            if order not in turned:
                turned[order] = (ux + 1j * uy) ** order if order < 3 else _power(ux + 1j * uy, order)
            part *= turned[order].real if m > 0 else turned[order].imag
        part *= waves
        total += part
    return total


def _power(base: NDArray[np.complex128], order: int) -> NDArray[np.complex128]:
    """Return an integer power by repeated products; numpy uses logarithms for powers of three and above."""
    found = base * base
    for _ in range(order - 2):
        found = found * base
    return found
