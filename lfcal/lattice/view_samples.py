"""The one extractor: what the lenslets of a grid see, at any offsets from their centres."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import for_each_chunk
from lfcal.lattice._view_grid import ViewGrid
from lfcal.lattice._view_kernels import Sites, ViewReading, sample_rows

__all__ = ["TAPS", "sample_views"]

TAPS = {"nearest": 1, "linear": 2, "cubic": 4}
"""Pixels along each side that a filter takes."""


def sample_views(
    frame: NDArray[Any],
    grid: ViewGrid,
    out: NDArray[Any],
    *,
    step_px: tuple[float, float] = (1.0, 1.0),
    filter: str = "linear",
    workers: int | None = None,
) -> NDArray[Any]:
    """Fill ``out`` ``(nv, nu, rows, columns)`` with the views of a frame, and return it.

    View (v, u) is the frame at each lenslet's centre + ``step_px`` (v - (nv - 1)/2, u - (nu - 1)/2), down and right
    along the pixels, between pixels by ``filter`` (`TAPS`); each sample is its lenslets' by their shares, 0 where none
    sees it. float32 or float64.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.camera import preset
    >>> from lfcal.lattice import lattice_of, sample_views, view_grid
    >>> lattice = lattice_of(preset("bench"))
    >>> grid = view_grid(lattice, lattice.shape, margin=5.0)
    >>> ramp = np.tile(np.arange(lattice.shape[1], dtype=np.float32), (lattice.shape[0], 1))
    >>> views = sample_views(ramp, grid, np.empty((1, 5, *grid.shape), np.float32), workers=1)
    >>> (views - views[:, 2:3]).mean((0, 2, 3)).round(2).tolist()
    [-2.0, -1.0, 0.0, 1.0, 2.0]
    """
    half = ((out.shape[0] - 1) / 2 * step_px[0], (out.shape[1] - 1) / 2 * step_px[1])
    sites = Sites(grid.centres_px - np.array(half), grid.near, np.ascontiguousarray(grid.share, out.dtype))
    reading = ViewReading(float(step_px[0]), float(step_px[1]), TAPS[filter])
    for_each_chunk(lambda a, b: sample_rows(frame, sites, reading, out, a, b), grid.shape[0], workers)
    return out
