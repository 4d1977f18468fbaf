"""Direct projection for large periods: matrix products over the period's columns, and addition of windows.

For a few rows of source phases, the patterns at their positions form a banded matrix. One product with it yields the
windows of all lattice cells, which are added to the image where they overlap.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import chunks, in_order, one_blas_thread, worker_count
from lfcal.reconstruct.projectors._kernels import Tiling
from lfcal.reconstruct.projectors._planes import centre_of, runs_of_rows, trim
from lfcal.reconstruct.projectors._reduction import Nodes, source_places
from lfcal.reconstruct.projectors._windows import add_windows, copy_windows, place_patterns
from lfcal.reconstruct.projectors.grid import Grid

__all__ = [
    "PARTS",
    "WINDOW_BYTES",
    "Direct",
    "cells_at_once",
    "rows_at_once",
    "rows_together",
    "strips_of",
    "strips_together",
]

WINDOW_BYTES = 1 << 21
"""Size of the window buffer of a product (bytes), about that of the second-level cache."""

CELLS, SOURCES = 256, 200
"""Smallest number of lattice cells and of sources in a product, if there are that many (measured)."""

LEAST_RAMP = 4
"""Number of window rows below which a separate product costs more than it saves."""

PARTS = 16
"""Number of parts of a projection; it does not depend on the workers, so that sums are identical."""


Task = tuple[list[tuple[int, int]], slice]
"""Runs of lattice rows, and the groups of rows of sources that are summed in each."""


class _Scratch:
    """Work arrays that a worker reuses; they are zero when they are created."""

    def __init__(self, dtype: np.dtype[Any]) -> None:
        self.dtype = dtype
        self.kept: dict[str, NDArray[Any]] = {}

    def array(self, name: str, shape: tuple[int, ...]) -> NDArray[Any]:
        """Return the buffer ``name`` with ``shape``; request larger shapes before smaller ones."""
        size = math.prod(shape)
        if name not in self.kept or self.kept[name].size < size:
            self.kept[name] = np.zeros(size, self.dtype)
        return self.kept[name][:size].reshape(shape)


def rows_at_once(nt: int, width: int, itemsize: int) -> int:
    """Return the number of window rows per product for which the windows of `CELLS` cells fill `WINDOW_BYTES`."""
    return max(1, min(nt, WINDOW_BYTES // (CELLS * width * itemsize)))


def cells_at_once(rows: int, width: int, itemsize: int) -> int:
    """Return the number of lattice cells per product."""
    # a product of fewer rows is limited by reading its right factor
    return max(16, WINDOW_BYTES // (rows * width * itemsize))


def strips_of(cells: tuple[int, int]) -> list[tuple[int, int]]:
    """Return the runs of lattice rows that are processed together, if there are enough cells."""
    return chunks(cells[0], min(PARTS, cells[0] * cells[1] // CELLS))


def strips_together(grid: Grid, workers: int) -> int:
    """Return the number of strips that share one banded matrix, limited to twice the image and one worker's part."""
    strips, (ny, _), overlap = strips_of(grid.cells), grid.period, grid.cutout[0] - 1
    lines = math.ceil(grid.cells[0] / len(strips))
    room = 2 * (grid.cells[0] * ny + overlap) // (lines * ny + overlap)
    return max(1, min(room, math.ceil(len(strips) / workers)))


def rows_together(rows: int, columns: int, strips: int) -> int:
    """Return how many rows of sources, ``columns`` each, share a window; all its additions but one are saved.

    With few strips of the lattice to process together, the number is chosen to give several groups of rows.
    """
    return max(1, min(math.ceil(SOURCES / columns), math.ceil(4 * rows * strips / PARTS)))


