"""How good an attenuation mask can be at all: a bound for every mask, and the best of all open-or-closed small ones."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, check_number
from lfcal.multiplex.masks import MAX_SIZE

__all__ = ["MAX_EXHAUSTIVE", "best_binary_mask", "mask_gain_bound", "noise_shares"]

Array = NDArray[np.float64]

MAX_EXHAUSTIVE = 4
"""Side up to which all open-or-closed masks are tried: 65 536 of 4 x 4 px."""


def noise_shares(chi2: float) -> tuple[float, float]:
    """Return the shares of additive and of photon noise at chi^2, 0 … inf."""
    if not chi2 >= 0:
        raise InputError.expected("chi^2", "a number from 0 to inf", chi2, "correct it")
    additive = 1.0 / (1.0 + chi2)
    return additive, 1.0 - additive


def mask_gain_bound(size: int, chi2: float) -> float:
    """Return a gain over the pinhole (dB) that no mask of ``size`` x ``size`` pixels exceeds at ``chi2``.

    Of the N Fourier weights of a mask that lets the share tau through, the zeroth is N tau, and the others add up to
    at most N^2 tau (1 - tau) in square, as transmissions lie within 0 and 1. The noise adds up their inverse squares,
    which are least where all others are equal; tau is then chosen best. Masks of cyclic difference sets reach it.

    Parameters
    ----------
    size
        Pixels along a side, as many as views.
    chi2
        The camera's, 0 … inf.

    Examples
    --------
    >>> from lfcal.multiplex import mask, mask_gain_bound, snr_gain
    >>> for chi2 in (0.0, 10.0):
    ...     gain = snr_gain(mask("MURA", 5), mask("pinhole", 5), chi2)
    ...     print(f"chi^2 = {chi2:g}: MURA {gain:.2f} dB, no mask above {mask_gain_bound(5, chi2):.2f} dB")
    chi^2 = 0: MURA 3.80 dB, no mask above 4.15 dB
    chi^2 = 10: MURA 0.72 dB, no mask above 1.53 dB
    """
    from scipy.optimize import minimize_scalar

    check_number("size of the mask (px)", size, at_least=1, at_most=MAX_SIZE, integer=True)
    additive, photon = noise_shares(chi2)
    n = size * size
    if n == 1:
        return 0.0  # a hole

    def log_noise(tau: float) -> float:
        amplified = (1 / tau + (n - 1) ** 2 * (1 / (1 - tau))) / tau / n**3
        return math.log(amplified * (additive + photon * tau))

    # 1/tau^2 + c/(tau (1 - tau)) times a line has one minimum; the grid keeps the search in its valley
    grid = (np.arange(4 * n) + 0.5) / (4 * n)
    k = int(np.argmin([log_noise(tau) for tau in grid]))
    step = 1 / (4 * n)
    low, high = max(grid[k] - step, 1e-12), min(grid[k] + step, 1 - 1e-12)
    found = minimize_scalar(log_noise, bounds=(low, high), method="bounded", options={"xatol": 1e-12})
    least = min(float(found.fun), log_noise(grid[k]))
    return 5 / math.log(10) * (math.log(additive + photon / n) - least)


def best_binary_mask(size: int, chi2: float) -> Array:
    """Return the pattern ``(size, size)`` of open and closed pixels with most gain, by trying all.

    Raises
    ------
    InputError
        If the side is above `MAX_EXHAUSTIVE` pixels.

    Examples
    --------
    >>> from lfcal.multiplex import best_binary_mask, mask, mask_at_distance, mask_gain_bound, snr_gain
    >>> pattern = best_binary_mask(4, chi2=2.0)  # a difference set
    >>> gain = snr_gain(mask_at_distance(pattern, 1.0), mask("pinhole", 4), 2.0)
    >>> print(f"{pattern.sum():.0f} of 16 pixels open, {gain:.1f} of {mask_gain_bound(4, 2.0):.1f} dB")
    6 of 16 pixels open, 2.2 of 2.2 dB
    """
    check_number("size of the mask (px)", size, at_least=1, at_most=MAX_EXHAUSTIVE, integer=True)
    additive, photon = noise_shares(chi2)
    n = size * size
    best, least = np.ones((size, size)), math.inf
    codes = np.arange(1, 2**n)
    for part in np.array_split(codes, -(-len(codes) // 8192)):
        masks = ((part[:, None] >> np.arange(n)) & 1).astype(float).reshape(-1, size, size)
        power = np.abs(np.fft.fft2(masks)) ** 2
        # a weight of zero is a sample lost: rounding must not make a large number of it
        lost = (power < 1e-9).any((1, 2))
        noise = (1 / np.where(power < 1e-9, 1.0, power)).sum((1, 2)) * (additive + photon * masks.mean((1, 2)))
        noise[lost] = math.inf
        k = int(np.argmin(noise))
        if noise[k] < least:
            best, least = masks[k], float(noise[k])
    return best
