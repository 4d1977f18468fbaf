"""Channels and samples on a lattice with weights: from the pixels that measured something, and how sure they are.

A channel of a sample is read linearly between pixels and between super-pixels, each pixel by its share h and its
weight w: ``c = sum h w f / sum h w``. Where none of its pixels carries weight, those of the same channel within two
super-pixels count. Decorrelation is weighted least squares; its noise is followed back to the pixels, of which
neighbouring channels may share some.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.lattice import ViewGrid
from lfcal.multiplex.weighted import WeightedSamples, weighted_inverse

__all__ = ["Offsets", "weighted_samples"]

Array = NDArray[np.float64]

REACH = 2.5
"""Of the hats over super-pixels that stand in for what is missing (super-pixels)."""

NOTHING = 1e-12
VALUES_AT_ONCE = 2_000_000


class Offsets(NamedTuple):
    """Number of channels (down, across) about each centre, and their distance (pixels)."""

    number: tuple[int, int]
    step_px: tuple[float, float]

    def of(self, channel: int) -> Array:
        """Return where a channel, counted by rows, lies from its super-pixel's centre ``(row, column)``."""
        place = np.divmod(channel, self.number[1])
        return np.array([(k - (n - 1) / 2) * s for k, n, s in zip(place, self.number, self.step_px, strict=True)])


class _Source(NamedTuple):
    """What samples are read from.

    The super-pixels, their shares in each sample and those of the super-pixels about it (sparse), the frame's shape,
    its light times the root of the weights, and the weights, by pixel.
    """

    grid: ViewGrid
    near: Any
    wide: Any
    shape: tuple[int, int]
    light: Array
    weights: Array


class _Pixels(NamedTuple):
    """What each sample takes of the pixels: shares ``(samples, pixels)`` of those numbered ``at`` in the frame."""

    shares: Any
    at: NDArray[np.intp]