class Direct:
    """Project with dense matrix products; H needs no preparation and may be read plane by plane.

    ``phases`` (ny, nx) selects image phases: pattern rows without a selected phase are skipped. With ``nodes``,
    only positions at nodes have patterns, ``(my, mx, nt, ns)``: see `image_of` and `cells_of`.
    """

    name = "direct"
    any_phases = True

    def __init__(
        self,
        grid: Grid,
        dtype: np.dtype[Any],
        workers: int | None = None,
        phases: NDArray[np.bool_] | None = None,
        nodes: Nodes | None = None,
    ) -> None:
        self.grid = grid
        self.nodes = nodes
        self.sources = source_places(grid.period, nodes)
        self.dtype = dtype
        self.workers = worker_count(workers)
        self.rounding = float(np.finfo(dtype).tiny)
        self.phases = phases
        self.mask = None if phases is None else grid.tiled(phases)

    def prepare(self, plane: NDArray[Any]) -> NDArray[Any]:
        """Return the plane with its cutout cropped to the non-zero part."""
        return trim(plane)

    def operand_bytes(self, operand: NDArray[Any]) -> int:
        """Return the size of the plane (bytes)."""
        base = operand if operand.base is None else operand.base
        return int(base.nbytes)

    def forward(self, planes: Iterable[tuple[NDArray[Any], NDArray[Any]]]) -> NDArray[Any]:
        """Return the image of a volume, given as pairs (operand, volume plane)."""
        total = np.zeros(self.grid.image_shape, self.dtype)
        for operand, plane in planes:
            total += self.image_of(operand, self._by_row_phase(self.grid.pack(plane, self.dtype)))
        return total if self.mask is None else total * self.mask

    def image_of(self, operand: NDArray[Any], cells: NDArray[Any]) -> NDArray[Any]:
        """Return the image of sources ``cells`` ``(rows, lattice cells, columns)``; with nodes, only of nodes."""
        groups = self._groups(operand)
        (ny, nx), (cells_y, cells_x), (nt, ns) = self.grid.period, self.grid.cells, operand.shape[2:]

        def work(task: Task) -> list[NDArray[Any]]:
            strips, own = task
            images = [np.zeros(((b - a) * ny + nt - 1, cells_x * nx + ns - 1), self.dtype) for a, b in strips]
            sources = [cells[:, a * cells_x : b * cells_x] for a, b in strips]
            scratch = _Scratch(self.dtype)
            for group in groups[own]:
                self._spread([one[group] for one in sources], operand, group, images, scratch)
            return images

        total = np.zeros((cells_y * ny + nt - 1, cells_x * nx + ns - 1), self.dtype)
        tasks = self._tasks(len(groups))
        # threads work on strips; additional threads of BLAS would only queue
        with one_blas_thread():
            for (strips, _), images in zip(tasks, in_order(work, tasks, self.workers), strict=True):
                for (top, _), image in zip(strips, images, strict=True):
                    total[top * ny : top * ny + len(image)] += image
        return self.grid.unpack(total, before=centre_of(operand))

    def adjoint(self, image: NDArray[Any], operands: Iterable[NDArray[Any]]) -> Iterator[NDArray[Any]]:
        """Yield the back projection of ``image`` for each operand."""
        masked = image if self.mask is None else image * self.mask
        (ny, nx), (cells_y, cells_x) = self.grid.period, self.grid.cells
        for operand in operands:
            cells = self.cells_of(operand, masked)
            plane = cells.reshape(ny, cells_y, cells_x, nx).transpose(1, 0, 2, 3).reshape(cells_y * ny, cells_x * nx)
            yield np.ascontiguousarray(self.grid.unpack(plane))

    def cells_of(self, operand: NDArray[Any], image: NDArray[Any]) -> NDArray[Any]:
        """Return products of patterns and ``image``, ``(rows, lattice cells, columns)``: transpose of `image_of`."""
        packed = self.grid.pack(image, self.dtype, before=centre_of(operand), after=centre_of(operand))
        cells = np.zeros((len(operand), self.grid.cells[0] * self.grid.cells[1], operand.shape[1]), self.dtype)
        groups = self._groups(operand)

        (ny, _), (_, cells_x) = self.grid.period, self.grid.cells

        def work(task: Task) -> None:
            strips, own = task
            images = [packed[a * ny :] for a, _ in strips]
            parts = [cells[:, a * cells_x : b * cells_x] for a, b in strips]
            scratch = _Scratch(self.dtype)
            for group in groups[own]:
                self._collect(images, operand, group, [one[group] for one in parts], scratch)

        with one_blas_thread():
            for _ in in_order(work, self._tasks(len(groups)), self.workers):
                pass
        return cells

    # -- steps -----------------------------------------------------------------------------------------
    def _by_row_phase(self, packed: NDArray[Any]) -> NDArray[Any]:
        """Return packed cells as ``(ny, cells, nx)``."""
        (ny, nx), (cells_y, cells_x) = self.grid.period, self.grid.cells
        return packed.reshape(cells_y, ny, cells_x, nx).swapaxes(0, 1).reshape(ny, cells_y * cells_x, nx)

    def _groups(self, operand: NDArray[Any]) -> list[slice]:
        """Return runs of rows of sources that share windows."""
        step = rows_together(len(operand), operand.shape[1], len(strips_of(self.grid.cells)))
        return [slice(k, min(k + step, len(operand))) for k in range(0, len(operand), step)]

    def _tasks(self, groups: int) -> list[Task]:
        """Return the units of work; strips are added in the same order for any number of strips that share bands."""
        strips, step = strips_of(self.grid.cells), strips_together(self.grid, self.workers)
        parts = chunks(groups, math.ceil(PARTS / len(strips)))
        return [(strips[k : k + step], slice(*part)) for part in parts for k in range(0, len(strips), step)]

    def _spread(
        self,
        sources: list[NDArray[Any]],
        operand: NDArray[Any],
        group: slice,
        images: list[NDArray[Any]],
        scratch: _Scratch,
    ) -> None:
        """Add the patterns of some rows, weighted by ``sources`` (rows, cells, columns) of each strip, to its image."""
        (ny, nx), cells_x, y = self.grid.period, self.grid.cells[1], int(self.sources[0][group.start])
        by_cell = [one.swapaxes(0, 1).reshape(one.shape[1], -1) for one in sources]
        for rows, own, band in self._bands(operand, group, scratch):
            window = band.shape[-2:]
            flat = band.reshape(-1, math.prod(window))
            for strip, first, stop in self._blocks(by_cell, window):
                windows = scratch.array("windows", (stop - first, *window))
                np.matmul(by_cell[strip][first:stop, own], flat, out=windows.reshape(stop - first, -1))
                # windows of neighbouring cells overlap, because a pattern is wider than the period
                add_windows(windows, images[strip], Tiling(y + rows.start, cells_x, ny, nx), first)

    def _collect(
        self,
        images: list[NDArray[Any]],
        operand: NDArray[Any],
        group: slice,
        cells: list[NDArray[Any]],
        scratch: _Scratch,
    ) -> None:
        """Add the products of the patterns and each strip's image to its ``cells``: the transpose of `_spread`."""
        (ny, nx), cells_x, y = self.grid.period, self.grid.cells[1], int(self.sources[0][group.start])
        by_cell = [np.zeros((one.shape[1], len(one) * one.shape[2]), self.dtype) for one in cells]
        for rows, own, band in self._bands(operand, group, scratch):
            window = band.shape[-2:]
            flat = band.reshape(-1, math.prod(window)).T
            for strip, first, stop in self._blocks(by_cell, window):
                windows = scratch.array("windows", (stop - first, *window))
                copy_windows(windows, images[strip], Tiling(y + rows.start, cells_x, ny, nx), first)
                by_cell[strip][first:stop, own] += windows.reshape(stop - first, -1) @ flat
        for one, sums in zip(cells, by_cell, strict=True):
            one[:] = sums.reshape(one.shape[1], len(one), -1).swapaxes(0, 1)

    def _bands(
        self, operand: NDArray[Any], group: slice, scratch: _Scratch
    ) -> Iterator[tuple[slice, slice, NDArray[Any]]]:
        """Yield runs of window rows, the sources of the group whose patterns have these rows, and their banded matrix.

        The matrix is ``(rows of sources, columns of sources, window rows, nx + ns - 1)``: pattern ``x`` is shifted by
        ``x`` columns to the right, and patterns of later rows of sources are lower.
        """
        at_y, at_x = self.sources
        nt, ns = operand.shape[2:]
        width, down = self.grid.period[1] + ns - 1, at_y[group] - at_y[group.start]
        height = nt + int(down[-1])
        step = rows_at_once(nt, width, self.dtype.itemsize)
        for rows in self._row_runs(height, int(at_y[group.start]) - (nt - 1) // 2, step, int(down[-1])):
            count = rows.stop - rows.start
            own = slice(
                int(np.searchsorted(down, rows.start - nt, side="right")), int(np.searchsorted(down, rows.stop))
            )
            patterns = operand[group][own]
            # elements outside the patterns are never written, so the zeros of the first use remain
            band = scratch.array(f"band of {count} rows", (len(patterns), len(at_x), count, width))
            place_patterns(patterns, down[own] - rows.start, at_x, band)
            yield rows, slice(own.start * len(at_x), own.stop * len(at_x)), band

    def _row_runs(self, height: int, first: int, step: int, ramp: int) -> Iterator[slice]:
        """Yield runs of at most ``step`` window rows with selected image phases; row 0 has phase ``first``.

        The first and the last ``ramp`` rows are not reached by all rows of sources; a run ends in the middle of each.
        """
        half = ramp // 2 + 1
        cuts = [0, half, height - half, height] if half > LEAST_RAMP and height > 2 * half else [0, height]
        for start, stop in runs_of_rows(self.phases, height, first):
            edges = [start, *(cut for cut in cuts if start < cut < stop), stop]
            for top, bottom in itertools.pairwise(edges):
                yield from (slice(t, min(t + step, bottom)) for t in range(top, bottom, step))

    def _blocks(self, strips: list[NDArray[Any]], window: tuple[int, ...]) -> Iterator[tuple[int, int, int]]:
        """Yield strips ``(cells, sources)`` and runs of their cells whose windows together fill `WINDOW_BYTES`."""
        step = cells_at_once(window[0], window[1], self.dtype.itemsize)
        for strip, values in enumerate(strips):
            cells = len(values)
            # equal sizes, because a last one of few cells takes as long as a full one
            yield from ((strip, start, stop) for start, stop in chunks(cells, round(cells / step)))
