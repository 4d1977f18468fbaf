"""Methods of transposing H that are compared, and functions that measure them."""

from __future__ import annotations

import contextlib
import io
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base.compiled import njit
from lfcal.base.errors import LfcalError
from lfcal.base.threads import for_each_chunk

__all__ = [
    "Scaled",
    "check_transposed",
    "copy_parallel",
    "interleaved",
    "paper_loop",
    "pyolaf_backward",
    "random_matrix",
    "read_once",
]


@dataclass(frozen=True, slots=True)
class Scaled:
    """A time, and the fraction of the work that was run to measure it."""

    seconds: float
    share: float = 1.0


def random_matrix(shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return H of this shape filled with random numbers, as in the paper."""
    H = np.empty(shape, np.float32)  # filled by threads, each with a separate generator
    flat = H.reshape(-1)
    for_each_chunk(lambda a, b: np.random.default_rng(a).random(out=flat[a:b], dtype=np.float32), flat.size)
    return H


def interleaved(
    works: Mapping[str, Callable[[], Any]], rounds: int, clock: Callable[[], float] = time.perf_counter
) -> dict[str, float]:
    """Return the shortest time of each work (s) by ``clock``; they run in turns, after one round to warm up."""
    for work in works.values():
        work()  # compiles, and touches the memory once
    times: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(rounds):
        for name, work in works.items():
            start = clock()
            work()
            times[name].append(clock() - start)
    return {name: min(values) for name, values in times.items()}


def copy_parallel(source: NDArray[Any], out: NDArray[Any], workers: int | None) -> None:
    """Copy with numpy, one part per thread."""
    a, b = source.reshape(-1), out.reshape(-1)
    for_each_chunk(lambda i, j: np.copyto(b[i:j], a[i:j]), a.size, workers, parts_per_worker=1)


@njit()
def _read_words(words: NDArray[np.uint64], start: int, stop: int) -> int:
    """Return the exclusive or of words ``start`` to ``stop``, which reads every word at almost no cost."""
    total = np.uint64(0)
    for k in range(start, stop):
        total ^= words[k]
    return int(total)


def read_once(source: NDArray[Any], workers: int | None) -> None:
    """Read every byte once."""
    flat = source.reshape(-1).view(np.uint8)
    words = flat[: flat.size // 8 * 8].view(np.uint64)
    for_each_chunk(lambda i, j: _read_words(words, i, j), words.size, workers)


def check_transposed(H: NDArray[Any], HT: NDArray[Any]) -> None:
    """Raise `LfcalError` unless ``HT`` is the transpose of ``H`` at two thousand random entries."""
    ny, nx, nt, ns = H.shape[1:]
    rng = np.random.default_rng(1)
    z, y, x, t, s = (rng.integers(0, n, 2000) for n in H.shape)
    there = (z, (y + t - nt // 2) % ny, (x + s - ns // 2) % nx, nt - 1 - t, ns - 1 - s)
    if not np.array_equal(HT[z, y, x, t, s], H[there]):
        raise LfcalError.expected("transposed matrix", "the closed form", "other values", "report this machine")


def paper_loop(H: NDArray[Any], out: NDArray[Any], budget: float) -> Scaled:
    """Return the time of the loop in figure 9 of the paper, written in numpy, with all depths at once.

    The loop stops after ``budget`` seconds, and its time is scaled by the number of assignments.
    """
    ny, nx, nt, ns = H.shape[1:]
    along_s, along_t = _paper_indices(ns, nx), _paper_indices(nt, ny)
    total = sum(map(len, along_s)) * sum(map(len, along_t))
    done, start = 0, time.perf_counter()
    for i, columns in enumerate(along_s):
        for j, rows in enumerate(along_t):
            for m_, M in columns:
                for n_, N in rows:
                    out[:, n_, m_, nt - 1 - j, ns - 1 - i] = H[:, N, M, j, i]
            done += len(columns) * len(rows)
            # the whole loop would take minutes; the cost of an assignment hardly varies
            if time.perf_counter() - start > budget:
                return Scaled((time.perf_counter() - start) * total / max(1, done), done / total)
    return Scaled(time.perf_counter() - start)


def _paper_indices(pixels: int, positions: int) -> list[list[tuple[int, int]]]:
    """Return (m', M) for each i by equations 4 to 6, counted from 0, within the period."""
    shift = (pixels - positions) // 2
    result = []
    for i in range(pixels):
        pairs = [
            (i + m - shift + 1 - positions + (positions - 1) // 2 - shift, (m - shift) % positions)
            for m in range(pixels)
        ]
        result.append([(m_, M) for m_, M in pairs if 0 <= m_ < positions])
    return result


def pyolaf_backward(H: NDArray[Any], pixels: int, planes: int) -> tuple[NDArray[np.float64], Scaled]:
    """Return HT[0, :pixels, :pixels] of a square H by pyolaf's `LFM_computeBackwardPatterns`, and its time.

    The time is that of the first depth plane, scaled to ``planes`` and to all positions.
    """
    from pyolaf import lf
    from scipy.sparse import csr_matrix

    n, _, _, ns = H.shape[1:]
    patterns = np.empty((n, n, 1), object)
    for y, x in np.ndindex(n, n):
        patterns[y, x, 0] = csr_matrix(H[0, y, x].astype(np.float64))
    reach = -(-ns // n)
    lenses = np.arange(-reach, reach + 1)
    grid = np.stack(np.meshgrid(lenses * n, lenses * n, indexing="ij"), -1).astype(np.float64)
    half, all_, some = (np.array([k, k]) for k in (n // 2 + 1, n, pixels))
    resolution = {
        "texScaleFactor": np.ones(2),
        "TexNnum": all_,
        "TexNnum_half": half,
        "Nnum": some,
        "Nnum_half": half,
        "texMask": np.ones((n, n)),
        "usedLensletCenters": {"px": grid, "vox": grid},
    }
    start = time.perf_counter()
    with contextlib.redirect_stderr(io.StringIO()):  # the progress bar of pyolaf
        back = lf.LFM_computeBackwardPatterns(patterns, resolution, "full", [])
    seconds = time.perf_counter() - start
    share = pixels**2 / (n**2 * planes)
    values = np.array([[back[y, x, 0].toarray() for x in range(pixels)] for y in range(pixels)])
    return values, Scaled(seconds / share, share)
