"""Sparse projection: only the non-zero entries of H, each applied to a whole lattice."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, for_each_chunk, worker_count
from lfcal.reconstruct.projectors._kernels import Entries, PhaseLayout, count_entries, fill_entries, gather_sums
from lfcal.reconstruct.projectors.grid import Grid

__all__ = ["Sparse", "SparseOperand"]


@dataclass(frozen=True, slots=True)
class SparseOperand:
    """One plane's entries, sorted for the forward and for the adjoint projection."""

    pixels: Entries
    sources: Entries


class Sparse:
    """Project entry by entry: the cost is proportional to the number of non-zero entries of H.

    Values are stored by phase, each phase's lattice contiguous and with zero margins. An entry is then a shifted
    multiply-add of whole lattices. ``phases`` (ny, nx) selects image phases.
    """

    name = "sparse"
    any_phases = False

    def __init__(
        self, grid: Grid, dtype: np.dtype[Any], workers: int | None = None, phases: NDArray[np.bool_] | None = None
    ) -> None:
        self.grid = grid
        self.dtype = dtype
        self.workers = worker_count(workers)
        self.rounding = float(np.finfo(dtype).tiny)
        self.keep = np.ones(grid.period, np.bool_) if phases is None else np.ascontiguousarray(phases, np.bool_)
        (cells_y, cells_x), (ry, rx) = grid.cells, grid.reach
        self.stride = cells_x + rx  # the right margin of a row is the left margin of the next
        self.base = ry * self.stride + rx
        self.block = (cells_y + 2 * ry) * self.stride + 2 * rx
        # offsets are 32-bit, because the kernel is limited by reading them
        if grid.phases * self.block >= 1 << 31:
            raise InputError.expected(
                "image and its margins, for the projection method sparse",
                f"fewer than {1 << 31:,} pixels",
                f"{grid.phases * self.block:,}",
                "choose another method, or reconstruct a smaller region of the image",
            )

    def prepare(self, plane: NDArray[Any]) -> SparseOperand:
        """Return the non-zero entries of a plane of H."""
        n = self.grid.phases
        by_source, by_pixel = np.zeros(n, np.int64), np.zeros(n, np.int64)
        count_entries(plane, self.keep, by_source, by_pixel)
        sources, pixels = self._room_for(by_source), self._room_for(by_pixel)
        fill_entries(plane, self.keep, PhaseLayout(self.stride, self.block, *self.grid.reach), sources, pixels)
        return SparseOperand(pixels, sources)

    def _room_for(self, counts: NDArray[np.int64]) -> Entries:
        """Return empty arrays for a given number of entries per phase."""
        start = np.concatenate(([0], np.cumsum(counts)))
        return Entries(start, np.empty(start[-1], np.int32), np.empty(start[-1], self.dtype))

    def operand_bytes(self, operand: SparseOperand) -> int:
        """Return the size of the entries (bytes)."""
        return operand.pixels.nbytes + operand.sources.nbytes

    def forward(self, planes: Iterable[tuple[SparseOperand, NDArray[Any]]]) -> NDArray[Any]:
        """Return the image of a volume, given as pairs (operand, volume plane)."""
        out = self._positions()
        for operand, plane in planes:
            self._add(operand.pixels, self._spread(plane), out)
        return self._image(out)

    def adjoint(self, image: NDArray[Any], operands: Iterable[SparseOperand]) -> Iterator[NDArray[Any]]:
        """Yield the back projection of ``image`` for each operand."""
        values = self._spread(image)
        for operand in operands:
            out = self._positions()
            self._add(operand.sources, values, out)
            yield self._image(out)

    # -- steps -----------------------------------------------------------------------------------------
    def _positions(self) -> NDArray[Any]:
        return np.zeros((self.grid.phases, self.grid.cells[0] * self.stride), self.dtype)

    def _spread(self, plane: NDArray[Any]) -> NDArray[Any]:
        """Return ``plane`` by phase with zero margins, flat."""
        (ny, nx), (cells_y, cells_x) = self.grid.period, self.grid.cells
        packed = self.grid.pack(plane, self.dtype).reshape(cells_y, ny, cells_x, nx).transpose(1, 3, 0, 2)
        out = np.zeros((ny, nx, self.block), self.dtype)
        # in rows of `stride` from the first inner position on, the margins are the tails of the rows
        inner = out[:, :, self.base : self.base + cells_y * self.stride]
        inner.reshape(ny, nx, cells_y, self.stride)[..., :cells_x] = packed
        return out.reshape(-1)

    def _add(self, rows: Entries, values: NDArray[Any], out: NDArray[Any]) -> None:
        def work(low: int, high: int) -> None:
            gather_sums(rows, values, out, self.base, low, high)

        for_each_chunk(work, self.grid.phases, self.workers)

    def _image(self, out: NDArray[Any]) -> NDArray[Any]:
        (ny, nx), (cells_y, cells_x) = self.grid.period, self.grid.cells
        cells = out.reshape(ny, nx, cells_y, self.stride)[..., :cells_x]
        return np.ascontiguousarray(self.grid.unpack(cells.transpose(2, 0, 3, 1).reshape(cells_y * ny, cells_x * nx)))
