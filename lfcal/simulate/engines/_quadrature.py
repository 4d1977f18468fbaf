"""Gauss-Legendre nodes without a linear-algebra library, so that no threads are started."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lfcal.base import njit

__all__ = ["gauss_legendre"]

F8 = NDArray[np.float64]


@njit()
def _newton(n: int, x: F8, w: F8) -> None:
    """Fill nodes ``x`` and weights ``w`` (n,) on [-1, 1] by Newton's method on the three-term recurrence.

    Nodes are the roots of P_n, with k P_k = (2k - 1) t P_k-1 - (k - 1) P_k-2. Weights are 2 / ((1 - t^2) P_n'(t)^2),
    with P_n' = n (P_n-1 - t P_n) / (1 - t^2) (Abramowitz and Stegun 25.4.29).
    """
    for i in range((n + 1) // 2):
        t = math.cos(math.pi * (i + 0.75) / (n + 0.5))  # close enough for Newton's method to find this root
        slope = 1.0
        for _ in range(12):
            before, value = 1.0, t
            for k in range(2, n + 1):
                before, value = value, ((2 * k - 1) * t * value - (k - 1) * before) / k
            slope = n * (before - t * value) / (1 - t * t)
            step = value / slope
            t -= step
            if abs(step) < 1e-15:
                break
        # once more at the root itself, because the weight needs the slope there
        before, value = 1.0, t
        for k in range(2, n + 1):
            before, value = value, ((2 * k - 1) * t * value - (k - 1) * before) / k
        slope = n * (before - t * value) / (1 - t * t)
        x[i], x[n - 1 - i] = -t, t
        w[i] = w[n - 1 - i] = 2 / ((1 - t * t) * slope * slope)
    if n % 2 == 1:
        x[n // 2] = 0.0  # exactly 0, so that the rule is symmetric


def gauss_legendre(n: int, low: float = -1.0, high: float = 1.0) -> tuple[F8, F8]:
    """Return ``n`` nodes and weights on ``[low, high]``, exact for polynomials of degree 2 n - 1."""
    x, w = np.zeros(n), np.full(n, 2.0)
    if n > 1:
        _newton(n, x, w)
    half = (high - low) / 2
    return low + half * (x + 1), w * half
