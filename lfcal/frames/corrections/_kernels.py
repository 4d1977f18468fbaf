"""Compiled inner loops of the corrections.

A region of a frame is corrected in one pass; ``origin`` is its first pixel (row, column) on the sensor.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import for_each_chunk, njit

__all__ = ["CorrectionTerms", "correct", "correct_rows", "neighbour_of_rank", "repair_pixels"]


class CorrectionTerms(NamedTuple):
    """Parameters of the correction ``(value - level - dark) * gain * factor - background``."""

    dark: NDArray[np.float32]  # dark frame of the whole sensor (digital numbers), or empty
    gain: NDArray[np.float32]  # gain map of the whole sensor, or empty
    level: np.float32  # black level (digital numbers)
    factor: np.float32  # to the reference exposure
    offset: float  # background at the sensor's pixel (0, 0)
    per_row: float  # its slopes per pixel
    per_column: float


PIXEL_S = 3e-9
"""Processor time per pixel (s) by which numpy is slower than `correct_rows`."""


def correct(raw: NDArray[Any], terms: CorrectionTerms, out: NDArray[np.float32], workers: int | None) -> None:
    """Correct all rows by `correct_rows`, or by numpy if compiling it would take longer; the results are identical."""
    if not correct_rows.spared(PIXEL_S * raw.size):
        for_each_chunk(lambda a, b: correct_rows(raw, terms, (0, 0), a, b, out), len(raw), workers)
        return
    rows, columns = (np.arange(count) for count in raw.shape)
    np.subtract(raw.astype(np.float32), terms.level, out=out)
    if terms.dark.size:
        out -= terms.dark
    if terms.gain.size:
        out *= terms.gain
    out *= terms.factor
    out -= (terms.offset + terms.per_row * rows).astype(np.float32)[:, None]
    out -= np.float32(terms.per_column) * columns.astype(np.float32)


@njit()
def correct_rows(
    raw: NDArray[Any], terms: CorrectionTerms, origin: tuple[int, int], start: int, stop: int, out: NDArray[np.float32]
) -> None:
    """Write ``(raw - level - dark) * gain * factor - background`` for rows ``start`` to ``stop`` of ``raw``.

    ``raw`` and ``out`` have the shape ``(rows, columns)`` of a region. Values stay in float32, where a 16-bit sample
    minus its dark level is exact. Nothing is clipped at zero, because that would bias the mean of dark pixels.
    """
    columns = raw.shape[1]
    r0, c0 = origin
    dark, gain, level, scale = terms.dark, terms.gain, terms.level, terms.factor
    slope = np.float32(terms.per_column)
    for r in range(start, stop):
        offset = np.float32(terms.offset + terms.per_row * (r + r0))
        # one loop for each kind of chain: a branch per pixel would prevent vectorisation
        if dark.size and gain.size:
            for c in range(columns):
                value = (np.float32(raw[r, c]) - level - dark[r0 + r, c0 + c]) * gain[r0 + r, c0 + c]
                out[r, c] = value * scale - offset - slope * np.float32(c0 + c)
        elif dark.size:
            for c in range(columns):
                value = np.float32(raw[r, c]) - level - dark[r0 + r, c0 + c]
                out[r, c] = value * scale - offset - slope * np.float32(c0 + c)
        elif gain.size:
            for c in range(columns):
                value = (np.float32(raw[r, c]) - level) * gain[r0 + r, c0 + c]
                out[r, c] = value * scale - offset - slope * np.float32(c0 + c)
        else:
            for c in range(columns):
                out[r, c] = (np.float32(raw[r, c]) - level) * scale - offset - slope * np.float32(c0 + c)


@njit()
def repair_pixels(
    values: NDArray[np.float32],
    r0: int,
    c0: int,
    plane: NDArray[np.float64],
    pixels: NDArray[np.int32],
    neighbours: NDArray[np.int32],
) -> None:
    """Set ``pixels`` of the region ``values`` to the mean of those ``neighbours`` that are in the region.

    ``pixels`` ``(n, 2)`` and ``neighbours`` ``(n, m, 2)`` are rows and columns on the sensor, -1 for none; ``(r0,
    c0)`` is the region's first pixel. ``plane`` is the already subtracted background: its level and its slopes per row
    and column. It is added to the neighbours and subtracted at the pixel, so that the repair acts before the
    background, as in the chain. A pixel without any neighbour becomes NaN.
    """
    rows, columns = values.shape
    for k in range(pixels.shape[0]):
        r = pixels[k, 0] - r0
        c = pixels[k, 1] - c0
        if r < 0 or c < 0 or r >= rows or c >= columns:
            continue
        total = 0.0
        count = 0
        for j in range(neighbours.shape[1]):
            nr = neighbours[k, j, 0]
            nc = neighbours[k, j, 1]
            if nr < r0 or nc < c0 or nr >= r0 + rows or nc >= c0 + columns:
                continue
            value = values[nr - r0, nc - c0]
            if np.isnan(value):  # a neighbour that is itself defective and not yet repaired
                continue
            total += value + plane[1] * (nr - pixels[k, 0]) + plane[2] * (nc - pixels[k, 1])
            count += 1
        values[r, c] = total / count if count else np.nan


@njit()
def neighbour_of_rank(
    image: NDArray[np.float32],
    offsets: NDArray[np.int32],
    rank: int,
    start: int,
    stop: int,
    out: NDArray[np.float32],
) -> None:
    """Write, for rows ``start`` to ``stop``, the value of rank ``rank`` (0: lowest) among each pixel's neighbours.

    ``offsets`` has the shape ``(phases_y, phases_x, n, 2)``: the neighbours of the same colour for each phase of the
    colour filter. At the border, some neighbours are missing. A rank below the middle then selects the lowest of the
    remaining ones, and a rank above it the highest, which is the strictest comparison.
    """
    rows, columns = image.shape
    py, px, n, _ = offsets.shape
    found = np.empty(n, np.float32)
    for r in range(start, stop):
        for c in range(columns):
            m = 0
            for j in range(n):
                nr = r + offsets[r % py, c % px, j, 0]
                nc = c + offsets[r % py, c % px, j, 1]
                if nr < 0 or nr >= rows or nc < 0 or nc >= columns:
                    continue
                value = image[nr, nc]
                k = m  # insertion sort: fastest for at most eight values
                while k > 0 and found[k - 1] > value:
                    found[k] = found[k - 1]
                    k -= 1
                found[k] = value
                m += 1
            if m == n:
                out[r, c] = found[rank]
            elif m == 0:
                out[r, c] = image[r, c]
            elif rank == n // 2:
                out[r, c] = found[m // 2]
            else:
                out[r, c] = found[0] if rank < n // 2 else found[m - 1]
