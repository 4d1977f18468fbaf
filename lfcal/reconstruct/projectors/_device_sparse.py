"""Sparse projection on a device: rows of shifted lattices gathered, and summed by small products.

Entries of H are stored as in `projectors._sparse`, for both directions, in slices of rows of about equal length that
are filled up with zeros (SELL: Kreutzer et al. 2014, SIAM J. Sci. Comput. 36, C401).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.reconstruct.projectors._device_engine import DeviceEngine, DeviceOperand, Placement
from lfcal.reconstruct.projectors._kernels import Entries
from lfcal.reconstruct.projectors._sparse import Sparse, SparseOperand
from lfcal.reconstruct.projectors.grid import Grid

__all__ = ["DeviceSparse", "Slices", "sparse_bytes"]

ROWS, EVEN = 64, 0.85
"""Largest number of rows in a slice, sorted by length, and smallest ratio of a length to the longest in its slice."""


def sparse_bytes(grid: Grid, itemsize: int) -> int:
    """Return the smallest working memory (bytes): a lattice row in all shifts, and the values of one entry per row."""
    (cells_y, cells_x), (ry, rx), n = grid.cells, grid.reach, grid.phases
    padded = (cells_y + 2 * ry) * (cells_x + 2 * rx)
    shifted = (2 * ry + 1) * (2 * rx + 1) * cells_x
    return (n * (2 * padded + 4 * cells_y * cells_x + 2 * shifted) + 2 * ROWS * cells_x) * itemsize


@dataclass(frozen=True, slots=True)
class Slices:
    """Layout of the entries of one direction: for each slice, its rows, entries per row, and first entry."""

    slices: tuple[tuple[int, int, int], ...]


class DeviceSparse(DeviceEngine):
    """Sparse projection on a device; see `lfcal.reconstruct.projectors._sparse.Sparse`."""

    name = "sparse"
    any_phases = False

    def __init__(
        self,
        grid: Grid,
        dtype: np.dtype[Any],
        placement: Placement,
        workers: int | None = None,
        phases: NDArray[np.bool_] | None = None,
    ) -> None:
        super().__init__(grid, dtype, placement)
        self.host = Sparse(grid, dtype, workers, phases)
        self.rounding = 20 * float(np.finfo(dtype).eps)

    def prepared(self, plane: NDArray[Any]) -> tuple[tuple[NDArray[Any], ...], Any]:
        """Return the gathered rows, values and positions of phases for both directions, and their slices."""
        return self.sliced(self.host.prepare(plane))

    def sliced(self, operand: SparseOperand) -> tuple[tuple[NDArray[Any], ...], Any]:
        """Convert entries prepared for the processor to the form of `prepared`."""
        ahead, back = self._sliced(operand.pixels), self._sliced(operand.sources)
        return (*ahead[0], *back[0]), (ahead[1], back[1])

    def add(self, total: Any, operand: DeviceOperand, plane: Any) -> Any:
        """Return ``total`` plus the values by phase of the image of a volume plane, ``(phases, cells)``."""
        found = self._sums(operand.arrays[:3], operand.facts[0], self._spread(plane))
        return found if total is None else total + found

    def image(self, total: Any) -> Any:
        """Return the image ``(Y, X)`` from its values by phase."""
        (ny, nx), (cells_y, cells_x), xp = self.grid.period, self.grid.cells, self.device.xp
        cells = xp.permute_dims(xp.reshape(total, (ny, nx, cells_y, cells_x)), (2, 0, 3, 1))
        return self.grid.unpack(xp.reshape(cells, (cells_y * ny, cells_x * nx)))

    def seen(self, image: Any) -> Any:
        """Return an image by phase, with margins."""
        return self._spread(image)

    def back(self, seen: Any, operand: DeviceOperand) -> Any:
        """Return the back projection of an image by phase on one plane."""
        return self.image(self._sums(operand.arrays[3:6], operand.facts[1], seen))

    # -- on the processor ------------------------------------------------------------------------------
    def _sliced(self, entries: Entries) -> tuple[tuple[NDArray[Any], NDArray[Any], NDArray[Any]], Slices]:
        counts = np.diff(entries.start)
        order = np.argsort(-counts, kind="stable")
        order = order[: int(np.count_nonzero(counts))]
        rows, values, slices = [], [], []
        number, begin = self._gathered(entries.offset), 0
        k = 0
        while k < len(order):
            most = int(counts[order[k]])
            own = order[k : k + ROWS]
            own = own[counts[own] >= EVEN * most]
            k += len(own)
            inside = np.arange(most) < counts[own][:, None]
            at = np.where(inside, entries.start[own][:, None] + np.arange(most), 0)
            rows.append(np.where(inside, number[at], 0).ravel())
            values.append(np.where(inside, entries.value[at], 0).ravel())
            slices.append((len(own), most, begin))
            begin += inside.size
        # phases without entries share the last entry, which is zero
        places = np.full(len(counts), len(order), np.int32)
        places[order] = np.arange(len(order), dtype=np.int32)
        none = (np.empty(0, np.int32), np.empty(0, self.dtype))
        flat = [np.concatenate(own) if own else empty for own, empty in zip((rows, values), none, strict=True)]
        return (flat[0].astype(np.int32), flat[1].astype(self.dtype), places), Slices(tuple(slices))

    def _gathered(self, offset: NDArray[Any]) -> NDArray[np.int32]:
        """Return the number of the row of shifted lattices that each entry multiplies: shift, and phase within it."""
        rx, host = self.grid.reach[1], self.host
        phase, inside = np.divmod(offset.astype(np.int64) + host.base, host.block)
        # shifts are counted from the first, so that none is negative
        down, across = np.divmod(inside, host.stride)
        return ((down * (2 * rx + 1) + across) * self.grid.phases + phase).astype(np.int32)

    # -- on the device ---------------------------------------------------------------------------------
    def _spread(self, plane: Any) -> Any:
        """Return ``plane`` by phase with zero margins, ``(phases, cells_y + 2 ry, cells_x + 2 rx)``."""
        (ny, nx), (cells_y, cells_x), (ry, rx), xp = *self._sizes(), self.device.xp
        cells = xp.permute_dims(xp.reshape(self.packed(plane), (cells_y, ny, cells_x, nx)), (1, 3, 0, 2))
        out = self.device.zeros((ny * nx, cells_y + 2 * ry, cells_x + 2 * rx), self.dtype)
        out[:, ry : ry + cells_y, rx : rx + cells_x] = xp.reshape(cells, (ny * nx, cells_y, cells_x))
        return out

    def _sums(self, arrays: tuple[Any, ...], kept: Slices, values: Any) -> Any:
        """Return the sums of entries times shifted lattices, ``(phases, cells)``."""
        rows, weights, places = arrays
        cells_x = self.grid.cells[1]
        xp, parts = self.device.xp, []
        for first, stop in self._blocks():
            lattices = self._shifted(values, first, stop)
            found = [self._slice(rows, weights, one, lattices) for one in kept.slices]
            found.append(self.device.zeros((1, (stop - first) * cells_x), self.dtype))
            parts.append(xp.take(xp.concat(found, axis=0), places, axis=0))
        return parts[0] if len(parts) == 1 else xp.concat(parts, axis=1)

    def _shifted(self, values: Any, first: int, stop: int) -> Any:
        """Return rows of the lattice with all shifts, ``(shifts * phases, cells)``."""
        _, (_, cells_x), (ry, rx) = self._sizes()
        xp, n = self.device.xp, self.grid.phases
        ways = [(dy, dx) for dy in range(2 * ry + 1) for dx in range(2 * rx + 1)]
        cut = [values[:, first + dy : stop + dy, dx : dx + cells_x] for dy, dx in ways]
        return xp.reshape(xp.stack(cut, axis=0), (len(ways) * n, (stop - first) * cells_x))

    def _slice(self, rows: Any, weights: Any, one: tuple[int, int, int], lattices: Any) -> Any:
        """Return the sums of one slice, ``(rows, cells)``."""
        xp, (count, most, begin) = self.device.xp, one
        own = xp.reshape(rows[begin : begin + count * most], (count, most))
        weight = xp.reshape(weights[begin : begin + count * most], (count, 1, most))
        step = max(1, self.placement.room // (2 * count * lattices.shape[1] * self.dtype.itemsize))
        total = None
        for k in range(0, most, step):
            part = slice(k, min(k + step, most))
            number = xp.reshape(own[:, part], (-1,))
            gathered = xp.reshape(xp.take(lattices, number, axis=0), (count, -1, lattices.shape[1]))
            found = xp.matmul(weight[:, :, part], gathered)
            total = found if total is None else total + found
        return xp.reshape(total, (count, lattices.shape[1]))

    def _blocks(self) -> Iterator[tuple[int, int]]:
        """Yield runs of lattice rows whose shifted lattices fit into half of the available memory."""
        _, (cells_y, cells_x), (ry, rx) = self._sizes()
        one = 2 * (2 * ry + 1) * (2 * rx + 1) * self.grid.phases * cells_x * self.dtype.itemsize
        step = max(1, self.placement.room // 2 // one)
        yield from ((k, min(k + step, cells_y)) for k in range(0, cells_y, step))

    def _sizes(self) -> tuple[tuple[int, int], tuple[int, int], tuple[int, int]]:
        return self.grid.period, self.grid.cells, self.grid.reach
