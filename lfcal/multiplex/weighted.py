"""Weighted reconstruction: saturated and dead pixels are excluded, and others are weighted by their noise."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, array_words
from lfcal.multiplex.filters import tap_table
from lfcal.multiplex.modulator import Modulator

__all__ = ["WeightedSamples", "check_weights", "least_squares", "measured", "reconstruct_weighted", "weighted_inverse"]

Array = NDArray[np.float64]

VALUES_AT_ONCE = 4_000_000
SINGULAR = 1e-10
"""Ratio to the largest eigenvalue up to which eigenvalues are treated as zero by default."""


@dataclass(frozen=True, eq=False)
class WeightedSamples:
    """Demultiplexed samples with their standard deviations.

    Attributes
    ----------
    samples
        Plenoptic samples, ``(N, rows, columns)``; from `lattice_channels_weighted`, measurement channels ``(down,
        across, rows, columns)``.
    deviation
        Standard deviation of each sample, in the same shape and unit, if the weights are inverse variances. It is
        infinite for samples that the pixels do not determine.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.multiplex import WeightedSamples, cfa, demultiplex_weighted
    >>> weights = np.full((8, 8), 25.0)  # 1 / 0.2^2
    >>> found: WeightedSamples = demultiplex_weighted(np.full((8, 8), 0.4), cfa("GR/BG"), weights)
    >>> print(found.samples.shape, found.deviation[:, 4, 4].round(2))  # of R, G, B at a green pixel
    (3, 8, 8) [0.14 0.09 0.14]
    """

    samples: NDArray[Any] = field(repr=False)
    deviation: NDArray[Any] = field(repr=False)


def check_weights(weights: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Return the weights of a frame of ``shape`` as float64 after checking them.

    Raises
    ------
    InputError
        If the weights do not have this shape, are all zero, or include a negative or non-finite value.
    """
    array = np.asarray(weights, float)
    if array.shape != shape or not np.isfinite(array).all() or array.min(initial=0.0) < 0 or not array.any():
        raise InputError.expected(
            "weights of the pixels",
            f"finite values of 0 or more, not all 0, with shape {shape}",
            array_words(array),
            "correct the weights; 0 leaves a pixel out",
        )
    return array


def measured(frame: ArrayLike, weights: ArrayLike | None) -> tuple[NDArray[Any], Array]:
    """Return a frame with pixels of weight 0 set to 0, and the checked weights (None: 1 everywhere)."""
    raw = np.asarray(frame)
    known = np.ones(raw.shape) if weights is None else check_weights(weights, raw.shape)
    return (np.where(known > 0, raw, 0) if raw.dtype.kind in "uif" else raw), known


