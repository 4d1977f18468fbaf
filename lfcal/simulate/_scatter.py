"""Add responses to an image, one per glowing voxel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.compiled import njit
from lfcal.threads import chunks, for_each_chunk

__all__ = ["scatter"]


@njit(fastmath=False)
def _add(
    image: NDArray[np.float64],
    lit: NDArray[np.float32],
    responses: NDArray[np.float32],
    slot: NDArray[np.intp],
    first: int,
    step: int,
    top: int,
    bottom: int,
) -> None:
    """Add to rows ``top`` to ``bottom`` of the image; voxel (k, x) lies at row ``first + k step``."""
    nx = slot.size
    nt, ns = responses.shape[1], responses.shape[2]
    for k in range(lit.shape[0]):
        row = first + k * step
        t0, t1 = max(0, top - row), min(nt, bottom - row)
        if t0 >= t1:
            continue
        for x in range(lit.shape[1]):
            value = np.float64(lit[k, x])
            if value == 0.0:
                continue
            response = responses[slot[x % nx]]
            for t in range(t0, t1):
                for s in range(ns):
                    image[row + t, x + s] += value * response[t, s]


def scatter(
    image: NDArray[np.float64],
    lit: NDArray[np.float32],
    responses: NDArray[np.float32],
    slot: NDArray[np.intp],
    first: int,
    step: int,
    workers: int,
) -> None:
    """Add the responses of one source row of the period to ``image`` ``(rows + nt - 1, columns + ns - 1)``.

    Parameters
    ----------
    lit
        Voxels ``(k, columns)`` at rows ``first + k step``.
    responses
        ``(n, nt, ns)``; position x of the period uses ``responses[slot[x]]``.
    workers
        Threads; each owns some rows of the image, so the sum does not depend on their number.
    """
    parts = chunks(image.shape[0], workers)
    lit = np.ascontiguousarray(lit)

    def some(start: int, stop: int) -> None:
        for a, b in parts[start:stop]:
            _add(image, lit, responses, slot, first, step, a, b)

    for_each_chunk(some, len(parts), workers, parts_per_worker=1)
