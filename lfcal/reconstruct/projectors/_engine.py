"""Common interface of all projection methods, and their costs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol

from numpy.typing import NDArray

from lfcal.base import format_bytes

__all__ = ["Cost", "DeviceUse", "Engine"]


@dataclass(frozen=True, slots=True)
class Cost:
    """Predicted cost of one method.

    Attributes
    ----------
    method
        Name of the method.
    prepare_s, forward_s, adjoint_s
        Time to prepare all planes, to project the entire volume, and to back-project an image (s).
    operand_bytes
        Memory of all prepared planes (bytes).
    scratch_bytes
        Working memory of one projection, without its result (bytes).
    prepare_bytes
        Working memory while a plane of H is read and prepared, without the operand (bytes).
    resident
        Whether all prepared planes are stored; otherwise they are prepared again in every projection, and the times
        include this.
    """

    method: str
    prepare_s: float
    forward_s: float
    adjoint_s: float
    operand_bytes: int
    scratch_bytes: int
    prepare_bytes: int
    resident: bool = True

    @property
    def pair_s(self) -> float:
        """Time for one forward and one adjoint projection (s)."""
        return self.forward_s + self.adjoint_s

    @property
    def memory_bytes(self) -> int:
        """Peak memory without arrays of the caller (bytes)."""
        if self.resident:
            return self.operand_bytes + max(self.scratch_bytes, self.prepare_bytes)
        return self.scratch_bytes + self.prepare_bytes


@dataclass(frozen=True, slots=True)
class DeviceUse:
    """Device memory of a projection.

    Attributes
    ----------
    operand_bytes
        Prepared planes that are on the device at the same time (bytes).
    room
        Working memory for which steps are planned (bytes).
    free
        Free memory of the device before the projection (bytes).
    kept
        Whether all prepared planes stay on the device; otherwise they are moved in every projection, one at a time.
    """

    operand_bytes: int
    room: int
    free: int
    kept: bool

    @property
    def memory_bytes(self) -> int:
        """Peak memory on the device (bytes)."""
        return self.operand_bytes + self.room

    def __str__(self) -> str:
        """Return the memory as part of a line of text."""
        used, free = format_bytes(self.memory_bytes), format_bytes(self.free)
        return f"device {used} of {free}" + ("" if self.kept else ", planes transferred for each projection")


class Engine(Protocol):
    """Projection method: it prepares planes of H as operands and projects with them in both directions.

    Images are ``(Y, X)``, volume planes ``(Y, X)``; ``forward`` and ``adjoint`` are exact transposes of each other.
    """

    name: str
    any_phases: bool
    """Whether operands are independent of the image phases in use."""
    rounding: float
    """Error of projected values relative to the largest one; smaller values are only rounding."""

    def prepare(self, plane: NDArray[Any]) -> Any:
        """Return the operand of one plane of H, ``(ny, nx, nt, ns)``."""
        ...

    def operand_bytes(self, operand: Any) -> int:
        """Return the memory of an operand (bytes)."""
        ...

    def forward(self, planes: Iterable[tuple[Any, NDArray[Any]]]) -> NDArray[Any]:
        """Return the image of a volume, given as pairs (operand, volume plane)."""
        ...

    def adjoint(self, image: NDArray[Any], operands: Iterable[Any]) -> Iterator[NDArray[Any]]:
        """Yield the back projection of ``image`` for each operand."""
        ...
