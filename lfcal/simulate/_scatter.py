"""Add the responses of all bright voxels to an image."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import chunks, for_each_chunk, njit

__all__ = ["Row", "scatter"]


class Row(NamedTuple):
    """Responses of one source row of the period, and the rows of the volume that use them."""

    responses: NDArray[np.float32]  # (n, nt, ns)
    slot: NDArray[np.intp]  # (nx,): position x of the period uses responses[slot[x]]
    first: int  # row of the volume that the first row of voxels lies at
    step: int  # rows from one to the next


# no fast math: the sum over voxels must be identical for any number of threads
@njit(fastmath=False)
def _add(image: NDArray[np.float64], lit: NDArray[np.float32], row: Row, top: int, bottom: int) -> None:
    """Add f[p] = sum_v g[v] H[v mod n][p - v + c] to rows ``top`` to ``bottom`` of the image, for one source row.

    ``image`` begins c = (nt - 1)/2, (ns - 1)/2 pixels before the volume, so that a response starts at its voxel;
    ``lit`` are voxels g ``(k, columns)``.
    """
    responses, slot, first, step = row.responses, row.slot, row.first, row.step
    nx, (_, nt, ns) = slot.size, responses.shape
    for k in range(lit.shape[0]):
        start = first + k * step
        t0, t1 = max(0, top - start), min(nt, bottom - start)
        if t0 >= t1:
            continue
        for x in range(lit.shape[1]):
            value = np.float64(lit[k, x])
            if value == 0.0:  # most voxels of a volume are dark
                continue
            response = responses[slot[x % nx]]
            for t in range(t0, t1):
                for s in range(ns):
                    image[start + t, x + s] += value * response[t, s]


def scatter(image: NDArray[np.float64], lit: NDArray[np.float32], row: Row, workers: int) -> None:
    """Add the responses of one source row of the period to ``image``.

    Parameters
    ----------
    image
        Image to add to, ``(rows + nt - 1, columns + ns - 1)``.
    lit
        Voxels ``(k, columns)`` at rows ``first + k step``.
    row
        Responses of these voxels.
    workers
        Number of threads. Each writes separate rows of the image, so the sum does not depend on their number.
    """
    parts = chunks(image.shape[0], workers)
    lit = np.ascontiguousarray(lit)

    def some(start: int, stop: int) -> None:
        for a, b in parts[start:stop]:
            _add(image, lit, row, a, b)

    for_each_chunk(some, len(parts), workers, parts_per_worker=1)