def reconstruct_weighted(
    frame: NDArray[Any],
    weights: Array,
    modulator: Modulator,
    samples: tuple[int, int],
    rcond: float | None = None,
) -> WeightedSamples:
    """Return the samples of a frame of complete super-pixels, by weighted least squares at every output position.

    Each measurement channel c is interpolated linearly from its pixels with the values f, the interpolation weights h
    and the pixel weights w, ``c = sum h w f / sum h w``. If w are inverse variances, the variance of c is ``sum h^2 w /
    (sum h w)^2``. Then ``(A^T W A) x = A^T W c`` is solved for the samples x. A is the matrix of the modulator (Ihrke
    et al. 2010, theorem 1), and W is the diagonal matrix of the inverse variances of the channels.

    If all pixels from which a channel is interpolated have weight 0, h is a linear kernel with a reach of 2.5
    super-pixels instead. If all pixels within this reach also have weight 0, the channel is omitted. If the remaining
    channels do not determine all samples, the result is the solution of least norm. Samples that are not determined
    have an infinite ``deviation``.

    Parameters
    ----------
    frame, weights
        Frame and weights of its pixels, ``(rows, columns)``; both sides are a whole number of super-pixels.
    modulator
        Modulator of the frame.
    samples
        Number of output samples in a super-pixel along (rows, columns).
    rcond
        Eigenvalues of A^T W A that are at most ``rcond**2`` times the largest one are treated as zero; factors below
        1e-15 are replaced by 1e-15. None: a factor of 1e-10.
    """
    axes = [_axis(*args) for args in zip(frame.shape, modulator.side, modulator.positions, samples, strict=True)]
    light, scale = np.where(weights > 0, frame, 0.0), float(weights.max())
    weights = weights / scale
    size = tuple(n // side * m for n, side, m in zip(frame.shape, modulator.side, samples, strict=True))
    out, deviation = np.empty((2, modulator.count, *size))
    rows = max(1, VALUES_AT_ONCE // (size[1] * max(modulator.pixels, modulator.count**2)))
    for start in range(0, size[0], rows):
        part = slice(start, min(start + rows, size[0]))
        channels, trust = _channels(light, weights, modulator.side, axes, part)
        found, variance = least_squares(modulator.matrix, channels, trust, rcond)
        shape = (modulator.count, -1, size[1])
        out[:, part], deviation[:, part] = found.reshape(shape), np.sqrt(variance / scale).reshape(shape)
    return WeightedSamples(out, deviation)


def _axis(length: int, side: int, positions: Array, samples: int) -> list[tuple[Any, Any]]:
    """Return two interpolations for each pixel along the super-pixel as sparse matrices ``(output, super-pixels)``.

    The first is linear. The second is a linear kernel with 2.5 times its reach, used where pixels are missing.
    """
    first, weight = tap_table("linear", side, positions, samples)
    wanted = (np.arange(samples) + 0.5) * side / samples - 0.5
    place = (wanted[:, None] - positions) / side
    near = np.floor(place + 0.5).astype(np.intp) - 2
    wide = np.maximum(0.0, 1 - np.abs(place[..., None] - near[..., None] - np.arange(5)) / 2.5)
    cells = length // side
    return [(_taps(first[:, a], weight[:, a], cells), _taps(near[:, a], wide[:, a], cells)) for a in range(side)]


def _taps(first: NDArray[np.intp], weight: Array, cells: int) -> Any:
    """Return the sparse matrix of taps ``(samples, taps)`` of one pixel over all super-pixels."""
    from scipy.sparse import csr_array

    places = np.arange(cells * len(first))
    cell, phase = np.divmod(places, len(first))
    columns = np.clip(cell[:, None] + first[phase][:, None] + np.arange(weight.shape[1]), 0, cells - 1)
    shape = (len(places), cells)
    return csr_array((weight[phase].ravel(), (np.repeat(places, weight.shape[1]), columns.ravel())), shape=shape)


def _channels(light: Array, weights: Array, side: tuple[int, int], axes: list[Any], part: slice) -> tuple[Array, Array]:
    """Return values and weights ``(K, n)`` of the channels at the n positions in some rows of the output."""
    down, across = axes
    values, trust = [], []
    for k in range(side[0] * side[1]):
        a, b = divmod(k, side[1])
        f, w = light[a :: side[0], b :: side[1]], weights[a :: side[0], b :: side[1]]
        value, sure = _weighed(f, w, down[a][0][part], across[b][0])
        if not sure.all():
            other, less = _weighed(f, w, down[a][1][part], across[b][1])
            value, sure = np.where(sure > 0, value, other), np.where(sure > 0, sure, less)
        values.append(value.ravel())
        trust.append(sure.ravel())
    return np.array(values), np.array(trust)


def _weighed(f: Array, w: Array, down: Any, across: Any) -> tuple[Array, Array]:
    """Return the weighted mean of a channel at each position, and its weight; 0 where all weights are 0."""
    total = (down @ w) @ across.T
    squared = (down.multiply(down) @ w) @ across.multiply(across).T
    some = total > 1e-12
    safe = np.where(some, total, 1.0)
    value = ((down @ (w * f)) @ across.T) / safe
    return np.where(some, value, 0.0), np.where(some, safe**2 / np.where(some, squared, 1.0), 0.0)


def least_squares(matrix: Array, values: Array, weights: Array, rcond: float | None = None) -> tuple[Array, Array]:
    """Return the weighted least-squares samples ``(N, n)`` at n positions and their variances, of the same shape.

    ``matrix`` ``(K, N)`` maps samples to channels, whose ``values`` and ``weights`` have the shape ``(K, n)``. If the
    weighted equations do not have full rank, the result is the solution of least norm. Samples that are not determined
    then have infinite variance. ``rcond`` is as in `reconstruct_weighted`.
    """
    inverse, lost = weighted_inverse(matrix, weights, rcond)
    found = np.einsum("pij,pj->ip", inverse, (weights * values).T @ matrix)
    variance = np.einsum("pii->pi", inverse).copy()
    variance[lost] = np.inf
    return found, variance.T


def weighted_inverse(matrix: Array, weights: Array, rcond: float | None = None) -> tuple[Array, NDArray[np.bool_]]:
    """Return ``(A^T W A)^+`` ``(n, N, N)`` for the weights ``(K, n)`` at n positions, and a mask ``(n, N)``.

    A is ``matrix`` ``(K, N)``, and W is the diagonal matrix of the weights at a position. The mask marks samples
    that are not determined. ``rcond`` is as in `reconstruct_weighted`.
    """
    count = matrix.shape[1]
    pairs = (matrix[:, :, None] * matrix[:, None, :]).reshape(len(matrix), -1)
    normal = (weights.T @ pairs).reshape(-1, count, count)
    strengths, vectors = np.linalg.eigh(normal)
    cut = SINGULAR if rcond is None else max(rcond**2, 1e-15)
    kept = (strengths > cut * strengths[:, -1:]) & (strengths > 0)
    scaled = vectors * np.where(kept, 1.0 / np.where(kept, strengths, 1.0), 0.0)[:, None, :]
    lost = np.einsum("pij,pj->pi", vectors**2, ~kept)
    return scaled @ vectors.transpose(0, 2, 1), lost > 1e-9
