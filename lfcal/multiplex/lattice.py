"""Super-pixels of any pitch and angle: light fields behind a real lenslet lattice or mask.

A channel of a sample is interpolated linearly between pixels and between super-pixels. Each pixel contributes with its
interpolation coefficient h and its weight w: ``c = sum h w f / sum h w``. If all of its pixels have weight 0, those of
the same channel within two super-pixels are used. Decorrelation is weighted least squares. Its noise is computed from
the pixels, because neighbouring channels may share some.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, check_choice, check_number, check_tuple, format_pixels
from lfcal.lattice import MicroImageLattice, ViewGrid, sample_views, view_grid
from lfcal.multiplex.demultiplexing import check_frame
from lfcal.multiplex.modulator import Modulator
from lfcal.multiplex.weighted import WeightedSamples, measured, weighted_inverse

__all__ = [
    "channel_grid",
    "demultiplex_lattice",
    "demultiplex_lattice_weighted",
    "lattice_channels",
    "lattice_channels_weighted",
]

Array = NDArray[np.float64]

REACH = 2.5
"""Half width of the triangular weights that fill missing super-pixels from their neighbours (super-pixels)."""

NOTHING = 1e-12
VALUES_AT_ONCE = 2_000_000


class Offsets(NamedTuple):
    """Number of channels (down, across) around the centre of a super-pixel, and the distance between them (pixels)."""

    number: tuple[int, int]
    step_px: tuple[float, float]

    def of(self, channel: int) -> Array:
        """Return the offset ``(row, column)`` of a channel (row-major index) from its super-pixel's centre (pixels)."""
        place = np.divmod(channel, self.number[1])
        return np.array([(k - (n - 1) / 2) * s for k, n, s in zip(place, self.number, self.step_px, strict=True)])


class _Source(NamedTuple):
    """Data from which samples are computed.

    The fields are the grid of super-pixels, the fractions of super-pixels in each sample, the shape of the frame, its
    light times the square root of the weights, and the weights of the pixels. The fractions are sparse matrices, of
    which ``wide`` includes the surrounding super-pixels.
    """

    grid: ViewGrid
    near: Any
    wide: Any
    shape: tuple[int, int]
    light: Array
    weights: Array


class _Pixels(NamedTuple):
    """Fractions ``(samples, pixels)`` of pixels in each sample; ``at`` contains the pixels' indices in the frame."""

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
    """Return the samples ``(N, rows, columns)`` on a grid of super-pixels, and their standard deviations.

    Parameters
    ----------
    frame, weights
        Frame ``(rows, columns)``, and inverse variances of its pixels; 0 for pixels without a measurement.
    grid
        Grid of the super-pixels.
    offsets
        Channels of each super-pixel.
    matrix
        Response ``(channels, N)`` of the channels to the samples. None: the channels are the samples.
    rcond
        Threshold of the decorrelation, as in `lfcal.multiplex.weighted.least_squares`.
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
    if matrix is None:  # channel by channel: the channels of a large frame may not fit into memory together
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
    """Return the fractions of the super-pixels in each sample as a sparse matrix ``(samples, super-pixels)``."""
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
    """Return the fractions ``h sqrt(w) / sum h w`` of pixels in a channel; the sum of squares is the variance."""
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
    """Return the fractions of pixels in each sample at ``offset`` from the super-pixels' centres (linear)."""
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
    """Return samples ``(N, n)`` and their variances for n positions, from the channels of the pixels."""
    from scipy.sparse import bsr_array, csr_array

    values = np.array([one.shares @ light[one.at] for one in read])
    spread = np.array([one.shares.power(2).sum(axis=1) for one in read])
    trust = np.where(spread > 0, 1 / np.where(spread > 0, spread, 1.0), 0.0)
    inverse, lost = weighted_inverse(matrix, trust, rcond)
    demix = inverse @ (matrix.T * trust.T[:, None, :])  # (positions, N, channels)
    found = np.einsum("pnk,kp->np", demix, values)
    places, count, channels = demix.shape
    # rows by position, then channel; pixels renumbered, because most of the frame's belong to other positions
    rows = [np.repeat(np.arange(places) * channels + k, np.diff(one.shares.indptr)) for k, one in enumerate(read)]
    pixels = [one.at[one.shares.indices] for one in read]
    at, columns = np.unique(np.concatenate(pixels), return_inverse=True)
    data = np.concatenate([one.shares.data for one in read])
    shares = csr_array((data, (np.concatenate(rows), columns.ravel())), shape=(places * channels, len(at)))
    block = bsr_array((demix, np.arange(places), np.arange(places + 1)), shape=(places * count, places * channels))
    variance = (block.tocsr() @ shares).power(2).sum(axis=1).reshape(places, count)
    variance[lost] = np.inf
    return found, variance.T


