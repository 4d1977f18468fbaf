"""Super-pixels of any pitch and angle: light fields behind a real lenslet lattice or mask."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, check_choice, check_number, check_tuple
from lfcal.lattice import MicroImageLattice, ViewGrid, sample_views, view_grid
from lfcal.multiplex.demultiplexing import check_frame
from lfcal.multiplex.modulator import Modulator

if TYPE_CHECKING:
    from lfcal.multiplex.weighted import WeightedSamples

__all__ = [
    "LATTICE_FILTERS",
    "channel_grid",
    "demultiplex_lattice",
    "demultiplex_lattice_weighted",
    "lattice_channels",
    "lattice_channels_weighted",
]

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
    """Return ``size`` measurement channels of each super-pixel, ``(size, size, rows, columns)``.

    Parameters
    ----------
    frame
        ``(rows, columns)``, background subtracted.
    lattice
        Where the super-pixels lie: a `SuperPixelLattice`, a `lfcal.lattice.LatticeFit`, or `lfcal.lattice.lattice_of` a
        camera. Neither pitch nor angle need fit the pixels, nor need the lattice be straight.
    size
        Channels down and across, about each centre.
    spacing_px
        Distance of channels (pixels), or down and across; None divides the pitch by ``size``.
    filter
        ``"nearest"``, ``"linear"`` or ``"cubic"`` between pixels; between super-pixels it is linear.
    axes
        ``"lattice"``: rows of super-pixels as they are, in the largest box of the lattice's own axes; ``"frame"``:
        upright in the frame, between super-pixels (`lfcal.lattice.view_grid`).
    weights
        Weight of each pixel ``(rows, columns)``: its inverse variance, 0 where it measured nothing (saturated, dead;
        `lfcal.multiplex.pixel_weights`). The filter is then linear (`lattice_channels_weighted` also tells the noise).
    out
        float32 or float64 array to write to.
    workers
        Threads.

    Raises
    ------
    InputError
        If no super-pixel lies wholly in the frame, or an option is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.multiplex import SuperPixelLattice, lattice_channels
    >>> lattice = SuperPixelLattice("square", (5.0, 5.0), (10.5, 0.0), (0.0, 10.5))
    >>> columns = np.tile(np.arange(48.0), (48, 1))  # each pixel tells its column
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
    """Raise unless the route and the filter are those that take weights."""
    if (route, filter) != ("spatial", "linear"):
        remedy = "take route spatial, filter linear, or leave the weights out"
        raise InputError.expected("route with weights", "spatial, linear", f"{route}, {filter}", remedy)


def lattice_channels_weighted(
    frame: ArrayLike,
    lattice: MicroImageLattice,
    size: int | tuple[int, int],
    weights: ArrayLike,
    *,
    spacing_px: float | tuple[float, float] | None = 1.0,
    axes: str = "lattice",
) -> WeightedSamples:
    """Return measurement channels ``(size, size, rows, columns)`` from what the pixels that count measured.

    Linear between pixels and super-pixels, each pixel by its weight; where none of a channel's has any, those of the
    super-pixels within two rows and columns count.

    Parameters
    ----------
    weights
        Inverse variances ``(rows, columns)``, 0 where nothing was measured, which may then be anything.
    frame, lattice, size, spacing_px, axes
        As in `lattice_channels`.

    Returns
    -------
    WeightedSamples
        With the standard deviation of each; infinite where nothing was measured.

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
    from lfcal.multiplex._lattice_taps import Offsets, weighted_samples
    from lfcal.multiplex.weighted import WeightedSamples, measured

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
    """Return which super-pixels of a frame of ``shape`` `lattice_channels` takes; raises as it does.

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
    """Return the super-pixels, and number and distance of their channels."""
    pair = (size, size) if isinstance(size, int | np.integer) else size
    count = check_tuple("channels of a super-pixel", pair, 2, at_least=1, at_most=512, integer=True)
    step = _spacing(spacing_px, lattice, count)
    half = ((count[0] - 1) / 2 * step[0], (count[1] - 1) / 2 * step[1])
    grid = view_grid(lattice, shape, max(half), axes=axes)
    if not min(grid.shape):
        raise InputError.expected(
            "frame",
            f"a super-pixel of {2 * half[0] + 1:.0f} x {2 * half[1] + 1:.0f} px wholly inside",
            f"{shape} px",
            "give a larger frame or fewer views",
        )
    return grid, count, step


def _output(out: NDArray[Any] | None, shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return ``out``, or an array where it is None: float64 for frames of float64, else float32."""
    if out is None:
        return np.empty(shape, np.float64 if dtype == np.float64 else np.float32)
    if out.shape != shape or out.dtype not in (np.float32, np.float64):
        raise InputError.expected(
            "output array", f"float32 or float64 {shape}", f"{out.dtype} {out.shape}", "allocate it like this"
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
    """Return the views of a light field whose super-pixels are no whole pixels, ``(N, rows, columns)``.

    Parameters
    ----------
    frame, lattice, axes, workers
        As in `lattice_channels`.
    modulator
        One super-pixel of a light field; its values lie at equal steps of the lattice's vectors.
    route
        ``"spatial"`` (theorem 1) or ``"fourier"`` (theorem 2): tiles of the spectrum about the lattice's own
        frequencies, whatever its pitch and angle, which equals the spatial route with a sinc where the frame holds
        nothing between the tiles. It takes a transform of the frame for each pixel of a super-pixel.
    filter
        Of the spatial route: ``"nearest"``, ``"linear"`` or ``"cubic"`` between pixels, the channels of a super-pixel
        counting as taken at its centre; or ``"sinc"`` between super-pixels, each channel at its own place
        (`lfcal.multiplex.heterodyne`).
    rcond
        Singular values up to this share of the largest count as zero.
    weights
        As in `lattice_channels`: for the spatial route with the filter linear (`demultiplex_lattice_weighted` also
        tells the noise).

    Raises
    ------
    InputError
        If the modulator is no single light-field super-pixel, or the frame holds none.

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
            "one super-pixel of a light field",
            modulator.name,
            "part the colours first (lfcal.frames.channel_source)",
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
    """Return the views ``(N, rows, columns)`` behind a real lattice and their deviation, by weighted least squares.

    Channels are read as `lattice_channels_weighted` does and decorrelated with the weights that follow (theorem 1 with
    noise). The deviation counts that neighbouring channels share pixels where the pitch is no whole number.

    Parameters
    ----------
    weights
        Inverse variances ``(rows, columns)``, 0 where nothing was measured, which may then be anything.
    frame, lattice, modulator, axes, rcond
        As in `demultiplex_lattice`.

    Raises
    ------
    InputError
        If a weight is negative or all are zero, or as `demultiplex_lattice` raises.

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
    from lfcal.multiplex._lattice_taps import Offsets, weighted_samples
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
