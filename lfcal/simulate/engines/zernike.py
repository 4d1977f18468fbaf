"""Zernike polynomials."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

__all__ = ["zernike_radial"]


def zernike_radial(n: int, m: int, rho: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the Zernike polynomial R_n^m(rho), 1 at rho = 1."""
    total = np.zeros_like(rho)
    for k in range((n - m) // 2 + 1):
        top = (-1) ** k * math.factorial(n - k)
        bottom = math.factorial(k) * math.factorial((n + m) // 2 - k) * math.factorial((n - m) // 2 - k)
        total += top / bottom * rho ** (n - 2 * k)
    return total