def weighted_samples(
    frame: Array,
    weights: Array,
    grid: ViewGrid,
    offsets: Offsets,
    matrix: Array | None = None,
    rcond: float | None = None,
) -> WeightedSamples:
    """Return the samples ``(N, rows, columns)`` of a grid of super-pixels, and their deviation.

    Parameters
    ----------
    frame, weights
        ``(rows, columns)``; inverse variances, 0 where nothing was measured.
    grid
        The super-pixels.
    offsets
        Their channels.
    matrix
        ``(channels, N)``: what the channels measured; None: the channels are the samples.
    rcond
        Of the decorrelation, as in `lfcal.multiplex.weighted.least_squares`.
    """
    scale = float(weights.max())
    light, known = np.where(weights > 0, frame, 0.0).ravel(), (weights / scale).ravel()
    near = _shares(grid)
    source = _Source(
        grid, near, _hats(grid.shape) @ near, (frame.shape[0], frame.shape[1]), np.sqrt(known) * light, known
    )
    channels, places = offsets.number[0] * offsets.number[1], near.shape[0]
    count = channels if matrix is None else matrix.shape[1]
    samples, variance = np.empty((2, count, places))
    if matrix is None:  # channel by channel: of large frames not all are held at once
        for k in range(channels):
            read = _weighed(source, offsets.of(k), slice(None))
            spread = read.shares.power(2).sum(axis=1)
            samples[k], variance[k] = read.shares @ source.light[read.at], np.where(spread > 0, spread, np.inf)
    else:
        step = max(1, VALUES_AT_ONCE // max(channels * 8, count * count))
        for start in range(0, places, step):
            part = slice(start, min(start + step, places))
            reads = [_weighed(source, offsets.of(k), part) for k in range(channels)]
            samples[:, part], variance[:, part] = _decorrelated(matrix, reads, source.light, rcond)
    shape = (count, *grid.shape)
    return WeightedSamples(samples.reshape(shape), np.sqrt(variance / scale).reshape(shape))


def _shares(grid: ViewGrid) -> Any:
    """Return the shares of the super-pixels in each sample as a sparse matrix ``(samples, super-pixels)``."""
    from scipy.sparse import csr_array

    samples, most = grid.shape[0] * grid.shape[1], grid.near.shape[2]
    rows = np.repeat(np.arange(samples), most)
    found = csr_array((grid.share.ravel(), (rows, grid.near.ravel())), shape=(samples, len(grid.centres_px)))
    found.eliminate_zeros()
    return found


def _hats(shape: tuple[int, int]) -> Any:
    """Return the sparse matrix ``(samples, samples)`` of hats over the samples within two rows and columns."""
    from scipy.sparse import diags_array, kron

    steps = range(-int(REACH), int(REACH) + 1)
    along = [diags_array([1 - abs(k) / REACH for k in steps], offsets=list(steps), shape=(n, n)) for n in shape]
    return kron(along[0], along[1], format="csr")


def _weighed(source: _Source, offset: Array, part: slice) -> _Pixels:
    """Return a channel as shares ``h sqrt(w) / sum h w`` of pixels, whose squares add up to its variance."""
    from scipy.sparse import diags_array

    near, wide = source.near[part], source.wide[part]
    found = _taps(source, offset, near)
    total = found.shares @ source.weights[found.at]
    if (total <= NOTHING).any():
        there = (total > NOTHING).astype(float)
        found = _taps(source, offset, diags_array(there) @ near + diags_array(1 - there) @ wide)
        total = found.shares @ source.weights[found.at]
    inverse = np.where(total > NOTHING, 1 / np.where(total > NOTHING, total, 1.0), 0.0)
    root = np.sqrt(source.weights[found.at])
    return _Pixels((diags_array(inverse) @ found.shares @ diags_array(root)).tocsr(), found.at)


def _taps(source: _Source, offset: Array, shares: Any) -> _Pixels:
    """Return what each sample takes of the pixels at ``offset`` from its super-pixels' centres, linear between."""
    from scipy.sparse import csr_array

    shares, shape = shares.tocsr(), source.shape
    used, lenses = np.unique(shares.indices, return_inverse=True)
    places = source.grid.centres_px[used] + offset
    first = np.floor(places).astype(np.intp)
    after = places - first
    down, across = (np.stack([1 - after[:, k], after[:, k]], 1) for k in range(2))
    rows, columns = (np.clip(first[:, k, None] + [0, 1], 0, shape[k] - 1) for k in range(2))
    flat = rows[:, :, None] * shape[1] + columns[:, None, :]
    at, index = np.unique(flat.ravel(), return_inverse=True)
    pixels = (np.repeat(np.arange(len(used)), 4), index.ravel())
    taps = csr_array(((down[:, :, None] * across[:, None, :]).ravel(), pixels), shape=(len(used), len(at)))
    mixed = csr_array((shares.data, lenses.ravel(), shares.indptr), shape=(shares.shape[0], len(used)))
    return _Pixels(mixed @ taps, at)


def _decorrelated(matrix: Array, read: list[_Pixels], light: Array, rcond: float | None) -> tuple[Array, Array]:
    """Return samples ``(N, places)`` of the channels read and their variance, pixel by pixel."""
    from scipy.sparse import bsr_array, csr_array

    values = np.array([one.shares @ light[one.at] for one in read])
    spread = np.array([one.shares.power(2).sum(axis=1) for one in read])
    trust = np.where(spread > 0, 1 / np.where(spread > 0, spread, 1.0), 0.0)
    inverse, lost = weighted_inverse(matrix, trust, rcond)
    demix = inverse @ (matrix.T * trust.T[:, None, :])  # (places, N, channels)
    found = np.einsum("pnk,kp->np", demix, values)
    places, count, channels = demix.shape
    # rows by place, then channel; pixels numbered anew, as most of the frame's are of other places
    rows = [np.repeat(np.arange(places) * channels + k, np.diff(one.shares.indptr)) for k, one in enumerate(read)]
    pixels = [one.at[one.shares.indices] for one in read]
    at, columns = np.unique(np.concatenate(pixels), return_inverse=True)
    data = np.concatenate([one.shares.data for one in read])
    shares = csr_array((data, (np.concatenate(rows), columns.ravel())), shape=(places * channels, len(at)))
    block = bsr_array((demix, np.arange(places), np.arange(places + 1)), shape=(places * count, places * channels))
    variance = (block.tocsr() @ shares).power(2).sum(axis=1).reshape(places, count)
    variance[lost] = np.inf
    return found, variance.T
