"""Gauss-Legendre nodes without a linear-algebra library, so that no threads are started."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["gauss_legendre"]

F8 = NDArray[np.float64]


def _legendre(n: int, t: F8) -> tuple[F8, F8]:
    """Return the polynomial P_n at ``t`` and its derivative n (P_n-1 - t P_n) / (1 - t^2).

    By the recurrence k P_k = (2k - 1) t P_k-1 - (k - 1) P_k-2 (Abramowitz and Stegun, chapter 22).
    """
    before, value = np.ones_like(t), t
    for k in range(2, n + 1):
        before, value = value, ((2 * k - 1) * t * value - (k - 1) * before) / k
    return value, n * (before - t * value) / (1 - t * t)


def _newton(n: int) -> tuple[F8, F8]:
    """Return nodes and weights (n,) on [-1, 1] by Newton's method.

    Nodes are the roots of P_n. Weights are 2 / ((1 - t^2) P_n'(t)^2) (Abramowitz and Stegun 25.4.29).
    """
    # close enough for Newton's method to find each root
    t = np.cos(np.pi * (np.arange((n + 1) // 2) + 0.75) / (n + 0.5))
    for _ in range(12):
        value, slope = _legendre(n, t)
        step = value / slope
        t = t - step
        if np.abs(step).max() < 1e-15:
            break
    # once more at the roots themselves, because the weights need the slope there
    _, slope = _legendre(n, t)
    w = 2 / ((1 - t * t) * slope * slope)
    if n % 2 == 1:
        t[-1] = 0.0  # exactly 0, so that the rule is symmetric
    return np.concatenate([-t[: n // 2], t[::-1]]), np.concatenate([w[: n // 2], w[::-1]])


def gauss_legendre(n: int, low: float = -1.0, high: float = 1.0) -> tuple[F8, F8]:
    """Return ``n`` nodes and weights on ``[low, high]``, exact for polynomials of degree 2 n - 1."""
    x, w = _newton(n) if n > 1 else (np.zeros(1), np.full(1, 2.0))
    half = (high - low) / 2
    return low + half * (x + 1), w * half