LATTICE_FILTERS = ("nearest", "linear", "cubic")


def lattice_channels(
    frame: ArrayLike,
    lattice: MicroImageLattice,
    size: int | tuple[int, int],
    *,
    spacing_px: float | tuple[float, float] | None = 1.0,
    filter: str = "linear",
    axes: str = "lattice",
    weights: ArrayLike | None = None,
    out: NDArray[Any] | None = None,
    workers: int | None = None,
) -> NDArray[Any]:
    """Sample each super-pixel on a grid of ``size`` points; return the channels ``(down, across, rows, columns)``.

    Parameters
    ----------
    frame
        Frame ``(rows, columns)`` after background subtraction.
    lattice
        Lattice of the super-pixels: a `SuperPixelLattice`, a `lfcal.lattice.LatticeFit`, or the result of
        `lfcal.lattice.lattice_of` for a camera. The pitch need not be a whole number of pixels, the lattice may be
        rotated, and its rows may be curved.
    size
        Number of channels (down, across) around the centre of each super-pixel; one number applies to both axes.
    spacing_px
        Distance between channels (px), one number or (down, across). None: the pitch divided by ``size``.
    filter
        Interpolation between pixels: ``"nearest"``, ``"linear"`` or ``"cubic"``. Interpolation between super-pixels, if
        any, is linear.
    axes
        Axes of the output grid. ``"lattice"``: the super-pixels themselves, in the largest box along the axes of the
        lattice. ``"frame"``: parallel to the frame, interpolated between super-pixels (`lfcal.lattice.view_grid`).
    weights
        Weight of each pixel, ``(rows, columns)``: its inverse variance, or 0 for saturated and dead pixels
        (`pixel_weights`). ``filter`` must then be ``"linear"``. `lattice_channels_weighted` also returns the noise.
    out
        Array to fill, ``(down, across, rows, columns)``, float32 or float64; it is also returned. None: a new array.
    workers
        Number of threads; not used with ``weights``. None: one for each available CPU core.

    Raises
    ------
    InputError
        If no super-pixel is completely inside the frame, or an option is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.multiplex import SuperPixelLattice, lattice_channels
    >>> lattice = SuperPixelLattice("square", (5.0, 5.0), (10.5, 0.0), (0.0, 10.5))
    >>> columns = np.tile(np.arange(48.0), (48, 1))  # the value of each pixel is its column
    >>> channels = lattice_channels(columns, lattice, 3)
    >>> print(channels.shape)
    (3, 3, 4, 4)
    >>> print(channels[1, :, 0].round(3))
    [[ 4.  14.5 25.  35.5]
     [ 5.  15.5 26.  36.5]
     [ 6.  16.5 27.  37.5]]
    """
    check_choice("filter", filter, LATTICE_FILTERS)
    if weights is not None:
        _check_linear("spatial", filter)
        weighed = lattice_channels_weighted(frame, lattice, size, weights, spacing_px=spacing_px, axes=axes).samples
        filled = _output(out, weighed.shape, np.asarray(frame).dtype)
        filled[:] = weighed
        return filled
    image = check_frame(frame, (1, 1))
    grid, count, step = _channel_grid(image.shape, lattice, size, spacing_px, axes)
    result = _output(out, (*count, *grid.shape), image.dtype)
    return sample_views(image, grid, result, step_px=step, filter=filter, workers=workers)


