"""Compiled inner loops of the projectors.

All compute parts of f[p] = sum_v g[v] H[v mod n][p - v + c] (Eberhart et al. 2020, equation 1) for one depth plane.
Here v are positions of the volume, p pixels of the image, n = (ny, nx) the period and c = ((nt - 1)/2, (ns - 1)/2) the
middle of a pattern. A phase is a position within the period, counted row by row; a lattice cell is one period.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import njit

__all__ = [
    "LANES",
    "Entries",
    "PhaseLayout",
    "Tiling",
    "count_entries",
    "fill_entries",
    "gather_sums",
    "gather_windows",
    "lay_patterns",
    "overlap_add",
]

Array = NDArray[Any]

LANES = 1024
"""Largest number of lattice positions summed in one run; each run reads the entries again.

Nine arrays of this length, the sums and eight inputs, fit into the cache.
"""


class Tiling(NamedTuple):
    """Place of the windows on the image; the one of lattice cell (Y, X) starts at (row + Y period_y, X period_x)."""

    row: int  # first image row of the cells in row 0 of the lattice
    cells_x: int  # cells per row of the lattice
    period_y: int  # pixels
    period_x: int


class PhaseLayout(NamedTuple):
    """Memory layout of values sorted by phase: ``block`` values per phase, in rows of ``stride`` cells."""

    stride: int
    block: int
    reach_y: int  # cells that a pattern extends beyond its own; as many rows of zeros surround a phase's lattice
    reach_x: int


class Entries(NamedTuple):
    """Entries of H sorted by phase: those of phase k are ``start[k]:start[k+1]``."""

    start: Array  # (phases + 1,), int64
    offset: Array  # (entries,), int32: from a lattice position to the value that an entry multiplies
    value: Array  # (entries,)

    @property
    def nbytes(self) -> int:
        """Size of all three arrays (bytes)."""
        return int(self.start.nbytes + self.offset.nbytes + self.value.nbytes)


@njit()
def overlap_add(windows: Array, image: Array, tiling: Tiling, first: int) -> None:
    """Add windows ``(cells, rows, columns)`` of lattice cells from ``first`` on to ``image`` where they overlap."""
    count, rows, columns = windows.shape
    for k in range(count):
        top = (first + k) // tiling.cells_x * tiling.period_y + tiling.row
        left = (first + k) % tiling.cells_x * tiling.period_x
        for t in range(rows):
            # views of one row, so that the inner loop is vectorised
            line = image[top + t, left : left + columns]
            window = windows[k, t]
            for s in range(columns):
                line[s] += window[s]


@njit()
def gather_windows(windows: Array, image: Array, tiling: Tiling, first: int) -> None:
    """Copy windows of ``image`` into ``windows`` ``(cells, rows, columns)``: the transpose of `overlap_add`."""
    count, rows, columns = windows.shape
    for k in range(count):
        top = (first + k) // tiling.cells_x * tiling.period_y + tiling.row
        left = (first + k) % tiling.cells_x * tiling.period_x
        for t in range(rows):
            line = image[top + t, left : left + columns]
            window = windows[k, t]
            for s in range(columns):
                window[s] = line[s]


@njit()
def lay_patterns(patterns: Array, rows: Array, columns: Array, band: Array) -> None:
    """Place patterns ``(ky, kx, nt, ns)`` into windows ``(ky, kx, any, any)``, starting at their rows and columns.

    ``rows`` (ky,) may be negative, and patterns may extend beyond the last row. In the columns of a pattern, other rows
    are set to 0; other columns are not written.
    """
    ky, kx, nt, ns = patterns.shape
    for j in range(ky):
        for i in range(kx):
            left = columns[i]
            for t in range(band.shape[2]):
                own = t - rows[j]
                line = band[j, i, t, left : left + ns]
                if 0 <= own < nt:
                    pattern = patterns[j, i, own]
                    for s in range(ns):
                        line[s] = pattern[s]
                else:
                    line[:] = 0


@njit()
def count_entries(plane: Array, keep: Array, by_source: Array, by_pixel: Array) -> None:
    """Count the non-zero entries of H by source phase and by image phase, each ``(phases,)``.

    ``plane`` is ``(ny, nx, nt, ns)``; ``keep`` (ny, nx) selects image phases.
    """
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
def fill_entries(plane: Array, keep: Array, layout: PhaseLayout, sources: Entries, pixels: Entries) -> None:
    """Sort the entries of H by source phase (for the adjoint) and by image phase (for the forward projection).

    H[y, x][t, s] leads from phase (y, x) to the image phase (y + t - ct, x + s - cs) mod n, dy and dx cells further.
    An offset leads from a lattice position to the value on the other side. The counts in ``start`` are those of
    `count_entries`. Entries that extend beyond the margins never reach the image and have offset 0 and value 0.
    """
    ny, nx, nt, ns = plane.shape
    ct, cs = (nt - 1) // 2, (ns - 1) // 2
    stride, block, reach_y, reach_x = layout.stride, layout.block, layout.reach_y, layout.reach_x
    source_offset, source_value = sources.offset, sources.value
    pixel_offset, pixel_value = pixels.offset, pixels.value
    source_at, pixel_at = sources.start.copy(), pixels.start.copy()  # where each phase's next entry goes
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
                    if abs(dy) > reach_y or abs(dx) > reach_x:
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


@njit(fastmath={"contract", "reassoc"}, error_model="numpy")
def gather_sums(entries: Entries, values_in: Array, values_out: Array, base: int, low: int, high: int) -> None:
    """Add to ``values_out[k, q]`` the sum over entries e of phase k of ``value[e] * values_in[offset[e] + base + q]``.

    The phases are ``low <= k < high``; ``values_in`` is flat, ``values_out`` is ``(phases, positions)`` and ``base``
    is the first position after the margins. Eight entries are processed together, which saves seven of eight loads and
    stores of the sums.
    """
    start, offset, value = entries.start, entries.offset, entries.value
    positions = values_out.shape[1]
    sums = np.zeros(LANES, values_out.dtype)
    blocks = (positions + LANES - 1) // LANES
    for block in range(blocks):
        # equal sizes, because reading an entry takes as long for a short block as for a long one
        q0 = positions * block // blocks
        lanes = positions * (block + 1) // blocks - q0
        first = base + q0
        for k in range(low, high):
            begin, end = start[k], start[k + 1]
            if begin == end:
                continue
            sums[:] = 0
            eights = begin + (end - begin) // 8 * 8
            for n in range(begin, eights, 8):
                a, b, c, d = value[n], value[n + 1], value[n + 2], value[n + 3]
                e, f, g, h = value[n + 4], value[n + 5], value[n + 6], value[n + 7]
                pa = values_in[offset[n] + first : offset[n] + first + lanes]
                pb = values_in[offset[n + 1] + first : offset[n + 1] + first + lanes]
                pc = values_in[offset[n + 2] + first : offset[n + 2] + first + lanes]
                pd = values_in[offset[n + 3] + first : offset[n + 3] + first + lanes]
                pe = values_in[offset[n + 4] + first : offset[n + 4] + first + lanes]
                pf = values_in[offset[n + 5] + first : offset[n + 5] + first + lanes]
                pg = values_in[offset[n + 6] + first : offset[n + 6] + first + lanes]
                ph = values_in[offset[n + 7] + first : offset[n + 7] + first + lanes]
                for q in range(lanes):
                    near = (a * pa[q] + b * pb[q]) + (c * pc[q] + d * pd[q])
                    sums[q] += near + ((e * pe[q] + f * pf[q]) + (g * pg[q] + h * ph[q]))
            for n in range(eights, end):
                a = value[n]
                pa = values_in[offset[n] + first : offset[n] + first + lanes]
                for q in range(lanes):
                    sums[q] += a * pa[q]
            for q in range(lanes):
                values_out[k, q0 + q] += sums[q]
