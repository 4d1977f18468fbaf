"""Convert a frame to plenoptic samples and back, for all modulators, routes and filters."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, check_choice, check_number, check_tuple, format_pixels
from lfcal.multiplex.filters import COLOUR_FILTERS, SPATIAL_FILTERS
from lfcal.multiplex.modulator import Modulator

if TYPE_CHECKING:
    from lfcal.multiplex.weighted import WeightedSamples

__all__ = ["ROUTES", "arrange", "check_frame", "default_filter", "demultiplex", "demultiplex_weighted", "multiplex"]

ROUTES = ("spatial", "fourier")


def demultiplex(
    frame: ArrayLike,
    modulator: Modulator,
    *,
    route: str = "spatial",
    filter: str | None = None,
    samples: int | tuple[int, int] | None = None,
    origin: tuple[int, int] = (0, 0),
    rcond: float | None = None,
    weights: ArrayLike | None = None,
    out: NDArray[Any] | None = None,
    workers: int | None = None,
) -> NDArray[Any]:
    """Reconstruct the plenoptic samples of a frame: colours, views, or both.

    The spatial route interpolates each measurement channel, that is, each pixel of the super-pixel, and decorrelates
    the channels at every position (Ihrke et al., theorem 1). The Fourier route crops and weights tiles of the spectrum
    (theorem 2); it is equivalent to the spatial route with a sinc filter. Combinations of samples that are not
    measured become zero (see `Modulator.lost`).

    Parameters
    ----------
    frame
        Frame ``(rows, columns)`` after background subtraction. If it ends within a super-pixel, this super-pixel is
        completed with pixels of the previous one.
    modulator
        Modulator through which the frame was recorded, for example from `cfa` or `mask`.
    route
        ``"spatial"`` or ``"fourier"``.
    filter
        Interpolation of the spatial route: ``"nearest"``, ``"linear"``, ``"cubic"``, ``"lanczos"``, ``"sinc"``
        (periodic) or ``"bilateral"`` (edge-preserving, guided by the mean over a super-pixel). Colour filter arrays
        also have the demosaicing methods ``"lmmse"`` and ``"directional"``, which do not accept ``rcond``. None:
        ``"linear"`` with ``weights``, ``"cubic"`` with ``rcond``, else `default_filter`.
    samples
        Number of output samples in a super-pixel along each axis, one number or (rows, columns). None: one for each
        pixel for colours, one for each lenslet or mask period for light fields.
    origin
        Pixel ``(row, column)`` of the frame that is the first pixel of a super-pixel.
    rcond
        Singular values of `Modulator.matrix` up to this fraction of the largest one count as zero. None:
        `default_rcond`. With ``weights``, the singular values are those of the weighted matrix W^(1/2) A at each output
        position. The default is then 1e-5.
    weights
        Weight of each pixel, ``(rows, columns)``: its inverse variance, or 0 for saturated and dead pixels
        (`pixel_weights`). Channels are then interpolated linearly from pixels of nonzero weight and decorrelated by
        weighted least squares. `demultiplex_weighted` also returns the noise.
    out
        Array to fill: float32 or float64, C-contiguous, of the shape of the result. None: a new array, float64 for
        float64 frames and float32 for others.
    workers
        Number of threads; not used with ``weights``. None: one for each available CPU core.

    Returns
    -------
    NDArray
        Samples ``(N, rows, columns)`` in the order of `Modulator.sample_names` and in the unit of the frame; `arrange`
        separates views and colours. With one sample for each pixel, there are as many rows and columns as in the frame.

    Raises
    ------
    InputError
        If the frame is smaller than a super-pixel or not finite, or an option is unknown, out of range or cannot be
        combined with the others.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.multiplex import cfa, demultiplex
    >>> frame = np.tile([[0.2, 0.5], [0.5, 0.3]], (8, 8))  # red, green, green, blue
    >>> colours = demultiplex(frame, cfa("Bayer"))
    >>> print(colours.shape, colours[:, 5, 6].round(3))
    (3, 16, 16) [0.2 0.5 0.3]
    """
    from lfcal.multiplex._demosaicing import reconstruct_by_estimation
    from lfcal.multiplex._fourier import reconstruct_fourier
    from lfcal.multiplex._spatial import reconstruct_spatial

    check_choice("route", route, ROUTES)
    if filter is not None:
        check_choice("filter", filter, (*SPATIAL_FILTERS, *COLOUR_FILTERS))
    if weights is not None:
        if route != "spatial" or filter not in (None, "linear"):
            got = f"the route {route} with {f'the filter {filter}' if filter else 'the default filter'}"
            raise InputError.expected(
                "reconstruction with weights",
                "the route spatial with the filter linear",
                got,
                "omit the route and the filter",
            )
        weighed = demultiplex_weighted(frame, modulator, weights, samples=samples, origin=origin, rcond=rcond).samples
        filled = _output(out, weighed.shape, np.asarray(frame).dtype)
        filled[:] = weighed
        return filled
    image = check_frame(frame, modulator.side)
    counts = _samples(samples, modulator)
    at = check_tuple("origin of the super-pixels (px)", origin, 2, integer=True)
    # a frame that begins within a super-pixel corresponds to a shifted modulator
    placed = modulator.shifted(*at) if at != (0, 0) else modulator
    # the last super-pixel is extended, not cut off, so that its pixels keep their channels
    whole = _whole(image, placed.side)
    shape = tuple(n // side * m for n, side, m in zip(whole.shape, placed.side, counts, strict=True))
    cut = tuple(n if m == side else s for n, side, m, s in zip(image.shape, placed.side, counts, shape, strict=True))
    final = (placed.count, *cut)
    chosen = filter or ("cubic" if rcond is not None else default_filter(modulator, counts))
    if chosen in COLOUR_FILTERS and route == "spatial" and rcond is not None:
        raise InputError.expected(
            "cut-off of the singular values",
            f"no cut-off with the filter {chosen}",
            rcond,
            "omit the cut-off, or choose the filter cubic",
        )
    result = _output(out, final, image.dtype)
    target = result if cut == shape else np.empty((placed.count, *shape), result.dtype)
    if route == "fourier":
        reconstruct_fourier(whole, placed, counts, target, rcond)
    elif chosen in COLOUR_FILTERS:
        reconstruct_by_estimation(whole, placed, chosen, target, workers=workers)
    else:
        reconstruct_spatial(whole, placed, placed.inverse(rcond), counts, chosen, target, workers=workers)
    if target is not result:
        result[:] = target[:, : cut[0], : cut[1]]
    return result


def demultiplex_weighted(
    frame: ArrayLike,
    modulator: Modulator,
    weights: ArrayLike,
    *,
    samples: int | tuple[int, int] | None = None,
    origin: tuple[int, int] = (0, 0),
    rcond: float | None = None,
) -> WeightedSamples:
    """Return the samples ``(N, rows, columns)`` of a frame and their standard deviations, by weighted least squares.

    ``weights`` contains the inverse variance of each pixel, ``(rows, columns)``; pixels that are not finite must have
    the weight 0. The other parameters are those of `demultiplex`.

    Raises
    ------
    InputError
        If a weight is negative or all weights are zero, and as in `demultiplex`.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.multiplex import cfa, demultiplex_weighted
    >>> frame, weights = np.tile([[0.2, 0.5], [0.5, 0.3]], (8, 8)), np.full((16, 16), 100.0)  # deviation 0.1
    >>> frame[4, 4], weights[4, 4] = np.nan, 0  # a dead red pixel
    >>> found = demultiplex_weighted(frame, cfa("Bayer"), weights)
    >>> print(found.samples[:, 4, 4].round(3))
    [0.2 0.5 0.3]
    >>> print(found.deviation[:, 8, 8].round(3))  # red of one pixel, green and blue of four
    [0.1  0.05 0.05]
    """
    from lfcal.multiplex.weighted import WeightedSamples, measured, reconstruct_weighted

    seen, known = measured(frame, weights)
    image = check_frame(seen, modulator.side).astype(float)
    counts = _samples(samples, modulator)
    at = check_tuple("origin of the super-pixels (px)", origin, 2, integer=True)
    placed = modulator.shifted(*at) if at != (0, 0) else modulator
    whole, complete = _whole(image, placed.side), _whole(known, placed.side)
    found = reconstruct_weighted(whole, complete, placed, counts, rcond)
    sizes = zip(image.shape, found.samples.shape[1:], placed.side, counts, strict=True)
    rows, columns = (n if m == side else size for n, size, side, m in sizes)
    return WeightedSamples(found.samples[:, :rows, :columns], found.deviation[:, :rows, :columns])


def default_filter(modulator: Modulator, samples: tuple[int, int]) -> str:
    """Return the default spatial filter for ``samples`` (rows, columns) output samples per super-pixel.

    It is ``"directional"`` for colour filter arrays that recover red, green and blue, with one sample per pixel.
    Otherwise it is ``"cubic"``, which does not assume that the samples are correlated.
    """
    from lfcal.multiplex._demosaicing import can_estimate

    image = modulator.colours == ("R", "G", "B") and can_estimate(modulator, samples)
    return "directional" if image and modulator.rank() == modulator.count else "cubic"


def check_frame(frame: ArrayLike, side: tuple[int, int]) -> NDArray[Any]:
    """Return ``frame`` as a C-contiguous array of uint16, float32 or float64.

    The types uint16 and float64 are kept. Integers of 32 bits or more become float64, all other types float32.

    Raises
    ------
    InputError
        If the frame is not a two-dimensional array of finite real numbers, or is smaller than a super-pixel of ``side``
        (rows, columns) pixels.
    """
    image = np.asarray(frame)
    if image.ndim != 2 or image.dtype.kind not in "uif":
        raise InputError.expected(
            "frame",
            "numbers in rows and columns",
            f"{image.dtype} of shape {image.shape}",
            "give one plane, not a colour image",
        )
    if image.shape[0] < side[0] or image.shape[1] < side[1]:
        raise InputError.expected(
            "frame",
            f"at least one super-pixel of {format_pixels(side)}",
            format_pixels(image.shape),
            "give a larger frame, or a modulator of a shorter period",
        )
    if image.dtype.kind == "f":
        if not np.isfinite(image).all():
            raise InputError.expected("frame", "finite values", "NaN or infinity", "correct defective pixels first")
        image = image if image.dtype == np.float64 else image.astype(np.float32, copy=False)
    # float32 represents 8- and 16-bit samples exactly; wider integers need float64
    elif image.dtype != np.uint16:
        image = image.astype(np.float32 if image.dtype.itemsize <= 2 else np.float64)
    return np.ascontiguousarray(image)


def _samples(samples: int | tuple[int, int] | None, modulator: Modulator) -> tuple[int, int]:
    if samples is None:
        return modulator.natural_samples
    pair = (samples, samples) if isinstance(samples, int | np.integer) else samples
    for n in check_tuple("samples per super-pixel", pair, 2, at_least=1, at_most=256, integer=True):
        check_number("samples per super-pixel", n, integer=True)
    return int(pair[0]), int(pair[1])


def _whole(image: NDArray[Any], side: tuple[int, int]) -> NDArray[Any]:
    """Return the frame extended to complete super-pixels with the pixels of the previous period."""
    missing = [-n % s for n, s in zip(image.shape, side, strict=True)]
    if not any(missing):
        return image
    rows, columns = (
        np.where(np.arange(n + m) < n, np.arange(n + m), np.arange(n + m) - s)
        for n, m, s in zip(image.shape, missing, side, strict=True)
    )
    continued: NDArray[Any] = image[np.ix_(rows, columns)]
    return continued


def _output(out: NDArray[Any] | None, shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
    if out is None:
        return np.empty(shape, np.float64 if dtype == np.float64 else np.float32)
    if out.shape != shape or out.dtype not in (np.float32, np.float64) or not out.flags.c_contiguous:
        raise InputError.expected(
            "output array",
            f"a contiguous float32 or float64 array of shape {shape}",
            f"{out.dtype} of shape {out.shape}",
            "allocate an array of this kind",
        )
    return out


def multiplex(samples: ArrayLike, modulator: Modulator) -> NDArray[np.float64]:
    """Return the noise-free frame ``(rows, columns)`` of a sensor behind ``modulator`` (Ihrke et al., eq. 3).

    Parameters
    ----------
    samples
        Plenoptic samples at every pixel, ``(N, rows, columns)``. A pixel behind a lenslet measures the mean of each
        sample over the area of the lenslet.
    modulator
        Modulator, whose first super-pixel begins at the first pixel of the frame.

    Raises
    ------
    InputError
        If ``samples`` is not three-dimensional, or N is not the modulator's number of samples.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.multiplex import cfa, multiplex
    >>> light = np.multiply.outer([0.2, 0.5, 0.3], np.ones((2, 4)))  # red, green, blue
    >>> print(multiplex(light, cfa("Bayer")))
    [[0.2 0.5 0.2 0.5]
     [0.5 0.3 0.5 0.3]]
    """
    light = np.asarray(samples, float)
    if light.ndim != 3 or len(light) != modulator.count:
        raise InputError.expected(
            f"samples for {modulator.name}",
            f"shape ({modulator.count}, rows, columns)",
            light.shape,
            "give one plane per sample",
        )
    rows, columns = light.shape[1:]
    if modulator.lenslets:
        light = _gathered(light, modulator.cell)
    (py, px), frame = modulator.side, np.zeros((rows, columns))
    for k, weights in enumerate(modulator.matrix):
        # loop over the pixels of a super-pixel, for all super-pixels together
        part = (slice(k // px, None, py), slice(k % px, None, px))
        frame[part] = np.tensordot(weights, light[:, part[0], part[1]], 1)
    return frame


def _gathered(light: NDArray[np.float64], cell: tuple[int, int]) -> NDArray[np.float64]:
    """Return an image in which every pixel has the mean over its cell."""
    starts = [np.arange(0, n, c) for n, c in zip(light.shape[1:], cell, strict=True)]
    total = np.add.reduceat(np.add.reduceat(light, starts[0], 1), starts[1], 2)
    # the last cell may be incomplete: its mean is over the pixels there are
    sizes = [np.diff([*s, n]) for s, n in zip(starts, light.shape[1:], strict=True)]
    mean = total / (sizes[0][:, None] * sizes[1])
    return np.repeat(np.repeat(mean, sizes[0], 1), sizes[1], 2)


def arrange(samples: NDArray[Any], modulator: Modulator) -> NDArray[Any]:
    """Reshape the result of `demultiplex` to ``(views down, views across, colours, rows, columns)``.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.multiplex import arrange, cfa, demultiplex, mask
    >>> modulator = mask("lenslet", 3) * cfa("Bayer")
    >>> samples = demultiplex(np.ones((60, 90)), modulator)
    >>> print(samples.shape, arrange(samples, modulator).shape)
    (27, 20, 30) (3, 3, 3, 20, 30)
    """
    return samples.reshape(*modulator.views, max(1, len(modulator.colours)), *samples.shape[1:])
