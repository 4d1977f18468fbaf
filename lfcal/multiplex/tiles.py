"""Super-pixels of any shape: a tile of pixels that is repeated without gaps along two vectors."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, check_tuple
from lfcal.multiplex.modulator import MAX_SAMPLES, Modulator, modulator_from_matrix

__all__ = ["tile_pixels", "tiled_modulator"]

Index = NDArray[np.intp]


def tile_pixels(pixels: Sequence[tuple[int, int]], vectors: Sequence[tuple[int, int]]) -> Index:
    """Return which of ``pixels`` is at each position of the smallest rectangular period of a tiling.

    The result is an array ``(rows, columns)`` of indices into ``pixels``.

    Parameters
    ----------
    pixels
        ``(row, column)`` of each pixel of the tile: an L, a cross, a hexagon, or any other shape.
    vectors
        Two steps ``(rows, columns)`` that repeat the tile.

    Raises
    ------
    InputError
        If the repeated tiles leave gaps or overlap, or their period has too many pixels.
    """
    (a, b), (c, d) = (check_tuple("vector of the tiles (px)", tuple(v), 2, integer=True) for v in vectors)
    area = abs(a * d - b * c)
    tile = [check_tuple("pixel of the tile", tuple(p), 2, integer=True) for p in pixels]
    if area != len(tile) or not area:
        raise InputError.expected(
            "tile", f"{area} pixels, the area between its vectors", len(tile), "change the pixels or the vectors"
        )
    # number of rows (columns) after which the lattice repeats along an axis
    rows, columns = area // math.gcd(b, d), area // math.gcd(a, c)
    if rows * columns > MAX_SAMPLES:
        raise InputError.expected(
            "period of the tiles", f"at most {MAX_SAMPLES:,} px", f"{rows * columns:,} px", "choose shorter vectors"
        )
    found = np.full((rows, columns), -1, np.intp)
    reach = range(-max(rows, columns) - 1, max(rows, columns) + 2)
    steps = {((i * a + j * c) % rows, (i * b + j * d) % columns) for i in reach for j in reach}
    for k, (y, x) in enumerate(tile):
        for dy, dx in steps:
            if found[(y + dy) % rows, (x + dx) % columns] >= 0:
                raise InputError.expected(
                    "tile",
                    "pixels that do not overlap when the tile is repeated",
                    f"an overlap at {(y, x)}",
                    "change the shape of the tile",
                )
            found[(y + dy) % rows, (x + dx) % columns] = k
    return found


def tiled_modulator(
    name: str,
    pixels: Sequence[tuple[int, int]],
    vectors: Sequence[tuple[int, int]],
    matrix: ArrayLike,
    *,
    colours: tuple[str, ...] = (),
    light: ArrayLike | None = None,
) -> Modulator:
    """Return a modulator whose super-pixel is a tile of any shape.

    The argument ``pixels`` contains the (row, column) of each pixel of the tile. The tile is repeated by the two steps
    ``vectors`` (rows, columns). The array ``matrix`` ``(pixels, N)`` contains the transmission of the N samples at each
    pixel of the tile. Gains are per pixel and therefore do not change if a rectangular period contains the tile several
    times. `demultiplex` uses each pixel of the period as a channel; if that reduces the resolution, use
    `demultiplex_generally`. ``name``, ``colours`` and ``light`` are attributes of `Modulator`.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.multiplex import tiled_modulator
    >>> corner = [(0, 0), (0, 1), (1, 0)]  # an L of a red, a green and a blue pixel
    >>> found = tiled_modulator("L", corner, [(1, 1), (2, -1)], np.eye(3), colours=("R", "G", "B"))
    >>> print(found.pattern().argmax(axis=2))
    [[0 1 2]
     [2 0 1]
     [1 2 0]]
    """
    array = np.asarray(matrix, float)
    if array.ndim != 2 or len(array) != len(pixels):
        raise InputError.expected(
            f"transmissions of {name}", f"shape ({len(pixels)}, N)", array.shape, "give one row per pixel"
        )
    which = tile_pixels(pixels, vectors)
    side = (which.shape[0], which.shape[1])
    return modulator_from_matrix(name, side, array[which.ravel()], colours=colours, light=light)
