"""Compiled inner loops of the projectors."""

from __future__ import annotations

from typing import Any

import numpy as np

from lfcal.compiled import njit

Array = Any


@njit()
def overlap_add(windows: Array, image: Array, row: int, first: int, cells_x: int, period_y: int, period_x: int) -> None:
    """Add windows ``(cells, rows, columns)`` of lattice cells from ``first`` on to ``image``.

    The window of cell (Y, X) begins at row ``Y * period_y + row`` and column ``X * period_x``.
    """
    count, rows, columns = windows.shape
    for k in range(count):
        top = (first + k) // cells_x * period_y + row
        left = (first + k) % cells_x * period_x
        for t in range(rows):
            line = image[top + t, left : left + columns]
            window = windows[k, t]
            for s in range(columns):
                line[s] += window[s]


@njit()
def gather_windows(
    windows: Array, image: Array, row: int, first: int, cells_x: int, period_y: int, period_x: int
) -> None:
    """Copy windows of ``image`` into ``windows`` ``(cells, rows, columns)``: the transpose of `overlap_add`."""
    count, rows, columns = windows.shape
    for k in range(count):
        top = (first + k) // cells_x * period_y + row
        left = (first + k) % cells_x * period_x
        for t in range(rows):
            line = image[top + t, left : left + columns]
            window = windows[k, t]
            for s in range(columns):
                window[s] = line[s]


@njit()
def count_entries(plane: Array, keep: Array, by_source: Array, by_pixel: Array) -> None:
    """Count the entries of H by source phase and by image phase; ``keep`` (ny, nx) selects image phases."""
    ny, nx, nt, ns = plane.shape
    ct, cs = (nt - 1) // 2, (ns - 1) // 2
    for y in range(ny):
        for x in range(nx):
            for t in range(nt):
                iy = (y + t - ct) % ny
                for s in range(ns):
                    if plane[y, x, t, s] != 0:
                        ix = (x + s - cs) % nx
                        if keep[iy, ix]:
                            by_source[y * nx + x] += 1
                            by_pixel[iy * nx + ix] += 1


@njit()
def fill_entries(
    plane: Array,
    keep: Array,
    reach: Array,
    stride: int,
    block: int,
    source_at: Array,
    source_offset: Array,
    source_value: Array,
    pixel_at: Array,
    pixel_offset: Array,
    pixel_value: Array,
) -> None:
    """Sort the entries of H by source phase (for the adjoint) and by image phase (for the forward projection).

    An offset leads from a lattice position to the other side's value, in arrays of ``block`` values per phase with
    rows of ``stride`` values. ``source_at`` and ``pixel_at`` hold where each phase's next entry goes. Entries that
    reach beyond ``reach`` cells never meet the image and are given offset 0 and value 0.
    """
    ny, nx, nt, ns = plane.shape
    ct, cs = (nt - 1) // 2, (ns - 1) // 2
    for y in range(ny):
        for x in range(nx):
            source = y * nx + x
            for t in range(nt):
                dy, iy = (y + t - ct) // ny, (y + t - ct) % ny
                for s in range(ns):
                    value = plane[y, x, t, s]
                    if value == 0:
                        continue
                    dx, ix = (x + s - cs) // nx, (x + s - cs) % nx
                    if not keep[iy, ix]:
                        continue
                    pixel = iy * nx + ix
                    shift = dy * stride + dx
                    if abs(dy) > reach[0] or abs(dx) > reach[1]:
                        value *= 0
                        shift = 0
                    a = source_at[source]
                    source_offset[a] = pixel * block + shift
                    source_value[a] = value
                    source_at[source] = a + 1
                    b = pixel_at[pixel]
                    pixel_offset[b] = source * block - shift
                    pixel_value[b] = value
                    pixel_at[pixel] = b + 1


LANES = 64
"""Lattice positions summed at once: sums and sources of all phases stay in the caches."""


@njit(fastmath={"contract", "reassoc"}, error_model="numpy")
def gather_sums(
    start: Array, offset: Array, value: Array, values_in: Array, values_out: Array, base: int, low: int, high: int
) -> None:
    """Add to ``values_out[k, q]`` the sum over entries e of phase k of ``value[e] * values_in[offset[e] + base + q]``.

    ``low <= k < high``; ``values_in`` is flat, ``values_out`` is ``(phases, positions)``. Four entries are taken at a
    time, which saves three of four loads and stores of the sums.
    """
    positions = values_out.shape[1]
    sums = np.zeros(LANES, values_out.dtype)
    for q0 in range(0, positions, LANES):
        lanes = min(LANES, positions - q0)
        first = base + q0
        for k in range(low, high):
            begin, end = start[k], start[k + 1]
            if begin == end:
                continue
            sums[:] = 0
            fours = begin + (end - begin) // 4 * 4 if lanes == LANES else begin
            for e in range(begin, fours, 4):
                a, b, c, d = value[e], value[e + 1], value[e + 2], value[e + 3]
                pa = values_in[offset[e] + first : offset[e] + first + LANES]
                pb = values_in[offset[e + 1] + first : offset[e + 1] + first + LANES]
                pc = values_in[offset[e + 2] + first : offset[e + 2] + first + LANES]
                pd = values_in[offset[e + 3] + first : offset[e + 3] + first + LANES]
                for q in range(LANES):
                    sums[q] += (a * pa[q] + b * pb[q]) + (c * pc[q] + d * pd[q])
            for e in range(fours, end):
                a = value[e]
                pa = values_in[offset[e] + first : offset[e] + first + lanes]
                for q in range(lanes):
                    sums[q] += a * pa[q]
            for q in range(lanes):
                values_out[k, q0 + q] += sums[q]
