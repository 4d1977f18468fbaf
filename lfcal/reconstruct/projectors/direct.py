"""Direct projection for large periods: matrix products over the period's columns, windows added up.

For one row of source phases the ``nx`` patterns, each moved to its own column, form a banded matrix. One product
with it yields the windows of all lattice cells, which are added to the image where they overlap.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.reconstruct.projectors._kernels import Tiling, gather_windows, overlap_add
from lfcal.reconstruct.projectors.grid import Grid
from lfcal.reconstruct.projectors.nodes import Nodes
from lfcal.reconstruct.projectors.planes import trim
from lfcal.threads import for_each_chunk, one_blas_thread, worker_count

__all__ = ["Direct"]

WINDOW_BYTES = 1 << 21
"""Size of the window buffer of a product: about the second-level cache."""


class _Scratch:
    """Arrays a worker uses again and again, zero when first made."""

    def __init__(self, dtype: np.dtype[Any]) -> None:
        self.dtype = dtype
        self.kept: dict[str, NDArray[Any]] = {}

    def array(self, name: str, shape: tuple[int, ...]) -> NDArray[Any]:
        """Return the array ``name`` in ``shape``, larger ones before smaller ones."""
        size = math.prod(shape)
        if name not in self.kept or self.kept[name].size < size:
            self.kept[name] = np.zeros(size, self.dtype)
        return self.kept[name][:size].reshape(shape)


def rows_at_once(nt: int, width: int, itemsize: int) -> int:
    """Return how many pattern rows a product takes, so that windows of 64 cells fill `WINDOW_BYTES`."""
    return max(1, min(nt, WINDOW_BYTES // (64 * width * itemsize)))


def cells_at_once(rows: int, width: int, itemsize: int) -> int:
    """Return how many lattice cells a product takes."""
    # a product of fewer rows is bound by reading its right factor
    return max(16, WINDOW_BYTES // (rows * width * itemsize))


class Direct:
    """Project with dense matrix products; H needs no preparation and may be read plane by plane.

    ``phases`` (ny, nx) selects image phases: rows of the patterns that hold none of them are left out. With ``nodes``
    only positions at nodes have patterns, ``(my, mx, nt, ns)``: see `image_of` and `cells_of`.
    """

    name = "direct"

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
        ny, nx = grid.period
        self.sources = (np.arange(ny), np.arange(nx)) if nodes is None else (nodes.y.at, nodes.x.at)
        self.dtype = dtype
        self.workers = worker_count(workers)
        self.rounding = float(np.finfo(dtype).tiny)
        self.phases = phases
        self.mask = None if phases is None else grid.tiled(phases)

    def prepare(self, plane: NDArray[Any]) -> NDArray[Any]:
        """Return the plane, its cutout cut down to where it is not zero."""
        return trim(plane)

    def operand_bytes(self, operand: NDArray[Any]) -> int:
        """Return the bytes of the plane."""
        base = operand if operand.base is None else operand.base
        return int(base.nbytes)

    def forward(self, planes: Iterable[tuple[NDArray[Any], NDArray[Any]]]) -> NDArray[Any]:
        """Return the image of pairs (operand, volume plane)."""
        total = np.zeros(self.grid.image_shape, self.dtype)
        for operand, plane in planes:
            total += self.image_of(operand, self._by_row_phase(self.grid.pack(plane, self.dtype)))
        return total if self.mask is None else total * self.mask

    def image_of(self, operand: NDArray[Any], cells: NDArray[Any]) -> NDArray[Any]:
        """Return the image of sources ``cells`` ``(rows, lattice cells, columns)``, those of nodes where it has any."""
        total = np.zeros(self.grid.image_shape, self.dtype)

        def work(start: int, stop: int) -> NDArray[Any]:
            image, scratch = self._empty_image(operand), _Scratch(self.dtype)
            for row in range(start, stop):
                self._spread(cells[row], operand, row, image, scratch)
            return image

        # threads over row phases, each with an image of its own: BLAS's threads on top would only queue
        with one_blas_thread():
            for image in for_each_chunk(work, len(operand), self.workers, parts_per_worker=1):
                total += self.grid.unpack(image, before=_centre(operand))
        return total

    def adjoint(self, image: NDArray[Any], operands: Iterable[NDArray[Any]]) -> Iterator[NDArray[Any]]:
        """Yield the back projection of ``image`` for each operand."""
        masked = image if self.mask is None else image * self.mask
        (ny, nx), (cells_y, cells_x) = self.grid.period, self.grid.cells
        for operand in operands:
            cells = self.cells_of(operand, masked)
            plane = cells.reshape(ny, cells_y, cells_x, nx).transpose(1, 0, 2, 3).reshape(cells_y * ny, cells_x * nx)
            yield np.ascontiguousarray(self.grid.unpack(plane))

    def cells_of(self, operand: NDArray[Any], image: NDArray[Any]) -> NDArray[Any]:
        """Return the patterns' products with ``image``, ``(rows, lattice cells, columns)``: transpose of `image_of`."""
        packed = self.grid.pack(image, self.dtype, before=_centre(operand), after=_centre(operand))
        cells = np.empty((len(operand), self.grid.cells[0] * self.grid.cells[1], operand.shape[1]), self.dtype)

        def work(start: int, stop: int) -> None:
            scratch = _Scratch(self.dtype)
            for row in range(start, stop):
                self._collect(packed, operand, row, cells[row], scratch)

        with one_blas_thread():
            for_each_chunk(work, len(operand), self.workers)
        return cells

    # -- steps -----------------------------------------------------------------------------------------
    def _by_row_phase(self, packed: NDArray[Any]) -> NDArray[Any]:
        """Return packed cells as ``(ny, cells, nx)``."""
        (ny, nx), (cells_y, cells_x) = self.grid.period, self.grid.cells
        return packed.reshape(cells_y, ny, cells_x, nx).swapaxes(0, 1).reshape(ny, cells_y * cells_x, nx)

    def _empty_image(self, operand: NDArray[Any]) -> NDArray[Any]:
        (ny, nx), (cells_y, cells_x), (nt, ns) = self.grid.period, self.grid.cells, operand.shape[2:]
        return np.zeros((cells_y * ny + nt - 1, cells_x * nx + ns - 1), self.dtype)

    def _spread(
        self, sources: NDArray[Any], operand: NDArray[Any], row: int, image: NDArray[Any], scratch: _Scratch
    ) -> None:
        """Add the patterns of a row of sources, weighted by ``sources`` (cells, columns), to the padded ``image``."""
        (ny, nx), cells_x, y = self.grid.period, self.grid.cells[1], int(self.sources[0][row])
        for rows, band in self._bands(operand, row, scratch):
            for first, stop in self._blocks(len(sources), band.shape[1:]):
                windows = scratch.array("windows", (stop - first, *band.shape[1:]))
                np.matmul(sources[first:stop], band.reshape(len(band), -1), out=windows.reshape(stop - first, -1))
                # windows of neighbouring cells overlap: a pattern is wider than the period
                overlap_add(windows, image, Tiling(y + rows.start, cells_x, ny, nx), first)

    def _collect(
        self, packed: NDArray[Any], operand: NDArray[Any], row: int, cells: NDArray[Any], scratch: _Scratch
    ) -> None:
        """Write the patterns' products with the padded image into ``cells``: the transpose of `_spread`."""
        (ny, nx), cells_x, y = self.grid.period, self.grid.cells[1], int(self.sources[0][row])
        cells[:] = 0
        for rows, band in self._bands(operand, row, scratch):
            for first, stop in self._blocks(len(cells), band.shape[1:]):
                windows = scratch.array("windows", (stop - first, *band.shape[1:]))
                gather_windows(windows, packed, Tiling(y + rows.start, cells_x, ny, nx), first)
                cells[first:stop] += windows.reshape(stop - first, -1) @ band.reshape(len(band), -1).T

    def _bands(self, operand: NDArray[Any], row: int, scratch: _Scratch) -> Iterator[tuple[slice, NDArray[Any]]]:
        """Yield runs of pattern rows and the banded matrix ``(columns, rows, nx + ns - 1)`` of each.

        Pattern ``x`` lies ``x`` columns to the right: seen through a view whose rows are one longer, that is a
        plain copy.
        """
        nx, (nt, ns) = self.grid.period[1], operand.shape[2:]
        width = nx + ns - 1
        step = rows_at_once(nt, width, self.dtype.itemsize)
        for rows in self._row_runs(nt, int(self.sources[0][row]), step):
            count = rows.stop - rows.start
            # What lies beside the patterns is never written, so the zeros of the first use last.
            if self.nodes is not None:
                moved = scratch.array(f"band of {count} rows", (len(self.sources[1]), count, width))
                for k, x in enumerate(self.sources[1].tolist()):
                    moved[k, :, x : x + ns] = operand[row, k, rows]
                yield rows, moved
                continue
            band = scratch.array(f"band of {count} rows", (nx * count * width + nx,))
            item = self.dtype.itemsize
            strides = ((count * width + 1) * item, width * item, item)
            np.lib.stride_tricks.as_strided(band, (nx, count, ns), strides)[...] = operand[row, :, rows]
            yield rows, band[: nx * count * width].reshape(nx, count, width)

    def _row_runs(self, nt: int, y: int, step: int) -> Iterator[slice]:
        """Yield runs of at most ``step`` pattern rows that fall onto selected image phases."""
        if self.phases is None:
            yield from (slice(t, min(t + step, nt)) for t in range(0, nt, step))
            return
        ny = self.grid.period[0]
        used = np.asarray(self.phases.any(axis=1))
        wanted = used[(y + np.arange(nt) - (nt - 1) // 2) % ny]
        # ends of the runs of wanted rows, with a row that is not wanted on either side
        edges = np.flatnonzero(np.diff(np.concatenate(([0], wanted.astype(np.int8), [0]))))
        for start, stop in edges.reshape(-1, 2):
            yield from (slice(t, min(t + step, int(stop))) for t in range(int(start), int(stop), step))

    def _blocks(self, cells: int, window: tuple[int, ...]) -> Iterator[tuple[int, int]]:
        """Yield runs of lattice cells whose windows fill `WINDOW_BYTES`."""
        step = cells_at_once(window[0], window[1], self.dtype.itemsize)
        yield from ((k, min(k + step, cells)) for k in range(0, cells, step))


def _centre(operand: NDArray[Any]) -> tuple[int, int]:
    return (operand.shape[2] - 1) // 2, (operand.shape[3] - 1) // 2