def _check_linear(route: str, filter: str) -> None:
    """Raise `InputError` unless route and filter support weights."""
    if (route, filter) != ("spatial", "linear"):
        remedy = "choose the route spatial with the filter linear, or omit the weights"
        raise InputError.expected(
            "reconstruction with weights",
            "the route spatial with the filter linear",
            f"the route {route} with the filter {filter}",
            remedy,
        )


def lattice_channels_weighted(
    frame: ArrayLike,
    lattice: MicroImageLattice,
    size: int | tuple[int, int],
    weights: ArrayLike,
    *,
    spacing_px: float | tuple[float, float] | None = 1.0,
    axes: str = "lattice",
) -> WeightedSamples:
    """Return measurement channels, as in `lattice_channels`, from weighted pixels, and their standard deviations.

    Interpolation is linear between pixels and super-pixels, with the weight of each pixel. All pixels of a channel at
    an output position may have the weight 0. Pixels of the same channel in super-pixels up to two rows and columns away
    are then used.

    Parameters
    ----------
    weights
        Inverse variances of the pixels, ``(rows, columns)``. Pixels with the weight 0 are ignored and may have any
        value, even NaN.
    frame, lattice, size, spacing_px, axes
        As in `lattice_channels`.

    Returns
    -------
    WeightedSamples
        Channels ``(down, across, rows, columns)`` with their standard deviations, which are infinite where nothing was
        measured.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.multiplex import SuperPixelLattice, lattice_channels_weighted
    >>> lattice = SuperPixelLattice("square", (5.0, 5.0), (10.5, 0.0), (0.0, 10.5))
    >>> frame, weights = np.full((48, 48), 7.0), np.full((48, 48), 100.0)  # deviation 0.1
    >>> frame[5, 5], weights[5, 5] = np.nan, 0  # dead: the first centre
    >>> found = lattice_channels_weighted(frame, lattice, 3, weights)
    >>> print(found.samples[1, 1, 0, 0].round(3), found.deviation[1, 1, 0, 1:].round(3))  # centres 15.5, 26, 36.5
    7.0 [0.071 0.1   0.071]
    """
    seen, known = measured(frame, weights)
    image = check_frame(seen, (1, 1)).astype(float)
    grid, count, step = _channel_grid(image.shape, lattice, size, spacing_px, axes)
    found = weighted_samples(image, known, grid, Offsets((count[0], count[1]), step))
    shape = (*count, *grid.shape)
    return WeightedSamples(found.samples.reshape(shape), found.deviation.reshape(shape))


def channel_grid(
    shape: tuple[int, ...],
    lattice: MicroImageLattice,
    size: int | tuple[int, int],
    *,
    spacing_px: float | tuple[float, float] | None = 1.0,
    axes: str = "lattice",
) -> ViewGrid:
    """Return the grid of super-pixels that `lattice_channels` uses in a frame of the shape ``(rows, columns)``.

    The other parameters are those of `lattice_channels`.

    Raises
    ------
    InputError
        As in `lattice_channels`.

    Examples
    --------
    >>> from lfcal.multiplex import SuperPixelLattice, channel_grid
    >>> lattice = SuperPixelLattice("square", (5.0, 5.0), (10.5, 0.0), (0.0, 10.5))
    >>> grid = channel_grid((64, 96), lattice, 9)
    >>> print(grid.shape, "super-pixels lie wholly in the frame, from", grid.corner_px)
    (6, 9) super-pixels lie wholly in the frame, from (5.0, 5.0)
    """
    return _channel_grid(shape, lattice, size, spacing_px, axes)[0]


def _channel_grid(
    shape: tuple[int, ...],
    lattice: MicroImageLattice,
    size: int | tuple[int, int],
    spacing_px: float | tuple[float, float] | None,
    axes: str,
) -> tuple[ViewGrid, tuple[int, ...], tuple[float, float]]:
    """Return the grid of super-pixels, and the number and the distance of their channels."""
    pair = (size, size) if isinstance(size, int | np.integer) else size
    count = check_tuple("channels of a super-pixel", pair, 2, at_least=1, at_most=512, integer=True)
    step = _spacing(spacing_px, lattice, count)
    half = ((count[0] - 1) / 2 * step[0], (count[1] - 1) / 2 * step[1])
    grid = view_grid(lattice, shape, max(half), axes=axes)
    if not min(grid.shape):
        raise InputError.expected(
            "frame",
            f"at least one complete super-pixel of {2 * half[0] + 1:.0f} x {2 * half[1] + 1:.0f} px",
            format_pixels(shape),
            "give a larger frame, or choose fewer views",
        )
    return grid, count, step


