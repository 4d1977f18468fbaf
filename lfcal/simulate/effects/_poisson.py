"""Poisson random numbers for single pixels, each from one uniform random number."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["poisson_quantile"]

EXACT_MEAN = 60.0
"""Mean number of electrons up to which Poisson probabilities are added one after the other."""


def poisson_quantile(mean: NDArray[np.floating], share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the Poisson quantiles of ``share`` in [0, 1) for each ``mean``; negative means count as 0.

    Each random number gives one deviate, so a pixel's noise does not depend on the pixels before it. For means up to
    `EXACT_MEAN`, probabilities are added. Above, the expansion of Cornish and Fisher to the third cumulant is used
    (Abramowitz & Stegun 26.2.49), which is off by one in fewer than 1 % of deviates.
    """
    from scipy.special import ndtri

    mean = np.maximum(np.asarray(mean, np.float64), 0.0)
    out = np.zeros(mean.shape)
    large = mean > EXACT_MEAN
    if large.any():
        # the normal deviate of a fraction of 0 is minus infinity
        m, z = mean[large], ndtri(np.clip(share[large], 1e-16, None))
        third = (z * z - 1) / 6 - (z * z * z - z) / (72 * np.sqrt(m))
        out[large] = np.maximum(np.floor(m + z * np.sqrt(m) + third + 0.5), 0.0)
    # a share below P(0) gives 0 electrons; for others, count up until the share is reached
    todo = np.flatnonzero(~large.ravel() & (share > np.exp(-mean)).ravel())
    m, u, flat = mean.ravel()[todo], share.ravel()[todo], out.ravel()
    term = np.exp(-m)
    total, count = term.copy(), 0
    # rounding may keep the sum below the last share: 400 is far above any count here
    while todo.size and count < 400:
        count += 1
        term = term * m / count
        total += term
        flat[todo] = count
        more = u > total
        todo, m, u, term, total = todo[more], m[more], u[more], term[more], total[more]
    return flat.reshape(mean.shape)
