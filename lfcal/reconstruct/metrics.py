"""How close a reconstruction is to the truth, and an image to its model."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter
from scipy.special import gammaln, logsumexp

from lfcal.errors import InputError

__all__ = ["best_scale", "nrmse", "poisson_gauss_log_likelihood", "psnr", "ssim", "ssim_map"]


def nrmse(estimate: ArrayLike, truth: ArrayLike) -> float:
    """Return the norm of ``estimate - truth`` over that of ``truth`` (0: equal).

    Raises
    ------
    InputError
        If shapes differ or the truth is zero everywhere.
    """
    a, b = _pair(estimate, truth)
    size = float(np.linalg.norm(b))
    if size == 0:
        raise InputError.expected("truth", "something that is not zero", "zeros", "use another measure")
    return float(np.linalg.norm(a - b)) / size


def best_scale(estimate: ArrayLike, truth: ArrayLike) -> float:
    """Return the factor on ``estimate`` that brings it closest to ``truth`` in the least-squares sense."""
    a, b = _pair(estimate, truth)
    power = float((a * a).sum())
    return float((a * b).sum()) / power if power > 0 else 1.0


def psnr(estimate: ArrayLike, truth: ArrayLike, peak: float | None = None) -> float:
    """Return the peak signal-to-noise ratio (dB): ``20 log10(peak / rms error)``; the truth's peak by default."""
    a, b = _pair(estimate, truth)
    top = float(b.max()) if peak is None else peak
    rms = float(np.sqrt(np.mean((a - b) ** 2)))
    return float("inf") if rms == 0 else 20 * float(np.log10(top / rms))


def ssim_map(estimate: ArrayLike, truth: ArrayLike, peak: float | None = None) -> NDArray[np.float64]:
    """Return the structural similarity at each pixel (Wang et al. 2004, equation 13; Gaussian window, sigma 1.5).

    Leading axes are taken as separate planes.
    """
    a, b = _pair(estimate, truth)
    top = float(b.max() - b.min()) if peak is None else peak
    c1, c2 = (0.01 * top) ** 2, (0.03 * top) ** 2
    sigma = (0,) * (a.ndim - 2) + (1.5, 1.5)

    def mean(x: NDArray[np.float64]) -> NDArray[np.float64]:
        out: NDArray[np.float64] = gaussian_filter(x, sigma, truncate=3.5)
        return out

    ma, mb = mean(a), mean(b)
    va, vb, cov = mean(a * a) - ma * ma, mean(b * b) - mb * mb, mean(a * b) - ma * mb
    above = (2 * ma * mb + c1) * (2 * cov + c2)
    below = (ma * ma + mb * mb + c1) * (va + vb + c2)
    return np.divide(above, below, out=np.ones_like(above), where=below > 0)


def ssim(estimate: ArrayLike, truth: ArrayLike, peak: float | None = None) -> float:
    """Return the mean structural similarity (1: equal) away from the window's border of 5 pixels."""
    values = ssim_map(estimate, truth, peak)
    inner = values[..., 5:-5, 5:-5]
    return float((inner if inner.size else values).mean())


def poisson_gauss_log_likelihood(
    image: ArrayLike, model: ArrayLike, read_noise: float, gain: float = 1.0
) -> NDArray[np.float64]:
    """Return the log-likelihood of each pixel under Poisson light and Gaussian read noise.

    ``p(f) = sum_n Poisson(n; m/gain) Normal(f; gain n, read_noise)`` (Snyder et al. 1993, equation 5), summed over
    the counts that matter and evaluated as logarithms.

    Parameters
    ----------
    image, model
        Measured and expected values in counts, same shape; the model must not be negative.
    read_noise
        Rms of the read noise (counts), positive.
    gain
        Counts per photo-electron.
    """
    f, m = _pair(image, model)
    if read_noise <= 0 or gain <= 0 or (m < 0).any():
        raise InputError.expected(
            "read noise, gain, model",
            "positive, positive, not negative",
            f"{read_noise}, {gain}, least {m.min()}",
            "correct them",
        )
    noise = read_noise / gain
    seen, rate = f.ravel() / gain, m.ravel() / gain
    parts = [_summed(seen[k : k + CHUNK], rate[k : k + CHUNK], noise) for k in range(0, seen.size, CHUNK)]
    out: NDArray[np.float64] = np.concatenate(parts).reshape(f.shape) - np.log(gain)
    return out


CHUNK = 1 << 14
"""Pixels whose sums are evaluated at once."""


def _summed(seen: NDArray[np.float64], rate: NDArray[np.float64], noise: float) -> NDArray[np.float64]:
    """Return ``log sum_n Poisson(n; rate) Normal(seen; n, noise)`` over the n around the largest term."""
    mode = _mode(seen, rate, noise)
    half = int(np.ceil(9 / np.sqrt(1 / noise**2 + 1 / max(1.0, float(mode.max()))) + 12))
    n = np.floor(mode)[:, None] + np.arange(-half, half + 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        light = np.where(n == 0, 0.0, n * np.log(rate[:, None])) - rate[:, None] - gammaln(n + 1)
    terms = light - (seen[:, None] - n) ** 2 / (2 * noise**2)
    total = logsumexp(np.where(n >= 0, terms, -np.inf), axis=1)
    result: NDArray[np.float64] = np.asarray(total) - 0.5 * np.log(2 * np.pi * noise**2)
    return result


def _mode(seen: NDArray[np.float64], rate: NDArray[np.float64], noise: float) -> NDArray[np.float64]:
    """Return the n of the largest term: ``log(rate/n) + (seen - n)/noise^2 = 0``, by Newton's method in log n."""
    target = np.log(np.maximum(rate, 1e-300)) + seen / noise**2
    u = np.log(np.maximum(np.maximum(seen, rate), 1.0)) + 1.0  # right of the root, from where the steps are monotone
    for _ in range(200):
        slope = np.exp(u) / noise**2
        step = (slope + u - target) / (slope + 1)
        u -= step
        if np.abs(step).max(initial=0) < 1e-6:
            break
    mode: NDArray[np.float64] = np.exp(np.clip(u, -50, None))
    return mode


def _pair(a: ArrayLike, b: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    x, y = np.asarray(a, np.float64), np.asarray(b, np.float64)
    if x.shape != y.shape or x.size == 0:
        raise InputError.expected("arrays to compare", f"one shape, {y.shape}", x.shape, "crop them alike")
    return x, y
