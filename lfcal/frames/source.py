"""The protocol at which real, recorded, imported and simulated frames meet."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from lfcal.axes import Position
from lfcal.errors import InputError
from lfcal.frames.regions import Region

__all__ = ["FrameInfo", "FrameSource", "Frames", "Noise", "Position", "Samples", "check_index", "observed"]


@dataclass(frozen=True, slots=True)
class FrameInfo:
    """What is known of one frame without reading it. None means not measured.

    Attributes
    ----------
    points
        Scan positions of the point sources that the frame shows: one for a single point.
    origin
        Sensor (row, column) of the frame's first pixel: (0, 0) for whole sensor frames.
    exposure_s
        Exposure (s).
    drift
        How far the paraxial image lies from where the plan puts it, (rows, columns) in pixels.
    saturated
        Saturated pixels of the frame, where they were counted when it was recorded.
    label
        A short name for messages, such as the file's.
    """

    points: tuple[Position, ...]
    origin: tuple[int, int] = (0, 0)
    exposure_s: float | None = None
    drift: tuple[float, float] | None = None
    saturated: int | None = None
    label: str = ""

    @property
    def position(self) -> Position:
        """The scan position of a frame of one point; raises `InputError` for frames of several."""
        if len(self.points) != 1:
            raise InputError.expected(
                self.label or "frame", "one point source", len(self.points), "use what handles frames of many points"
            )
        return self.points[0]


class Noise(NamedTuple):
    """The variance of a sample of value v, ``constant + slope * max(v, 0)``, in squared sample values.

    A sensor of g electrons per count with r electrons of read noise has ``constant = (r / g)^2 + 1/12``
    (quantisation) and ``slope = 1 / g`` (photon noise).
    """

    constant: float
    slope: float

    def scaled(self, factor: float) -> Noise:
        """Return the noise of samples that were multiplied by ``factor``."""
        return Noise(self.constant * factor * factor, self.slope * abs(factor))


class Samples(NamedTuple):
    """A part of a frame as it was read.

    ``values`` ``(rows, columns)``; ``valid`` of the same shape is False where a sample carries no measurement
    (saturated, masked), None where all do; ``noise`` where it is known; ``saturated`` pixels in this part, None where
    their number is unknown.
    """

    values: NDArray[Any]
    valid: NDArray[np.bool_] | None = None
    noise: Noise | None = None
    saturated: int | None = None


@runtime_checkable
class FrameSource(Protocol):
    """A set of equally shaped 2-D frames. Subclass `Frames` to make one.

    Frames come in any order; a position may be missing or given more than once. Reading is safe from several
    threads. ``metadata`` holds what is known of all frames: ``bit_depth``, ``saturation`` (sample value),
    ``black_level``, ``cfa``, ``gains``, ``noise`` (`Noise` of raw samples), ``darks`` (recorded with the frames),
    ``plan_shape``, ``plan``, ``path`` …; an entry that is not there is not known.
    """

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of every frame."""
        ...

    @property
    def dtype(self) -> np.dtype[Any]:
        """Sample type of every frame."""
        ...

    @property
    def metadata(self) -> Mapping[str, Any]:
        """What is known of all frames."""
        ...

    def __len__(self) -> int:
        """Return the number of frames."""
        ...

    def info(self, index: int) -> FrameInfo:
        """Return what is known of frame ``index``."""
        ...

    def read(self, index: int, region: Region | None = None) -> NDArray[Any]:
        """Return frame ``index``, or the rows and columns ``region`` of it, as a new array of `dtype`."""
        ...

    def samples(self, index: int, region: Region | None = None) -> Samples:
        """Return what `read` returns together with what is known of those samples."""
        ...


class Frames(ABC):
    """The common part of frame sources; see `FrameSource`."""

    @property
    @abstractmethod
    def shape(self) -> tuple[int, int]:
        """Rows and columns of every frame."""

    @property
    @abstractmethod
    def dtype(self) -> np.dtype[Any]:
        """Sample type of every frame."""

    @property
    def metadata(self) -> Mapping[str, Any]:
        """What is known of all frames."""
        return MappingProxyType({})

    @abstractmethod
    def __len__(self) -> int:
        """Return the number of frames."""

    @abstractmethod
    def info(self, index: int) -> FrameInfo:
        """Return what is known of frame ``index``."""

    @abstractmethod
    def read(self, index: int, region: Region | None = None) -> NDArray[Any]:
        """Return frame ``index``, or the rows and columns ``region`` of it, as a new array of `dtype`."""

    def samples(self, index: int, region: Region | None = None) -> Samples:
        """Return what `read` returns, with saturated samples marked by the level the source knows."""
        facts = self.metadata
        return observed(self.read(index, region), facts.get("saturation"), facts.get("noise"))

    def close(self) -> None:  # noqa: B027  most sources keep nothing open
        """Release what the source keeps open."""

    def __enter__(self) -> Self:
        """Return the source."""
        return self

    def __exit__(self, *_: object) -> None:
        """Release what the source keeps open."""
        self.close()


def observed(values: NDArray[Any], saturation: float | None, noise: Noise | None = None) -> Samples:
    """Return raw ``values`` with those at ``saturation`` (sample value) or above marked as not valid.

    Without a level only the end of an integer type is beyond doubt: samples there are saturated; where none lies
    there, their number is unknown, because the sensor may end below its sample type.
    """
    # floats have no natural end: without a level none can be called saturated
    if saturation is None and values.dtype.kind == "f":
        return Samples(values, noise=noise)
    level = saturation
    if values.dtype.kind in "iu":
        top = int(np.iinfo(values.dtype).max)
        # whole samples reach a fractional level only at the next whole number
        level = top if level is None else math.ceil(level)
        # a level beyond the type cannot be reached
        if level > top:
            return Samples(values, noise=noise, saturated=0)
    full = values >= level
    count = int(np.count_nonzero(full))
    if count == 0:
        # 8-bit cameras use all of their range; 16-bit files often hold 10, 12 or 14 bits
        known = saturation is not None or values.dtype == np.uint8
        return Samples(values, noise=noise, saturated=0 if known else None)
    return Samples(values, ~full, noise, count)


def check_index(index: int, count: int) -> int:
    """Return ``index`` or raise `InputError` unless it is one of ``count`` frames."""
    if not 0 <= index < count:
        raise InputError.expected("frame index", f"0 … {count - 1}", index, "ask for a frame that is there")
    return int(index)
