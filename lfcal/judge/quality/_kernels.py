"""Compiled passes over the patterns of a plane; all release the GIL and take float32."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import njit

__all__ = ["FRAME_COLUMNS", "PatternSums", "frame_pass", "spot_pass", "step_pass"]

FRAME_COLUMNS = ("energy", "squares", "top", "clipped", "nonfinite", "lit", "weight", "row", "column", "spread")
"""Columns of the table that `frame_pass` fills, one row for each pattern:

- energy, and sum of squares
- highest value, and number of pixels with it
- number of pixels that are NaN, and number of lit pixels
- weight of the lit pixels, and its centroid (row, column) relative to the centre of the cutout (pixels)
- sum of the squared distances of the lit pixels from this centre (square pixels)
"""


class PatternSums(NamedTuple):
    """Output of `frame_pass`.

    Attributes
    ----------
    table
        One row for each pattern ``(nx, 10)`` with the columns `FRAME_COLUMNS`.
    digest
        A checksum of each pattern ``(nx,)``.
    lit
        Number of times each pixel of the cutout is lit ``(nt, ns)``; accumulated.
    sensor
        Number of times each sensor pixel is lit, ``(nt, ns + nx - 1)`` from the first cutout of the row; accumulated.
    """

    table: NDArray[np.float64]
    digest: NDArray[np.uint64]
    lit: NDArray[np.int32]
    sensor: NDArray[np.int32]


@njit(_nrt=False)
def frame_pass(
    frames: NDArray[np.float32], bits: NDArray[np.uint32], floor: float, tolerance: float, out: PatternSums
) -> None:
    """Measure the patterns of one row of source positions.

    Parameters
    ----------
    frames
        Patterns ``(nx, nt, ns)``.
    bits
        Bytes of ``frames`` as ``uint32``.
    floor
        Threshold of lit pixels; the weight of a pixel is its excess.
    tolerance
        Difference below which values count as equal to the highest.
    out
        Arrays that receive the results.
    """
    ns = frames.shape[2]
    for x in range(frames.shape[0]):
        line = out.table[x]
        out.digest[x] = _totals(frames[x], bits[x], line)
        # the cutout of the next position starts one sensor pixel further to the right
        _lit_pixels(frames[x], floor, line[2] - tolerance, out.lit, out.sensor[:, x : x + ns], line)


@njit(inline="always")
def _totals(frame: NDArray[np.float32], bits: NDArray[np.uint32], line: NDArray[np.float64]) -> np.uint64:
    """Write energy, sum of squares, highest value and number of NaN pixels; return the checksum (FNV-1a)."""
    energy = 0.0
    squares = 0.0
    top = np.float32(-np.inf)
    bad = 0
    # FNV-1a, 64 bits: offset basis, then a prime for each word
    h = np.uint64(14695981039346656037)
    for t in range(frame.shape[0]):
        total = 0.0  # row by row, because sums of many small values lose less precision
        square = 0.0
        for s in range(frame.shape[1]):
            v = frame[t, s]
            h = (h ^ np.uint64(bits[t, s])) * np.uint64(1099511628211)
            if math.isfinite(v):
                total += v
                square += v * v
                top = max(top, v)
            else:
                bad += 1
        energy += total
        squares += square
    line[0] = energy
    line[1] = squares
    line[2] = top
    line[4] = bad
    return h


@njit(inline="always")
def _lit_pixels(
    frame: NDArray[np.float32],
    floor: float,
    near: float,
    lit: NDArray[np.int32],
    sensor: NDArray[np.int32],
    line: NDArray[np.float64],
) -> None:
    """Count lit pixels, and those ``near`` the top; write their number, weight, centroid and spread."""
    nt, ns = frame.shape
    ct, cs = (nt - 1) // 2, (ns - 1) // 2
    weight = 0.0
    row = 0.0
    column = 0.0
    second = 0.0
    count = 0
    clipped = 0
    for t in range(nt):
        for s in range(ns):
            v = frame[t, s]
            if v > floor and math.isfinite(v):
                w = v - floor
                i, j = t - ct, s - cs
                weight += w
                row += w * i
                column += w * j
                second += i * i + j * j
                count += 1
                lit[t, s] += 1
                sensor[t, s] += 1
                if v >= near:
                    clipped += 1
    if weight > 0:
        row /= weight
        column /= weight
    line[3] = clipped
    line[5] = count
    line[6] = weight
    line[7] = row
    line[8] = column
    line[9] = second


@njit(_nrt=False)
def spot_pass(
    frames: NDArray[np.float32],
    floor: float,
    across: NDArray[np.complex128],
    down: NDArray[np.complex128],
    out: NDArray[np.complex128],
    line: NDArray[np.complex128],
) -> None:
    """Compute Fourier sums of patterns above a threshold: ``out[x, q] = sum_ts (H - floor)+ down[t, q] across[s, q]``.

    Parameters
    ----------
    frames
        Patterns ``(n, nt, ns)``.
    floor
        Threshold: only the excess counts, so that the noise of dark pixels is ignored.
    across, down
        Waves over columns ``(ns, waves)`` and rows ``(nt, waves)``.
    out
        ``(n, waves)``.
    line
        Scratch memory ``(waves,)``.
    """
    n, nt, ns = frames.shape
    waves = across.shape[1]
    for k in range(n):
        for q in range(waves):
            out[k, q] = 0
        for t in range(nt):
            for q in range(waves):
                line[q] = 0
            any_lit = False
            for s in range(ns):
                v = frames[k, t, s]
                if v > floor and math.isfinite(v):
                    any_lit = True
                    w = v - floor
                    for q in range(waves):
                        line[q] += w * across[s, q]
            # separable waves: most rows of a pattern have no light and need no second product
            if any_lit:
                for q in range(waves):
                    out[k, q] += line[q] * down[t, q]


@njit(fastmath={"reassoc", "contract"})
def step_pass(
    a: NDArray[np.float32], b: NDArray[np.float32], rows: int, columns: int, out: NDArray[np.float64]
) -> None:
    """Write the sums of the squares of two patterns and of their product to ``out (3,)``; ``b`` is a step after ``a``.

    The lenslets do not move on the sensor while the cutout moves by ``(rows, columns)``. Therefore ``b[t, s]``
    corresponds to ``a[t + rows, s + columns]``.
    """
    nt, ns = a.shape
    aa = 0.0
    bb = 0.0
    ab = 0.0
    for t in range(nt - rows):
        # float32 within a row keeps the loop vectorised; rows are added in float64, so that rounding does not build up
        laa = np.float32(0.0)
        lbb = np.float32(0.0)
        lab = np.float32(0.0)
        for s in range(ns - columns):
            u = a[t + rows, s + columns]
            v = b[t, s]
            laa += u * u
            lbb += v * v
            lab += u * v
        aa += float(laa)
        bb += float(lbb)
        ab += float(lab)
    out[0] = aa
    out[1] = bb
    out[2] = ab
