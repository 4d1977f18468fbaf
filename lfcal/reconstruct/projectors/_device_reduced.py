"""Projection within a tolerance on a device: few patterns of weighted sums of sources, and sparse entries.

The arithmetic and the projected operator are those of `lfcal.reconstruct.projectors._reduced`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.reconstruct.projectors._device_direct import DeviceDirect
from lfcal.reconstruct.projectors._device_engine import DeviceEngine, DeviceOperand, Placement
from lfcal.reconstruct.projectors._device_sparse import DeviceSparse
from lfcal.reconstruct.projectors._reduced import Reduced
from lfcal.reconstruct.projectors._reduction import Nodes
from lfcal.reconstruct.projectors.device import ArrayDevice

__all__ = ["DeviceReduced", "collected", "spread"]


class DeviceReduced(DeviceEngine):
    """Reduced projection on a device, with operands that ``host``, a `projectors._reduced.Reduced`, prepares."""

    name = "reduced"
    any_phases = False

    def __init__(self, host: Reduced, placement: Placement) -> None:
        super().__init__(host.grid, host.dtype, placement)
        self.host = host
        self.whole = DeviceDirect(host.grid, host.dtype, placement, host.phases)
        self.rounding = self.whole.rounding
        self._tools: dict[float, tuple[Nodes, DeviceDirect, DeviceSparse]] = {}

    def prepared(self, plane: NDArray[Any]) -> tuple[tuple[NDArray[Any], ...], Any]:
        """Return patterns and, unless the plane is projected completely, entries; also the spacing and the slices."""
        operand = self.host.prepare(plane)
        patterns = np.ascontiguousarray(operand.patterns)
        if operand.rest is None:
            return (patterns,), (operand.spacing, None)
        arrays, slices = self._at(operand.spacing)[2].sliced(operand.rest)
        return (patterns, *arrays), (operand.spacing, slices)

    def add(self, total: Any, operand: DeviceOperand, plane: Any) -> Any:
        """Return ``total`` plus the image of a volume plane, before the mask."""
        spacing, slices = operand.facts
        if slices is None:
            return self.whole.add(total, operand, plane)
        nodes, between, beside = self._at(spacing)
        sources = collected(self.device, nodes, between.packed(self._widened(plane)), self.dtype)
        found = self._cropped(between.image_of(operand.arrays[0], sources))
        found = found + beside.image(beside.add(None, _rest(operand), plane))
        return found if total is None else total + found

    def image(self, total: Any) -> Any:
        """Return the image at the selected phases."""
        return self.whole.image(total)

    def seen(self, image: Any) -> Any:
        """Return the image at the selected phases."""
        return self.whole.seen(image)

    def back(self, seen: Any, operand: DeviceOperand) -> Any:
        """Return the back projection of an image on one plane."""
        spacing, slices = operand.facts
        if slices is None:
            return self.whole.back(seen, operand)
        nodes, between, beside = self._at(spacing)
        values = between.cells_of(operand.arrays[0], self._widened(seen))
        my, mx = nodes.shape
        values = self.device.xp.reshape(values, (my, *between.grid.cells, mx))
        plane = self._cropped(between.grid.unpack(spread(self.device, nodes, values, self.dtype)))
        return plane + beside.back(beside.seen(seen), _rest(operand))

    # -- steps -----------------------------------------------------------------------------------------
    def _at(self, spacing: float) -> tuple[Nodes, DeviceDirect, DeviceSparse]:
        """Return nodes with this spacing, the engine of their patterns, and the engine of the additional entries."""
        if spacing not in self._tools:
            host, nodes = self.host, Nodes.of(self.grid.period, spacing)
            wider = replace(self.grid, cutout=nodes.widened(self.grid.cutout))
            between = DeviceDirect(host.wide, self.dtype, self.placement, host.phases, nodes)
            beside = DeviceSparse(wider, self.dtype, self.placement, host.workers, host.phases)
            self._tools[spacing] = nodes, between, beside
        return self._tools[spacing]

    def _widened(self, plane: Any) -> Any:
        """Return an image or volume plane with a period of zeros below and to the right."""
        (ny, nx), (height, width) = self.grid.period, self.grid.image_shape
        out = self.device.zeros((height + ny, width + nx), self.dtype)
        out[:height, :width] = plane
        return out

    def _cropped(self, wide: Any) -> Any:
        height, width = self.grid.image_shape
        return wide[:height, :width]


def _rest(operand: DeviceOperand) -> DeviceOperand:
    """Return the entries of an operand as a separate operand."""
    return DeviceOperand(operand.arrays[1:], operand.nbytes, operand.there, operand.facts[1])


def collected(device: ArrayDevice, nodes: Nodes, packed: Any, dtype: np.dtype[Any]) -> Any:
    """Return the weighted sums at each node, ``(my, cells, mx)``: `Nodes.collected` on the device."""
    xp, (ny, nx), (my, mx) = device.xp, (nodes.y.period, nodes.x.period), nodes.shape
    down, across = (device.moved(axis.shares.astype(dtype)) for axis in (nodes.y, nodes.x))
    cells_y, cells_x = packed.shape[0] // ny, packed.shape[1] // nx
    rows = _carried(xp, device, xp.matmul(down, xp.reshape(packed, (cells_y, ny, packed.shape[1]))))
    columns = xp.matmul(xp.reshape(rows, (cells_y * my, cells_x, nx)), xp.matrix_transpose(across))
    both = _carried(xp, device, xp.permute_dims(columns, (1, 2, 0)))  # (cells_x, mx, cells_y my)
    apart = xp.permute_dims(xp.reshape(both, (cells_x, mx, cells_y, my)), (3, 2, 0, 1))
    return xp.reshape(apart, (my, cells_y * cells_x, mx))


def spread(device: ArrayDevice, nodes: Nodes, values: Any, dtype: np.dtype[Any]) -> Any:
    """Return ``(cells_y ny, cells_x nx)`` of nodes ``(my, cells_y, cells_x, mx)``: the transpose of `collected`."""
    xp, (my, cells_y, cells_x, mx) = device.xp, values.shape
    down, across = (device.moved(axis.shares.astype(dtype)) for axis in (nodes.y, nodes.x))
    both = xp.permute_dims(values, (2, 3, 1, 0))
    columns = _with_next(xp, device, xp.reshape(both, (cells_x, mx, cells_y * my)))  # (cells_x, mx + 1, cells_y my)
    rows = xp.matmul(xp.permute_dims(columns, (2, 0, 1)), across)  # (cells_y my, cells_x, nx)
    wide = _with_next(xp, device, xp.reshape(rows, (cells_y, my, cells_x * nodes.x.period)))
    out = xp.matmul(xp.matrix_transpose(down), wide)
    return xp.reshape(out, (cells_y * nodes.y.period, cells_x * nodes.x.period))


def _carried(xp: Any, device: ArrayDevice, sums: Any) -> Any:
    """Return ``(cells, m, n)`` of sums ``(cells, m + 1, n)``; the last of each cell goes to the first of the next."""
    nothing = xp.zeros((1, 1, sums.shape[2]), dtype=sums.dtype, device=device.place)
    first = sums[:, :1, :] + xp.concat([nothing, sums[:-1, -1:, :]], axis=0)
    return xp.concat([first, sums[:, 1:-1, :]], axis=1)


def _with_next(xp: Any, device: ArrayDevice, values: Any) -> Any:
    """Return values ``(cells, m, n)`` with the first of the next cell appended: the transpose of `_carried`."""
    nothing = xp.zeros((1, 1, values.shape[2]), dtype=values.dtype, device=device.place)
    return xp.concat([values, xp.concat([values[1:, :1, :], nothing], axis=0)], axis=1)
