"""What every way to project has in common."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol

from numpy.typing import NDArray

from lfcal.base import format_bytes

__all__ = ["Cost", "DeviceUse", "Engine"]


@dataclass(frozen=True, slots=True)
class Cost:
    """Forecast of one method.

    Attributes
    ----------
    method
        Its name.
    prepare_s, forward_s, adjoint_s
        Seconds for preparing all planes, for one forward, and for one adjoint projection of the whole volume.
    operand_bytes
        Memory of all prepared planes.
    scratch_bytes
        Working memory of one projection, without its result.
    prepare_bytes
        Working memory while a plane of H is read and prepared, without the operand.
    resident
        Whether all prepared planes are kept; otherwise they are prepared again in every projection, which the seconds
        include.
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
        """Seconds of one forward and one adjoint projection."""
        return self.forward_s + self.adjoint_s

    @property
    def memory_bytes(self) -> int:
        """Most bytes in use, arrays of the caller's aside."""
        if self.resident:
            return self.operand_bytes + max(self.scratch_bytes, self.prepare_bytes)
        return self.scratch_bytes + self.prepare_bytes


@dataclass(frozen=True, slots=True)
class DeviceUse:
    """Device memory of a projection.

    Attributes
    ----------
    operand_bytes
        Prepared planes that are there together.
    room
        Working memory, for which steps are planned.
    free
        Free memory there before (bytes).
    kept
        Whether all prepared planes stay there; otherwise they are moved there in every projection, one at a time.
    """

    operand_bytes: int
    room: int
    free: int
    kept: bool

    @property
    def memory_bytes(self) -> int:
        """Most bytes in use there."""
        return self.operand_bytes + self.room

    def __str__(self) -> str:
        """Return it as part of a line."""
        used, free = format_bytes(self.memory_bytes), format_bytes(self.free)
        return f"device {used} of {free}" + ("" if self.kept else ", planes moved each time")


class Engine(Protocol):
    """One way to project: H plane in, prepared operand out, and the pair that uses operands.

    Images are ``(Y, X)``, volume planes ``(Y, X)``; ``forward`` and ``adjoint`` are exact transposes of each other.
    """

    name: str
    any_phases: bool
    """Whether operands are the same whatever image phases are in use."""
    rounding: float
    """Error of a projected value relative to the largest one; values below are rounding."""

    def prepare(self, plane: NDArray[Any]) -> Any:
        """Return the operand of one plane of H, ``(ny, nx, nt, ns)``."""
        ...

    def operand_bytes(self, operand: Any) -> int:
        """Return the memory an operand keeps."""
        ...

    def forward(self, planes: Iterable[tuple[Any, NDArray[Any]]]) -> NDArray[Any]:
        """Return the image of pairs (operand, volume plane)."""
        ...

    def adjoint(self, image: NDArray[Any], operands: Iterable[Any]) -> Iterator[NDArray[Any]]:
        """Yield the back projection of ``image`` for each operand."""
        ...
