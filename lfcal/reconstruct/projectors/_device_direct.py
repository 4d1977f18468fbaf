"""Direct projection on a device: one matrix product for a few rows of sources, and addition of windows to the image.

The arithmetic is that of `projectors._direct`. Windows are added up in a few shifted slices of whole lattice rows,
instead of one by one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.reconstruct.projectors._device_engine import DeviceEngine, DeviceOperand, Placement
from lfcal.reconstruct.projectors._planes import centre_of, runs_of_rows, trim
from lfcal.reconstruct.projectors._reduction import Nodes, source_places
from lfcal.reconstruct.projectors.grid import Grid

__all__ = ["DeviceDirect", "direct_bytes"]

SOURCES = 128
"""Inner length of a product: number of sources that share windows, because adding windows is limited by memory."""


def direct_bytes(grid: Grid, sources: tuple[int, int], itemsize: int) -> int:
    """Return the smallest working memory (bytes): a lattice row, and placed patterns of ``sources`` (rows, columns)."""
    (ny, nx), (nt, ns) = grid.period, grid.cutout
    together = min(sources[0], math.ceil(SOURCES / sources[1]))
    height, width = nt + math.ceil(together * ny / sources[0]), nx + ns - 1
    image = (grid.cells[0] * ny + 2 * ny + height) * (grid.cells[1] * nx + nx + width)
    bands = 3 * together * sources[1] * height * width
    return (4 * image + bands + 4 * grid.cells[1] * (height + ny) * (width + nx)) * itemsize


@dataclass(frozen=True)
class _Run:
    """Rows of sources that share windows of ``height`` rows; ``top`` is the first of these rows in a cell."""

    group: slice
    down: tuple[int, ...]  # from the first row of the window to the first of each row's patterns; may be negative
    top: int
    height: int


class DeviceDirect(DeviceEngine):
    """Direct projection on a device; ``phases`` and ``nodes`` are those of `projectors._direct.Direct`."""

    name = "direct"
    any_phases = True

    def __init__(
        self,
        grid: Grid,
        dtype: np.dtype[Any],
        placement: Placement,
        phases: NDArray[np.bool_] | None = None,
        nodes: Nodes | None = None,
    ) -> None:
        super().__init__(grid, dtype, placement)
        self.regular = nodes is None
        self.at_y, self.at_x = (at.tolist() for at in source_places(grid.period, nodes))
        self.phases = phases
        # the order of sums in a product depends on the device
        self.rounding = 20 * float(np.finfo(dtype).eps)
        with self.device.active():
            self.masked = self.mask(phases)

    def prepared(self, plane: NDArray[Any]) -> tuple[tuple[NDArray[Any], ...], Any]:
        """Return the plane with its cutout cropped to the non-zero part."""
        return (np.ascontiguousarray(trim(plane)),), None

    def add(self, total: Any, operand: DeviceOperand, plane: Any) -> Any:
        """Return ``total`` plus the image of a volume plane, before the mask."""
        image = self.image_of(operand.arrays[0], self._by_row_phase(self.packed(plane)))
        return image if total is None else total + image

    def image(self, total: Any) -> Any:
        """Return the image at the selected phases."""
        return total if self.masked is None else total * self.masked

    def seen(self, image: Any) -> Any:
        """Return the image at the selected phases."""
        return self.image(image)

    def back(self, seen: Any, operand: DeviceOperand) -> Any:
        """Return the back projection of an image on one plane."""
        (ny, nx), (cells_y, cells_x), xp = self.grid.period, self.grid.cells, self.device.xp
        cells = xp.reshape(self.cells_of(operand.arrays[0], seen), (ny, cells_y, cells_x, nx))
        return self.grid.unpack(xp.reshape(xp.permute_dims(cells, (1, 0, 2, 3)), (cells_y * ny, cells_x * nx)))

    # -- patterns at some positions, and the sources that they belong to ------------------------------------
    def image_of(self, patterns: Any, cells: Any) -> Any:
        """Return the image of sources ``cells`` ``(rows, lattice cells, columns)`` with ``patterns``."""
        xp, (ny, nx), cells_x = self.device.xp, self.grid.period, self.grid.cells[1]
        image = self.device.zeros(self._padded_shape(patterns), self.dtype)
        width = nx + patterns.shape[3] - 1
        for run, band in self._bands(patterns):
            sources = xp.permute_dims(cells[run.group, :, :], (1, 0, 2))
            flat, matrix = xp.reshape(sources, (sources.shape[0], -1)), xp.reshape(band, (-1, run.height * width))
            for first, stop in self._blocks(run.height, width):
                windows = xp.matmul(flat[first * cells_x : stop * cells_x, :], matrix)
                rows = self._folded(xp.reshape(windows, (stop - first, cells_x, run.height, width)))
                top = run.top + first * ny
                image[top : top + rows.shape[0], : rows.shape[1]] += rows
        return self.grid.unpack(image, before=centre_of(patterns))

    def cells_of(self, patterns: Any, image: Any) -> Any:
        """Return products of patterns and ``image``, ``(rows, lattice cells, columns)``: transpose of `image_of`."""
        xp, (ny, nx), (cells_y, cells_x) = self.device.xp, self.grid.period, self.grid.cells
        height, across = self._padded_shape(patterns)
        before = centre_of(patterns)
        after = (height - cells_y * ny - before[0], across - cells_x * nx - before[1])
        padded = self.packed(image, before, after)
        cells = self.device.zeros((patterns.shape[0], cells_y * cells_x, patterns.shape[1]), self.dtype)
        width = nx + patterns.shape[3] - 1
        for run, band in self._bands(patterns):
            turned = xp.matrix_transpose(xp.reshape(band, (-1, run.height * width)))
            for first, stop in self._blocks(run.height, width):
                windows = self._windows(padded, run, (first, stop), width)
                product = xp.reshape(xp.matmul(windows, turned), ((stop - first) * cells_x, len(run.down), -1))
                cells[run.group, first * cells_x : stop * cells_x, :] += xp.permute_dims(product, (1, 0, 2))
        return cells

    # -- steps -----------------------------------------------------------------------------------------
    def _by_row_phase(self, packed: Any) -> Any:
        """Return packed cells as ``(ny, cells, nx)``."""
        (ny, nx), (cells_y, cells_x), xp = self.grid.period, self.grid.cells, self.device.xp
        cells = xp.permute_dims(xp.reshape(packed, (cells_y, ny, cells_x, nx)), (1, 0, 2, 3))
        return xp.reshape(cells, (ny, cells_y * cells_x, nx))

    def _padded_shape(self, patterns: Any) -> tuple[int, int]:
        """Return the shape of an image that contains every window, rounded up to whole cells."""
        (ny, nx), (cells_y, cells_x), (nt, ns) = self.grid.period, self.grid.cells, patterns.shape[2:]
        return (cells_y + -(-(nt + ny) // ny) + 1) * ny, (cells_x + -(-(nx + ns - 1) // nx)) * nx

    def _bands(self, patterns: Any) -> Iterator[tuple[_Run, Any]]:
        """Yield runs, and the patterns of each laid out in its windows, ``(rows, columns, height, nx + ns - 1)``."""
        nt = patterns.shape[2]
        together = math.ceil(SOURCES / len(self.at_x))
        for start in range(0, len(self.at_y), together):
            group = slice(start, min(start + together, len(self.at_y)))
            laid = self._laid(patterns[group, :, :, :])
            down = [y - self.at_y[start] for y in self.at_y[group]]
            for low, high in runs_of_rows(self.phases, nt + down[-1], self.at_y[start] - (nt - 1) // 2):
                run = _Run(group, tuple(d - low for d in down), self.at_y[start] + low, high - low)
                band = self.device.zeros((len(down), len(self.at_x), run.height, laid.shape[3]), self.dtype)
                for g, row in enumerate(run.down):
                    begin, end = max(0, row), min(run.height, row + nt)
                    if begin < end:
                        band[g, :, begin:end, :] = laid[g, :, begin - row : end - row, :]
                yield run, band

    def _laid(self, patterns: Any) -> Any:
        """Return patterns ``(k, columns, nt, ns)`` in rows of ``nx + ns - 1``, each shifted right by its column."""
        xp, (rows, columns, nt, ns) = self.device.xp, patterns.shape
        width = self.grid.period[1] + ns - 1
        laid = self.device.zeros((rows, columns, nt, width), self.dtype)
        if not self.regular:
            for k, left in enumerate(self.at_x):
                laid[:, k, :, left : left + ns] = patterns[:, k, :, :]
            return laid
        laid[:, :, :, :ns] = patterns
        # one padding value per pattern, cut off at the end, shifts each pattern by one more than the previous one
        size = nt * width
        longer = xp.concat(
            [xp.reshape(laid, (rows, columns, size)), self.device.zeros((rows, columns, 1), self.dtype)], axis=2
        )
        flat = xp.reshape(longer, (rows, columns * (size + 1)))[:, : columns * size]
        return xp.reshape(flat, (rows, columns, nt, width))

    def _blocks(self, height: int, width: int) -> Iterator[tuple[int, int]]:
        """Yield runs of lattice rows whose windows fit into the available memory."""
        (cells_y, cells_x), (ny, nx) = self.grid.cells, self.grid.period
        one = 4 * cells_x * (height + ny) * (width + nx) * self.dtype.itemsize
        step = max(1, self.placement.room // one)
        yield from ((k, min(k + step, cells_y)) for k in range(0, cells_y, step))

    def _folded(self, windows: Any) -> Any:
        """Return rows of the image: the sum of overlapping windows ``(cells_y, cells_x, height, width)``."""
        xp, (ny, nx), (down, across, height, width) = self.device.xp, self.grid.period, windows.shape
        reach_y, reach_x = -(-height // ny), -(-width // nx)
        columns = self.device.zeros((down, reach_y * ny, across + reach_x, nx), self.dtype)
        for k in range(reach_x):
            part = xp.permute_dims(windows[:, :, :, k * nx : min((k + 1) * nx, width)], (0, 2, 1, 3))
            columns[:, :height, k : k + across, : part.shape[3]] += part
        cells = xp.reshape(columns, (down, reach_y, ny, (across + reach_x) * nx))
        rows = self.device.zeros((down + reach_y - 1, ny, cells.shape[3]), self.dtype)
        for k in range(reach_y):
            rows[k : k + down, :, :] += cells[:, k, :, :]
        return xp.reshape(rows, ((down + reach_y - 1) * ny, cells.shape[3]))

    def _windows(self, padded: Any, run: _Run, block: tuple[int, int], width: int) -> Any:
        """Return the windows of some lattice rows of a padded image, ``(cells, height * width)``."""
        xp, (ny, nx), across = self.device.xp, self.grid.period, self.grid.cells[1]
        (first, stop), height = block, run.height
        reach_y, reach_x, down = -(-height // ny), -(-width // nx), stop - first
        top = run.top + first * ny
        slab = xp.reshape(padded[top : top + (down + reach_y - 1) * ny, :], (down + reach_y - 1, ny, -1))
        rows = xp.stack([slab[k : k + down, :, :] for k in range(reach_y)], axis=1)
        rows = xp.reshape(rows, (down, reach_y * ny, -1))[:, :height, : (across + reach_x) * nx]
        cells = xp.reshape(rows, (down, height, across + reach_x, nx))
        windows = xp.stack([cells[:, :, k : k + across, :] for k in range(reach_x)], axis=3)
        windows = xp.reshape(windows, (down, height, across, reach_x * nx))[:, :, :, :width]
        return xp.reshape(xp.permute_dims(windows, (0, 2, 1, 3)), (down * across, height * width))
