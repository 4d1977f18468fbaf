"""Demosaicing of any colour filter array: linear estimates under a prior of images, and blended by direction."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, for_each_chunk
from lfcal.multiplex._demosaic_kernels import Mosaic, blend_rows, estimate_rows
from lfcal.multiplex._estimation import (
    ALONG_COLUMNS,
    ALONG_ROWS,
    EVEN,
    estimation_weights,
    reach_of,
    sample_levels,
    thinned,
)
from lfcal.multiplex.filters import COLOUR_FILTERS
from lfcal.multiplex.modulator import Modulator

__all__ = ["can_estimate", "reconstruct_by_estimation"]

Image = NDArray[Any]

ROWS_AT_ONCE = 64
"""Rows of two estimates that are kept until they are blended."""

HALF_WINDOW = 3
"""Changes of colour are compared over 7 x 7 pixels."""


def can_estimate(modulator: Modulator, samples: tuple[int, int]) -> bool:
    """Return whether the modulator is a colour filter array whose colours are wanted at every pixel."""
    return bool(modulator.colours) and modulator.views == (1, 1) and samples == modulator.side


def reconstruct_by_estimation(
    frame: Image, modulator: Modulator, filter: str, out: Image, *, workers: int | None = None
) -> Image:
    """Write the colours of a frame of whole super-pixels to ``out`` ``(N, rows, columns)`` and return it.

    Parameters
    ----------
    frame
        ``(rows, columns)``, whole super-pixels.
    modulator
        Colour filter array.
    filter
        ``"lmmse"``: the linear estimate for even surroundings. ``"directional"``: two estimates, for edges along the
        rows and along the columns, blended by how little colours change along either. As in Menon, Andriani and
        Calvagno 2007 ("Demosaicing with directional filtering and a posteriori decision", IEEE Trans. Image
        Processing 16:132) the change is judged on the estimates themselves.
    out
        Float array; its type is that of the arithmetic.
    workers
        Threads.

    Raises
    ------
    InputError
        If the modulator is no colour filter array, or the output has another pitch than its pixels.
    """
    if not can_estimate(modulator, modulator.side) or out.shape[1:] != frame.shape:
        raise InputError.expected(
            f"filter for {modulator.name}",
            "another than " + " and ".join(COLOUR_FILTERS),
            repr(filter),
            "these are for colour filter arrays and a sample at every pixel",
        )
    priors = (EVEN,) if filter == "lmmse" else (ALONG_ROWS, ALONG_COLUMNS)
    reach = reach_of(modulator, len(priors))
    levels = sample_levels(frame, modulator)
    full = (estimation_weights(modulator, prior, reach, levels) for prior in priors)
    tables = [np.ascontiguousarray(thinned(weights, modulator), out.dtype) for weights in full]
    mosaic = _mosaic(frame, modulator.side, reach)

    def linear(start: int, stop: int) -> None:
        estimate_rows(mosaic, tables[0], out[:, start:stop], start)

    def blended(start: int, stop: int) -> None:
        for top in range(start, stop, ROWS_AT_ONCE):
            _blend(mosaic, tables, out, top, min(top + ROWS_AT_ONCE, stop))

    for_each_chunk(linear if filter == "lmmse" else blended, len(frame), workers)
    return out


def _blend(mosaic: Mosaic, tables: list[Image], out: Image, start: int, stop: int) -> None:
    """Write rows ``start … stop`` from the estimates of these rows and of those about them."""
    low, high = max(start - HALF_WINDOW - 1, 0), min(stop + HALF_WINDOW + 1, out.shape[1])
    estimates = np.empty((2, len(out), high - low, out.shape[2]), out.dtype)
    for estimate, table in zip(estimates, tables, strict=True):
        estimate_rows(mosaic, table, estimate, low)
    blend_rows(estimates[0], estimates[1], HALF_WINDOW, out[:, start:stop], start - low)


def _mosaic(frame: Image, side: tuple[int, int], reach: int) -> Mosaic:
    cells = -(-reach // side[1])
    columns = _continued(frame.shape[1], cells * side[1], side[1])
    rows = _continued(frame.shape[0], reach, side[0])
    return Mosaic(frame, rows, np.ascontiguousarray(columns.reshape(-1, side[1]).T), side[0], cells)


def _continued(length: int, margin: int, period: int) -> NDArray[np.intp]:
    """Return the pixels ``-margin … length + margin``: beyond the ends those mirrored to the same place in a period."""
    place = np.arange(-margin, length + margin)
    mirrored = np.where(place < 0, -place, np.where(place >= length, 2 * (length - 1) - place, place))
    # the nearest pixel that lies where the wanted one does in its super-pixel
    away = (place - mirrored + period // 2) % period - period // 2
    found = mirrored + away
    # a small frame is mirrored beyond its other end
    found = np.where(found < 0, found % period, found)
    last = length - period + (found - length) % period
    return np.asarray(np.where(found >= length, last, found), np.intp)
