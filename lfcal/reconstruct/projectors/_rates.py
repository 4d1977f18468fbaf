"""Measure the speed of this computer in the operations of projectors, once each and in milliseconds."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any

import numpy as np

from lfcal.base import for_each_chunk, one_blas_thread
from lfcal.reconstruct.projectors._kernels import LANES, Entries, Tiling, gather_sums
from lfcal.reconstruct.projectors._windows import add_windows, copy_windows

__all__ = ["copy_rate", "fft_seconds", "gather_rate", "gemm_seconds", "product_seconds", "window_seconds"]

LIMIT = 1 << 24
"""Largest number of values in a calibration array."""


def _best(run: Callable[[], Any], *, budget: float = 0.03) -> float:
    """Return the shortest time of a run (s), repeated for ``budget`` seconds and at least three times."""
    run()  # compiles, and loads the arrays into the caches
    best, spent, runs = float("inf"), 0.0, 0
    while runs < 3 or spent < budget:
        start = time.perf_counter()
        run()
        took = time.perf_counter() - start
        best, spent, runs = min(best, took), spent + took, runs + 1
        if runs >= 3 and spent > 10 * budget:
            break
    return best


def _threaded(run: Callable[[int], Any], workers: int) -> float:
    """Return the time per run (s) when all workers are busy simultaneously, divided by their number."""
    with one_blas_thread():
        # runs are repeated until each worker has 4 ms of work, so that the start of threads does not matter
        repeats = max(1, round(0.004 / _best(lambda: run(0), budget=0.0)))

        def task() -> None:
            for_each_chunk(
                lambda a, b: [run(k) for k in range(a, b) for _ in range(repeats)], workers, workers, parts_per_worker=1
            )

        return _best(task) / (workers * repeats)


@lru_cache(maxsize=256)
def gemm_seconds(m: int, k: int, n: int, dtype: str, workers: int, *, turned: bool = False) -> float:
    """Return the time of one real product ``(m, k) @ (k, n)`` (s) while all workers compute products.

    With ``turned``, the right factor is a transposed view.
    """
    scale = max(1, (m * k + k * n + m * n) // LIMIT)
    n_run = max(1, n // scale)
    left = [np.ones((m, k), dtype) for _ in range(workers)]
    right = [np.ones((n_run, k), dtype).T if turned else np.ones((k, n_run), dtype) for _ in range(workers)]
    out = [np.empty((m, n_run), dtype) for _ in range(workers)]
    return _threaded(lambda w: np.matmul(left[w], right[w], out=out[w]), workers) * n / n_run


@lru_cache(maxsize=64)
def product_seconds(phases: int, pixels: int, dtype: str, workers: int, *, turned: bool = False) -> tuple[float, float]:
    """Return (a, b) of ``a + b * columns``: seconds of one complex product ``(columns, phases) @ (phases, pixels)``.

    With ``turned``, the product is ``(phases, pixels) @ (columns, pixels).T``, as in the adjoint. The time is measured
    over more matrices than fit in the caches, as in a projection.
    """
    count = max(2, min(4096, 2 * LIMIT // 5 // (phases * pixels)))
    stacks = [np.ones((count, phases, pixels), dtype) for _ in range(workers)]
    seconds = []
    few, many = 2, 24
    for columns in (few, many):
        source = np.ones((count, columns, pixels if turned else phases), dtype)
        result = (count, phases, columns) if turned else (count, columns, pixels)
        out = [np.empty(result, dtype) for _ in range(workers)]
        took = _threaded(partial(_multiply, source, stacks, out, turned), workers)
        seconds.append(took / count)
    # noise may make the slope negative, so it is at least an eighth of the time per column
    slope = max((seconds[1] - seconds[0]) / (many - few), seconds[1] / many / 8)
    return max(0.0, seconds[0] - few * slope), slope


def _multiply(source: Any, stacks: list[Any], out: list[Any], turned: bool, worker: int) -> None:
    if turned:
        np.matmul(stacks[worker], source.swapaxes(1, 2), out=out[worker])
    else:
        np.matmul(source, stacks[worker], out=out[worker])


@lru_cache(maxsize=8)
def copy_rate(dtype: str, workers: int) -> float:
    """Return the values per second of a strided copy with conversion to complex numbers, for all workers together."""
    source = np.ones((256, 64, 64), dtype)
    target = [np.empty((64, 256, 64), np.result_type(dtype, np.complex64)) for _ in range(workers)]

    def run(worker: int) -> None:
        target[worker][...] = source.swapaxes(0, 1)

    return source.size / _threaded(run, workers)


@lru_cache(maxsize=16)
def window_seconds(rows: int, columns: int, dtype: str, workers: int) -> tuple[float, float]:
    """Return the times per value (s) for adding and for gathering windows of this size, for all workers together."""
    cells = max(4, (1 << 18) // (rows * columns))
    windows = [np.zeros((cells, rows, columns), dtype) for _ in range(workers)]
    images = [np.zeros((rows, columns + cells * 8), dtype) for _ in range(workers)]
    values = cells * rows * columns
    tiling = Tiling(0, cells, 1, 8)  # windows eight columns apart, so that they overlap as patterns do
    add = _threaded(lambda w: add_windows(windows[w], images[w], tiling, 0), workers)
    gather = _threaded(lambda w: copy_windows(windows[w], images[w], tiling, 0), workers)
    return add / values, gather / values


@lru_cache(maxsize=32)
def fft_seconds(rows: int, columns: int, dtype: str, workers: int) -> float:
    """Return the time of one real 2-D transform of this size (s)."""
    import scipy.fft

    scale = max(1, rows * columns // LIMIT)
    image = np.ones((max(8, rows // scale), columns), dtype)
    return _best(lambda: scipy.fft.rfft2(image, workers=workers)) * rows / len(image)


@lru_cache(maxsize=16)
def gather_rate(phases: int, positions: int, dtype: str, workers: int) -> float:
    """Return the multiply-adds per second of the sparse kernel, for all workers together."""
    width = min(positions, 4 * LANES)
    lanes = min(phases, 4096)
    entries = max(64, (1 << 21) // (lanes * width))
    rng = np.random.default_rng(0)
    start = np.arange(lanes + 1) * entries
    # random offsets, as the entries of a real H jump from phase to phase
    offset = (rng.integers(0, lanes, lanes * entries) * width).astype(np.int32)
    value = np.ones(lanes * entries, dtype)
    values = np.ones(lanes * width, dtype)
    out = [np.zeros((lanes, width), dtype) for _ in range(workers)]
    took = _threaded(lambda w: gather_sums(Entries(start, offset, value), values, out[w], 0, 0, lanes), workers)
    return entries * lanes * width / took
