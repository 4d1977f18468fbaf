"""Compiled passes over the patterns of a plane; all release the GIL and take float32."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.compiled import njit

__all__ = ["FRAME_COLUMNS", "FrameTable", "Lit", "frame_pass", "spot_pass", "step_pass"]

FRAME_COLUMNS = ("energy", "squares", "top", "clipped", "nonfinite", "lit", "weight", "row", "column", "spread")
"""Columns of the table that `frame_pass` fills, one line per pattern:

energy, sum of squares; highest value and how many pixels share it; pixels that are no number; lit pixels; their
weight, its centroid from the cutout's centre, and the sum of their squared distances from it (pixels).
"""


class Lit(NamedTuple):
    """What makes a pixel lit, and where pixels were lit so far."""

    floor: float  # a pixel above it is lit; its weight is what exceeds it
    tolerance: float  # values this close to the highest share it
    cutout: NDArray[np.int32]  # how often each pixel of the cutout was lit, (nt, ns)
    sensor: NDArray[np.int32]  # the same per sensor pixel, (nt, ns + nx - 1) from the row's first cutout on


class FrameTable(NamedTuple):
    """What `frame_pass` finds, one line per pattern."""

    values: NDArray[np.float64]  # (nx, 10) by `FRAME_COLUMNS`
    digest: NDArray[np.uint64]  # (nx,): checksum of each pattern


_OFFSET, _PRIME = 14695981039346656037, 1099511628211  # of the 64-bit hash by Fowler, Noll and Vo


@njit()
def _light(frame: NDArray[np.float32], bits: NDArray[np.uint32]) -> tuple[float, float, float, int, int]:
    """Return energy, sum of squares, highest value, pixels that are no number, and checksum of a pattern (nt, ns).

    Sums run in float64, row by row, so that their rounding grows with nt + ns, not with nt ns. The checksum is FNV-1a
    over the words of the pattern: equal patterns have equal ones.
    """
    energy, squares, bad = 0.0, 0.0, 0
    top = np.float32(-np.inf)
    h = np.uint64(_OFFSET)
    for t in range(frame.shape[0]):
        total, square = 0.0, 0.0
        for s in range(frame.shape[1]):
            v = frame[t, s]
            h = (h ^ np.uint64(bits[t, s])) * np.uint64(_PRIME)
            if math.isfinite(v):
                total += v
                square += v * v
                top = max(top, v)
            else:
                bad += 1
        energy += total
        squares += square
    return energy, squares, float(top), bad, int(h)


@njit()
def frame_pass(frames: NDArray[np.float32], bits: NDArray[np.uint32], lit: Lit, table: FrameTable) -> None:
    """Measure the patterns of one row of source positions.

    The centroid is sum w (t, s) / sum w with w what exceeds the floor: without the floor the noise of all dark pixels
    would pull it to the middle.

    Parameters
    ----------
    frames
        Patterns ``(nx, nt, ns)``.
    bits
        The same bytes as ``uint32``.
    lit
        In and out: its two maps are counted on.
    table
        Out.
    """
    floor, cutout, sensor = lit.floor, lit.cutout, lit.sensor
    nx, nt, ns = frames.shape
    ct, cs = (nt - 1) // 2, (ns - 1) // 2
    for x in range(nx):
        energy, squares, top, bad, table.digest[x] = _light(frames[x], bits[x])
        weight, row, column, second = 0.0, 0.0, 0.0, 0.0
        count, clipped = 0, 0
        for t in range(nt):
            for s in range(ns):
                v = frames[x, t, s]
                if v > floor and math.isfinite(v):
                    w = v - floor
                    i, j = t - ct, s - cs
                    weight += w
                    row += w * i
                    column += w * j
                    second += i * i + j * j
                    count += 1
                    cutout[t, s] += 1
                    sensor[t, s + x] += 1  # the cutout moves a pixel per position
                    if v >= top - lit.tolerance:  # known only after a first pass over the pattern
                        clipped += 1
        if weight > 0:
            row /= weight
            column /= weight
        line = table.values[x]  # in the order of FRAME_COLUMNS
        line[0], line[1], line[2], line[3], line[4] = energy, squares, top, clipped, bad
        line[5], line[6], line[7], line[8], line[9] = count, weight, row, column, second


@njit()
def spot_pass(
    frames: NDArray[np.float32],
    floor: float,
    across: NDArray[np.complex128],
    down: NDArray[np.complex128],
    out: NDArray[np.complex128],
) -> None:
    """Sum lit pixels against plane waves: ``out[x, q] = sum_ts (H - floor)+ down[t, q] across[s, q]``.

    The wave is a product of two: summed along a row first, it costs one multiply-add per lit pixel and wave.

    Parameters
    ----------
    frames
        Patterns ``(n, nt, ns)``.
    floor
        Only what exceeds it counts: the dark pixels' noise stays out.
    across, down
        Waves over columns ``(ns, waves)`` and rows ``(nt, waves)``.
    out
        ``(n, waves)``.
    """
    n, nt, ns = frames.shape
    waves = across.shape[1]
    line = np.empty(waves, np.complex128)
    for k in range(n):
        out[k] = 0
        for t in range(nt):
            line[:] = 0
            any_lit = False
            for s in range(ns):
                v = frames[k, t, s]
                if v > floor and math.isfinite(v):
                    any_lit = True
                    w = v - floor
                    for q in range(waves):
                        line[q] += w * across[s, q]
            if any_lit:
                for q in range(waves):
                    out[k, q] += line[q] * down[t, q]


@njit(fastmath={"reassoc", "contract"})
def step_pass(
    a: NDArray[np.float32], b: NDArray[np.float32], rows: int, columns: int, out: NDArray[np.float64]
) -> None:
    """Sum the squares of two patterns and their product, where ``b`` is one step on from ``a``, to ``out (3,)``.

    The lenslets stand still on the sensor while the cutout moves by ``(rows, columns)``, so ``b[t, s]`` belongs to
    ``a[t + rows, s + columns]``. A row is summed in float32, in vectors; the rows in float64, so that the sums keep
    the digits that a correlation near 1 needs.
    """
    nt, ns = a.shape
    aa = 0.0
    bb = 0.0
    ab = 0.0
    for t in range(nt - rows):
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