def _output(out: NDArray[Any] | None, shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return ``out``; if it is None, a new array, float64 for float64 frames and float32 for others."""
    if out is None:
        return np.empty(shape, np.float64 if dtype == np.float64 else np.float32)
    if out.shape != shape or out.dtype not in (np.float32, np.float64):
        raise InputError.expected(
            "output array",
            f"a float32 or float64 array of shape {shape}",
            f"{out.dtype} of shape {out.shape}",
            "allocate an array of this kind",
        )
    return out


def _spacing(
    spacing: float | tuple[float, float] | None, lattice: MicroImageLattice, count: tuple[int, ...]
) -> tuple[float, float]:
    if spacing is None:
        spacing = (lattice.row_pitch_px / count[0], lattice.pitch_px / count[1])
    pair = spacing if isinstance(spacing, tuple) else (spacing, spacing)
    for value in check_tuple("spacing of channels (px)", pair, 2):
        check_number("spacing of channels (px)", value, above=0, at_most=1e3)
    return float(pair[0]), float(pair[1])


def demultiplex_lattice(
    frame: ArrayLike,
    lattice: MicroImageLattice,
    modulator: Modulator,
    *,
    route: str = "spatial",
    filter: str = "linear",
    axes: str = "lattice",
    rcond: float | None = None,
    weights: ArrayLike | None = None,
    workers: int | None = None,
) -> NDArray[Any]:
    """Return the views of a light field, ``(N, rows, columns)``, on a lattice of any pitch and angle.

    Parameters
    ----------
    frame, lattice, axes, workers
        As in `lattice_channels`.
    modulator
        Modulator of one super-pixel of a light field; its pixels are at equal steps along the vectors of the lattice.
    route
        ``"spatial"`` (Ihrke et al., theorem 1), or ``"fourier"`` (theorem 2), which uses tiles of the spectrum around
        the frequencies of the lattice. The latter is equivalent to the spatial route with a sinc filter if the spectrum
        of the frame is zero between the tiles. It requires one Fourier transform of the frame and one for each pixel of
        a super-pixel.
    filter
        Interpolation of the spatial route: ``"nearest"``, ``"linear"`` or ``"cubic"`` between pixels, as if all
        channels of a super-pixel were recorded at its centre. ``"sinc"`` interpolates between super-pixels, with each
        channel at its actual position.
    rcond
        Singular values of `Modulator.matrix` up to this fraction of the largest one count as zero. None:
        `default_rcond`. With ``weights``, the singular values are those of the weighted matrix W^(1/2) A at each output
        position. The default is then 1e-5.
    weights
        As in `lattice_channels`; only for the spatial route with the linear filter. `demultiplex_lattice_weighted` also
        returns the noise.

    Raises
    ------
    InputError
        If the modulator is not a single super-pixel of a light field, or no super-pixel is completely inside the frame.
        For the route ``"fourier"`` and the filter ``"sinc"``, also if the lattice is distorted.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.multiplex import SuperPixelLattice, demultiplex_lattice, lattice_transmissions, mask
    >>> lattice = SuperPixelLattice("square", (5.0, 5.0), (10.5, 0.1), (-0.1, 10.5))
    >>> seen = lattice_transmissions((64, 96), lattice, mask("sum_of_sinusoids", 3), profile="sinusoids")
    >>> frame = np.tensordot(np.arange(1, 10), seen, 1)  # the first view is 1, the last 9
    >>> views = demultiplex_lattice(frame, lattice, mask("sum_of_sinusoids", 3), filter="cubic")
    >>> print(views.shape, views.mean(axis=(1, 2)).round())
    (9, 6, 9) [1. 2. 3. 4. 5. 6. 7. 8. 9.]
    """
    _check_single(modulator)
    check_choice("route", route, ("spatial", "fourier"))
    check_choice("filter", filter, (*LATTICE_FILTERS, "sinc"))
    if weights is not None:
        _check_linear(route, filter)
        found = demultiplex_lattice_weighted(frame, lattice, modulator, weights, axes=axes, rcond=rcond).samples
        return found if np.asarray(frame).dtype == np.float64 else found.astype(np.float32)
    if route == "fourier" or filter == "sinc":
        return _by_waves(check_frame(frame, (1, 1)), lattice, modulator, route, axes, rcond)
    channels = lattice_channels(
        frame, lattice, modulator.side, spacing_px=None, filter=filter, axes=axes, workers=workers
    )
    flat = channels.reshape(modulator.pixels, -1)
    inverse = modulator.inverse(rcond).astype(channels.dtype)
    views: NDArray[Any] = (inverse @ flat).reshape(modulator.count, *channels.shape[2:])
    return views


def _check_single(modulator: Modulator) -> None:
    if modulator.side != modulator.cell:
        raise InputError.expected(
            "modulator on a lattice",
            "a square super-pixel that samples only views",
            modulator.name,
            "choose a mask or lenslets, and separate the colours of the frame first",
        )


def demultiplex_lattice_weighted(
    frame: ArrayLike,
    lattice: MicroImageLattice,
    modulator: Modulator,
    weights: ArrayLike,
    *,
    axes: str = "lattice",
    rcond: float | None = None,
) -> WeightedSamples:
    """Return the views of a light field, and their standard deviations, on a lattice by weighted least squares.

    Channels are computed as in `lattice_channels_weighted` and decorrelated with the resulting weights. The standard
    deviations take into account that adjacent channels share pixels if the pitch is not a whole number of pixels. Both
    arrays have the shape ``(N, rows, columns)``.

    Parameters
    ----------
    weights
        Inverse variances of the pixels, ``(rows, columns)``. Pixels with the weight 0 are ignored and may have any
        value, even NaN.
    frame, lattice, modulator, axes, rcond
        As in `demultiplex_lattice`.

    Raises
    ------
    InputError
        As in `demultiplex_lattice`, and if a weight is negative or all weights are zero.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.multiplex import SuperPixelLattice, demultiplex_lattice_weighted, mask
    >>> lattice = SuperPixelLattice("square", (1.0, 1.0), (3.0, 0.0), (0.0, 3.0))
    >>> frame, weights = np.full((30, 30), 9.0), np.full((30, 30), 4.0)  # deviation 0.5
    >>> frame[4, 4], weights[4, 4] = np.nan, 0  # dead: the middle of a super-pixel
    >>> found = demultiplex_lattice_weighted(frame, lattice, mask("pinhole", 3), weights)
    >>> print(found.samples.shape, found.samples[4, 1, 1].round(3), found.deviation[4, 0, 0].round(3))
    (9, 10, 10) 9.0 0.5
    """
    from lfcal.multiplex.weighted import measured

    _check_single(modulator)
    seen, known = measured(frame, weights)
    image = check_frame(seen, (1, 1)).astype(float)
    grid, count, step = _channel_grid(image.shape, lattice, modulator.side, None, axes)
    return weighted_samples(image, known, grid, Offsets((count[0], count[1]), step), modulator.matrix, rcond)


def _by_waves(
    image: NDArray[Any], lattice: MicroImageLattice, modulator: Modulator, route: str, axes: str, rcond: float | None
) -> NDArray[Any]:
    from lfcal.multiplex.heterodyne import lattice_by_sinc, lattice_by_spectrum, sample_places

    grid = channel_grid(image.shape, lattice, modulator.side, spacing_px=None, axes=axes)
    solve = lattice_by_spectrum if route == "fourier" else lattice_by_sinc
    views = solve(image, lattice, modulator, sample_places(grid), rcond).reshape(modulator.count, *grid.shape)
    return views if image.dtype == np.float64 else views.astype(np.float32)
