"""Common part of projection on a device: planes are prepared on the processor, moved, and kept if possible."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.reconstruct.projectors.device import ArrayDevice
from lfcal.reconstruct.projectors.grid import Grid

__all__ = ["DeviceEngine", "DeviceOperand", "Placement"]


@dataclass(frozen=True, slots=True)
class Placement:
    """Location of the arrays of an engine.

    Attributes
    ----------
    device
        Device of the arrays.
    kept
        Whether prepared planes stay on the device; otherwise they stay in host memory and are moved in every
        projection.
    room
        Working memory for which an engine plans its steps (bytes).
    """

    device: ArrayDevice
    kept: bool = True
    room: int = 1 << 28


@dataclass(frozen=True, slots=True)
class DeviceOperand:
    """One prepared plane: ``arrays`` on the device if ``there``, else on the processor, with facts about them."""

    arrays: tuple[Any, ...]
    nbytes: int
    there: bool
    facts: Any = None


class DeviceEngine(ABC):
    """Project on a device: see `lfcal.reconstruct.projectors._engine.Engine`.

    Volume planes and images are moved to the device for each projection, and results are moved back.
    """

    name: str
    any_phases: bool
    rounding: float

    def __init__(self, grid: Grid, dtype: np.dtype[Any], placement: Placement) -> None:
        self.grid, self.dtype, self.placement = grid, dtype, placement
        self.device = placement.device

    # -- the parts that engines differ in -----------------------------------------------------------------
    @abstractmethod
    def prepared(self, plane: NDArray[Any]) -> tuple[tuple[NDArray[Any], ...], Any]:
        """Return the arrays of one plane of H on the processor, with facts about them."""

    @abstractmethod
    def add(self, total: Any, operand: DeviceOperand, plane: Any) -> Any:
        """Add the contribution of a volume plane on the device to ``total`` (None at first), and return it."""

    @abstractmethod
    def image(self, total: Any) -> Any:
        """Return the image ``(Y, X)`` of a total."""

    @abstractmethod
    def seen(self, image: Any) -> Any:
        """Prepare an image on the device for the back projection on all planes."""

    @abstractmethod
    def back(self, seen: Any, operand: DeviceOperand) -> Any:
        """Return the back projection ``(Y, X)`` on one plane."""

    # -- the pair --------------------------------------------------------------------------------------
    def prepare(self, plane: NDArray[Any]) -> DeviceOperand:
        """Return the operand of one plane of H, ``(ny, nx, nt, ns)``, on the device if it is kept there."""
        arrays, facts = self.prepared(plane)
        operand = DeviceOperand(arrays, sum(array.nbytes for array in arrays), False, facts)
        # the number of entries is predicted from a few positions; if it is larger, the last planes stay on the host
        fits = self.device.free_bytes() - operand.nbytes > self.placement.room
        return self._there(operand) if self.placement.kept and fits else operand

    def operand_bytes(self, operand: DeviceOperand) -> int:
        """Return the size of an operand's arrays (bytes)."""
        return operand.nbytes

    def forward(self, planes: Iterable[tuple[DeviceOperand, NDArray[Any]]]) -> NDArray[Any]:
        """Return the image of a volume, given as pairs (operand, volume plane)."""
        total: Any = None
        with self.device.active():
            for operand, plane in planes:
                total = self.add(total, self._there(operand), self.device.moved(plane))
            if total is None:  # all planes are zero
                return np.zeros(self.grid.image_shape, self.dtype)
            return self.device.fetched(self.image(total))

    def adjoint(self, image: NDArray[Any], operands: Iterable[DeviceOperand]) -> Iterator[NDArray[Any]]:
        """Yield the back projection of ``image`` for each operand; each is valid until the next is requested."""
        with self.device.active():
            seen = self.seen(self.device.moved(image))
            # allocating an array for each plane takes several times as long as the transfer
            plane = self.device.buffer(self.grid.image_shape, self.dtype)
        for operand in operands:
            with self.device.active():
                self.device.fetched(self.back(seen, self._there(operand)), out=plane)
            yield plane

    # -- steps -----------------------------------------------------------------------------------------
    def _there(self, operand: DeviceOperand) -> DeviceOperand:
        if operand.there:
            return operand
        with self.device.active():
            arrays = tuple(self.device.moved(array) for array in operand.arrays)
        return DeviceOperand(arrays, operand.nbytes, True, operand.facts)

    def packed(self, plane: Any, before: tuple[int, int] = (0, 0), after: tuple[int, int] = (0, 0)) -> Any:
        """Return ``plane`` padded with zeros to whole cells of the lattice: `Grid.pack` on the device."""
        grid = self.grid
        (ny, nx), (cy, cx), (oy, ox) = grid.period, grid.cells, grid.origin
        out = self.device.zeros((before[0] + cy * ny + after[0], before[1] + cx * nx + after[1]), self.dtype)
        top, left = before[0] + oy, before[1] + ox
        out[top : top + grid.image_shape[0], left : left + grid.image_shape[1]] = plane
        return out

    def mask(self, phases: NDArray[np.bool_] | None) -> Any:
        """Return an image that is 1 at the selected phases and 0 elsewhere; None if all are selected."""
        return None if phases is None else self.device.moved(self.grid.tiled(phases).astype(self.dtype))
