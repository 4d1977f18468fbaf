"""Spatial reconstruction (theorem 1): measurement channels are interpolated, then decorrelated at each position."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import for_each_chunk, one_blas_thread
from lfcal.multiplex._kernels import Channels, Guided, Taps, bilateral_rows, linear_rows
from lfcal.multiplex.filters import EDGE_PRESERVING, dirichlet_table, tap_table
from lfcal.multiplex.modulator import Modulator

__all__ = ["guide_image", "reconstruct_spatial"]

Image = NDArray[Any]

EDGE_SHARE = 0.1
"""Differences of the guide above this fraction of its range count as edges."""


def reconstruct_spatial(
    frame: Image,
    modulator: Modulator,
    inverse: NDArray[np.float64],
    samples: tuple[int, int],
    filter: str,
    out: Image,
    *,
    workers: int | None = None,
) -> Image:
    """Write the plenoptic samples of a frame to ``out`` ``(N, rows, columns)`` and return it.

    Parameters
    ----------
    frame
        Frame ``(rows, columns)``, a whole number of super-pixels.
    modulator, inverse
        Modulator, and its decorrelation ``(N, K)``.
    samples
        Output samples per super-pixel ``(rows, columns)``.
    filter
        One of `lfcal.multiplex.filters.SPATIAL_FILTERS`.
    out
        Output array; its float type is also used for the calculation.
    workers
        Number of threads. None: one for each available CPU core.
    """
    if filter == "sinc":
        return _by_sinc(frame, modulator, inverse, samples, out)
    name = "linear" if filter == EDGE_PRESERVING else filter
    first, weight = zip(*_tables(name, modulator, samples), strict=True)
    wy, wx = (np.ascontiguousarray(w, out.dtype) for w in weight)
    table = np.ascontiguousarray(inverse, out.dtype)
    used = (table.reshape(len(table), *modulator.side) != 0).any(1)
    taps, channels = Taps(first[0], wy, first[1], wx), Channels(*modulator.side, table, used)
    if filter == EDGE_PRESERVING:
        # range weights compare grey values, which requires one image with the same scale for all channels
        guide = guide_image(frame, modulator.side, out.dtype)
        low, high = np.percentile(guide, (2, 98))
        guided = Guided(frame, guide, 0.5 / max(EDGE_SHARE * float(high - low), 1e-30) ** 2)
        for_each_chunk(lambda a, b: bilateral_rows(guided, taps, channels, out, a, b), out.shape[1], workers)
        return out
    # samples of a mask often need few channels; the others are not read
    for_each_chunk(lambda a, b: linear_rows(frame, taps, channels, out, a, b), out.shape[1], workers)
    return out


def _tables(name: str, modulator: Modulator, samples: tuple[int, int]) -> list[tuple[NDArray[np.intp], NDArray[Any]]]:
    axes = zip(modulator.side, modulator.positions, samples, strict=True)
    return [tap_table(name, side, positions, m) for side, positions, m in axes]


def _by_sinc(
    frame: Image, modulator: Modulator, inverse: NDArray[np.float64], samples: tuple[int, int], out: Image
) -> Image:
    """Interpolate with the periodic sinc, by a product with a full matrix along each axis: exact but slow."""
    (py, px), (rows, columns) = modulator.side, frame.shape
    down, across = (
        dirichlet_table(length // side, side, positions, m)
        for length, side, positions, m in zip((rows, columns), (py, px), modulator.positions, samples, strict=True)
    )
    out[:] = 0
    # many small products, for which additional threads only wait
    with one_blas_thread():
        for k in range(py * px):
            a, b = divmod(k, px)
            users = np.flatnonzero(inverse[:, k])
            if len(users):
                channel = down[a] @ frame[a::py, b::px].astype(float) @ across[b].T
                for j in users:
                    out[j] += (inverse[j, k] * channel).astype(out.dtype)
    return out


def guide_image(frame: Image, side: tuple[int, int], dtype: np.dtype[Any]) -> Image:
    """Return the mean over a super-pixel about each pixel, in which every channel has the same weight."""
    from lfcal.base import cv2

    kernels = []
    for n in side:
        # half weights at both ends centre a super-pixel of even size
        weights = np.ones(n) if n % 2 else np.concatenate([[0.5], np.ones(n - 1), [0.5]])
        kernels.append(weights / n)
    image = np.asarray(frame, np.float64 if dtype == np.float64 else np.float32)
    smooth = cv2.sepFilter2D(image, -1, kernels[1], kernels[0], borderType=cv2.BORDER_REFLECT_101)
    return np.ascontiguousarray(smooth, dtype)
