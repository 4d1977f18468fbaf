"""Scatter of the samples of patterns, and the part that a camera does not explain."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from lfcal.psf import PSFMatrix

__all__ = ["misfit", "noise_of", "noise_terms", "rounding_of", "start_of", "variance_of"]

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
Flags = NDArray[np.bool_]

FEW = 12
"""Number of samples in a bin needed to determine its noise."""

BINS = 24
"""Number of brightness bins for measuring the noise."""

LOOKED_AT = 200_000
"""Largest number of values used to decide whether values are in steps."""

DARK = 3e-3
"""Fraction of the brightest light below which samples contain only noise."""

SAME = 0.2
"""Fraction of dark samples with the same value above which noise counts as clipped."""

EACH = 8
"""Mean number of values at each level above which values are in steps."""

ENOUGH = 50
"""Number of samples that a bin needs to limit the slope of the noise."""


def noise_terms(matrix: PSFMatrix, light: F4, left: F4, valid: Flags) -> tuple[float, float]:
    """Return the constant and slope of the noise variance, as stated in H or else from the residuals of patterns."""
    known = matrix.facts.noise
    if known is not None and np.isfinite(known).all(-1).any():
        constant, slope = np.median(np.asarray(known, np.float64)[np.isfinite(known).all(-1)], axis=0)
        return float(constant), float(slope)
    constant, slope, _ = _terms(*_bins(left, np.maximum(light, 0), valid), left[valid])
    return constant, slope


def noise_of(matrix: PSFMatrix, index: NDArray[np.intp], light: F4, constant: float, slope: float) -> F4:
    """Return the noise variance of samples ``(n, nt, ns)``, as stated in H, or else ``constant + slope * light``."""
    known = matrix.facts.noise
    own = None if known is None else np.asarray(known, np.float32)[tuple(index.T)]
    if own is None or not np.isfinite(own).all():
        return (constant + slope * light).astype(np.float32)
    found: F4 = own[:, 0, None, None] + own[:, 1, None, None] * light
    return found


def misfit(left: F4, light: F4, valid: Flags, noise: F4) -> float:
    """Return the residual of the median pattern beyond noise, as a fraction of the light (relative L2)."""
    beside = np.where(valid, np.square(left) - noise, 0.0).sum((1, 2), dtype=np.float64)
    power = np.where(valid, np.square(light), 0.0).sum((1, 2), dtype=np.float64)
    seen = valid.any((1, 2))  # completely masked patterns contain no information
    if not seen.any():
        return 0.0
    # in a pattern that should have no light, nothing is explained
    share = np.divide(beside, power, out=np.ones_like(beside), where=power > 0)[seen]
    return math.sqrt(max(0.0, float(np.median(share))))


def start_of(data: F4, valid: Flags) -> F4:
    """Return a constant variance, from the median difference between neighbouring samples of a row."""
    steps = (data[:, :, 1:] - data[:, :, :-1])[valid[:, :, 1:] & valid[:, :, :-1]]
    spread = 1.4826 * float(np.median(np.abs(steps))) / math.sqrt(2) if steps.size else 1.0
    least = 1e-6 * max(float(np.abs(data).max()), 1e-30)
    return np.full(data.shape, max(spread, least) ** 2, np.float32)


def rounding_of(data: F4, model: F4, valid: Flags) -> float:
    """Return a lower limit of the variance if many values are equal due to rounding or clipping at zero; otherwise 0.

    In this case, the medians of residuals do not show the noise.
    """
    some = data[valid]
    some = some[:: max(1, some.size // LOOKED_AT)]
    levels = np.unique(some)
    found = 0.0
    if len(levels) > 1 and len(levels) * EACH < some.size:
        found = float(np.quantile(np.diff(levels.astype(np.float64)), 0.25)) ** 2 / 12
    dark = data[valid & (model < DARK * float(model.max()))]
    if dark.size >= FEW and np.unique(dark, return_counts=True)[1].max() > SAME * dark.size:
        found = max(found, float(np.var(np.clip(dark, *np.quantile(dark, (0.005, 0.995))), dtype=np.float64)))
    return found


def variance_of(residual: F4, light: F4, valid: Flags) -> tuple[F4, float, float]:
    """Return the variance constant + slope v + (share v)² for samples of brightness v, and constant and slope of noise.

    The terms are fitted to the medians over bins of brightness. Errors of the model grow with brightness, too, so the
    slope of the noise is the smallest of any bin.
    """
    bins, top = _bins(residual, light, valid)
    constant, slope, square = _terms(bins, top, residual[valid])
    out = constant + slope * light + square * np.square(light)
    mean, _, variance, count = bins
    sure = (count >= ENOUGH) & (slope * mean > constant)
    quiet = float(((variance - constant)[sure] / mean[sure]).min()) if sure.any() else 0.0
    return out.astype(np.float32), constant, min(slope, max(0.0, quiet))


def _bins(residual: F4, light: F4, valid: Flags) -> tuple[F8, float]:
    """Return the values of bins of brightness, and the largest brightness.

    The values ``(4, n)`` are the mean and the mean square of the brightness, the variance, and the sample count.
    """
    v, r = light[valid].astype(np.float64), residual[valid].astype(np.float64)
    top = float(v.max()) if v.size else 0.0
    if top <= 0:
        return np.empty((4, 0)), top
    edges = np.concatenate([[-1.0], top * np.geomspace(1e-5, 1, BINS)])
    which = np.digitize(v, edges[1:-1]).astype(np.uint8)
    order = np.argsort(which, kind="stable")
    ends = np.cumsum(np.bincount(which, minlength=BINS))[:-1]
    rows = [
        (float(np.mean(v[own])), float(np.mean(v[own] ** 2)), float(np.median(r[own] ** 2)) / 0.4549, own.size)
        for own in np.split(order, ends)
        if own.size >= FEW
    ]
    return np.array(rows, np.float64).reshape(-1, 4).T, top


def _terms(bins: F8, top: float, residual: F4) -> tuple[float, float, float]:
    mean, squares, variance, _ = bins
    if not mean.size:
        return max(float(np.var(residual, dtype=np.float64)) if residual.size else 1.0, 1e-30), 0.0, 0.0
    a, y = np.stack([np.ones_like(mean), mean, squares], 1), np.maximum(variance, 1e-30 * top**2)
    # all bins have the same weight, because errors are relative
    scale = np.where(a.max(0) > 0, a.max(0), 1.0)
    found, _ = nnls(a / scale / y[:, None], np.ones(len(y)))
    constant, slope, square = found / scale
    return max(float(constant), 1e-12 * top**2), float(slope), float(square)
