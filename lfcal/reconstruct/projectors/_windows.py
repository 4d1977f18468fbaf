"""Copy and add windows of lattice cells on an image, by kernels or, for little work, by numpy.

The arguments are those of the kernels.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from numpy.typing import NDArray

from lfcal.reconstruct.projectors import _kernels as kernels
from lfcal.reconstruct.projectors._kernels import Tiling

__all__ = ["add_windows", "copy_windows", "place_patterns"]

Array = NDArray[Any]

WINDOW_S = 3e-6
"""Additional processor time (s) per window of moving windows by numpy, instead of by kernels."""


def add_windows(windows: Array, image: Array, tiling: Tiling, first: int) -> None:
    """Add windows ``(cells, rows, columns)`` of lattice cells from ``first`` on to ``image`` where they overlap."""
    if not kernels.overlap_add.spared(WINDOW_S * len(windows)):
        kernels.overlap_add(windows, image, tiling, first)
        return
    for window, place in zip(windows, _places(windows, tiling, first), strict=True):
        image[place] += window


def copy_windows(windows: Array, image: Array, tiling: Tiling, first: int) -> None:
    """Copy windows of ``image`` into ``windows`` ``(cells, rows, columns)``: the transpose of `add_windows`."""
    if not kernels.gather_windows.spared(WINDOW_S * len(windows)):
        kernels.gather_windows(windows, image, tiling, first)
        return
    for window, place in zip(windows, _places(windows, tiling, first), strict=True):
        window[...] = image[place]


def _places(windows: Array, tiling: Tiling, first: int) -> Iterator[tuple[slice, slice]]:
    """Yield the place of each window on the image."""
    count, rows, columns = windows.shape
    for k in range(first, first + count):
        top = k // tiling.cells_x * tiling.period_y + tiling.row
        left = k % tiling.cells_x * tiling.period_x
        yield slice(top, top + rows), slice(left, left + columns)


def place_patterns(patterns: Array, rows: Array, columns: Array, band: Array) -> None:
    """Place patterns ``(ky, kx, nt, ns)`` into windows ``(ky, kx, any, any)``, starting at their rows and columns.

    ``rows`` (ky,) may be negative, and patterns may extend beyond the last row. In the columns of a pattern, other rows
    are set to 0; other columns are not written.
    """
    ky, kx, nt, ns = patterns.shape
    if not kernels.lay_patterns.spared(WINDOW_S * ky * kx):
        kernels.lay_patterns(patterns, rows, columns, band)
        return
    height = band.shape[2]
    for j, row in enumerate(rows.tolist()):
        top, bottom = (min(max(0, edge), height) for edge in (row, row + nt))
        for i, left in enumerate(columns.tolist()):
            window = band[j, i, :, left : left + ns]
            window[:top], window[bottom:] = 0, 0
            window[top:bottom] = patterns[j, i, top - row : bottom - row]
