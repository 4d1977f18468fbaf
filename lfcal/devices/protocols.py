"""Protocols that cameras, stages, lights, gauges and clocks must implement.

Lengths are in µm, times in s. Stage coordinates are ``(x, y, z)``, image coordinates ``(row, column)``. A call that
fails raises one of `lfcal.devices.errors`, whose class states whether to try again. Any other exception ends the
session in an orderly way, and is reported as an error of the device.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable

from numpy.typing import NDArray

__all__ = [
    "CameraDevice",
    "Frame",
    "Gauge",
    "Light",
    "Limits",
    "MovedElsewhere",
    "Point",
    "Rendered",
    "Roi",
    "Setting",
    "StageDevice",
    "SystemTime",
    "TimeSource",
    "Waiting",
]

T = TypeVar("T")

Point = tuple[float, float, float]
"""Stage coordinates (x, y, z) in µm."""

Limits = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
"""Lowest and highest stage coordinate of x, y, z in µm."""


@dataclass(frozen=True, slots=True)
class Roi:
    """Rectangle of the sensor: its first row and column, and its number of rows and columns (px).

    Examples
    --------
    >>> from lfcal.devices import Roi
    >>> region = Roi(row=100, column=80, rows=64, columns=48)  # of the sensor
    >>> print(region.rows * region.columns, "pixels")
    3072 pixels
    """

    row: int
    column: int
    rows: int
    columns: int

    @property
    def shape(self) -> tuple[int, int]:
        """Shape ``(rows, columns)`` (px)."""
        return self.rows, self.columns

    def within(self, other: Roi) -> tuple[slice, slice]:
        """Return the slices (rows, columns) that select this rectangle in a frame of ``other``, which contains it."""
        top, left = self.row - other.row, self.column - other.column
        return slice(top, top + self.rows), slice(left, left + self.columns)

    def holds(self, other: Roi) -> bool:
        """Return whether this rectangle contains ``other``."""
        return (
            self.row <= other.row
            and self.column <= other.column
            and self.row + self.rows >= other.row + other.rows
            and self.column + self.columns >= other.column + other.columns
        )


@dataclass(frozen=True, slots=True)
class Setting(Generic[T]):
    """Requested value of a setting, and the actual value reported by the device.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.devices import Setting, simulated_rig
    >>> plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0], cutout=21)
    >>> with simulated_rig(plan) as rig:
    ...     exposure: Setting[float] = rig.camera.set_exposure(0.0123)
    >>> print(f"asked for {1e3 * exposure.requested:.1f} ms, the camera takes {1e3 * exposure.actual:.1f} ms")
    asked for 12.3 ms, the camera takes 12.3 ms
    """

    requested: T
    actual: T


@dataclass(frozen=True, slots=True)
class Frame:
    """Frame of the region of interest.

    Attributes
    ----------
    data
        Samples ``(rows, columns)`` of the region of interest, in a buffer to which the device no longer writes.
    number
        Sequence number of the exposure, from the device or the backend; it increases with every exposure.
    exposure_s
        Exposure time reported by the device (s).
    started_s
        Earliest possible start of the exposure on the rig's clock (s); None if only `number` shows that the frame is
        new.
    status
        ``"complete"``, or a description of what is wrong with the frame.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.devices import Frame, Roi, simulated_rig
    >>> plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0], cutout=21)
    >>> with simulated_rig(plan) as rig:
    ...     _ = rig.camera.set_roi(Roi(row=100, column=80, rows=64, columns=48))
    ...     frame: Frame = rig.camera.grab(1.0)
    >>> print(frame.data.shape, frame.status)
    (64, 48) complete
    """

    data: NDArray[Any]
    number: int
    exposure_s: float
    started_s: float | None = None
    status: str = "complete"


@runtime_checkable
class CameraDevice(Protocol):
    """Protocol for a camera that exposes on request.

    A camera that can change pixel values automatically (exposure, gain, black level, gamma) has an additional method,
    ``fixed_settings()``. It returns a mapping from the name of each such setting to a `Setting` of two texts. The first
    is the value at which samples are proportional to light, such as ``"Off"``; the second is the value read back. The
    first is None for a setting that is only recorded, such as the gain. The driver switches automatic functions off
    when it opens the camera.
    """

    @property
    def name(self) -> str:
        """Manufacturer, model and serial number; the name must be the same after a restart."""
        ...

    @property
    def sensor_shape(self) -> tuple[int, int]:
        """Shape ``(rows, columns)`` of the whole sensor (px)."""
        ...

    @property
    def bit_depth(self) -> int:
        """Number of bits per sample; samples are uint8 or uint16, and at most `max_value`."""
        ...

    @property
    def max_value(self) -> int:
        """Sample value of a saturated pixel, such as 4095 for 12 bits, even if the sample type has more bits."""
        ...

    def set_exposure(self, seconds: float) -> Setting[float]:
        """Set the exposure time to ``seconds``; return the requested and the actual value (s)."""
        ...

    def set_roi(self, roi: Roi) -> Setting[Roi]:
        """Set the region of interest to ``roi``; return the requested and the actual region, which may be larger."""
        ...

    def grab(self, timeout_s: float) -> Frame:
        """Return a frame whose exposure started after this call: either trigger it, or discard older frames and wait.

        Raises
        ------
        FrameTimeout
            If no frame arrives within ``timeout_s`` (s).
        DeviceLost
            If the camera no longer answers.
        """
        ...

    def close(self) -> None:
        """Release the camera; may be called twice."""
        ...


@runtime_checkable
class StageDevice(Protocol):
    """Protocol for a stage that moves the point source along x, y and z."""

    @property
    def name(self) -> str:
        """Manufacturer, model and serial number."""
        ...

    @property
    def limits(self) -> Limits:
        """Lowest and highest position of each axis (x, y, z) (µm), ``((low, high), ...)``; infinite if unknown."""
        ...

    def move(self, target: Point) -> None:
        """Start a move to ``target`` (x, y, z; stage coordinates, µm), and return without waiting for its end."""
        ...

    def moving(self) -> bool:
        """Return whether any axis is moving."""
        ...

    def position(self) -> Point:
        """Return the position (x, y, z) read back from the device (µm)."""
        ...

    def stop(self) -> None:
        """Stop all axes immediately."""
        ...

    def home(self) -> None:
        """Start a move to the reference switches, and return without waiting for its end."""
        ...

    def close(self) -> None:
        """Release the stage; may be called twice."""
        ...


@runtime_checkable
class Light(Protocol):
    """Protocol for the lamp of the point source, or for a shutter in front of it."""

    def switch(self, on: bool) -> None:
        """Switch the light on or off, and wait until it is switched."""
        ...


@runtime_checkable
class Gauge(Protocol):
    """Protocol for a sensor of the conditions in the lab, such as a thermometer or a photodiode at the lamp."""

    @property
    def name(self) -> str:
        """Name of the quantity, such as ``"temperature"``."""
        ...

    @property
    def unit(self) -> str:
        """Unit of the readings; empty if unknown."""
        ...

    def read(self) -> float:
        """Return the current reading, in `unit`."""
        ...


@runtime_checkable
class Rendered(Protocol):
    """Protocol for a simulated camera, or for its renderer, that states how frames are computed."""

    @property
    def optics(self) -> str:
        """Method by which frames are computed, such as ``"pattern"`` or a level of `lfcal.simulate`."""
        ...


@runtime_checkable
class MovedElsewhere(Protocol):
    """Protocol for a stage that states whether something other than lfcal moves it."""

    @property
    def moved_elsewhere(self) -> bool:
        """Whether a person or another program moves the stage; sessions then omit the check of its axes and scale."""
        ...


@runtime_checkable
class Waiting(Protocol):
    """Protocol for a device that states whether its driver waits in real time; other devices are assumed to wait."""

    @property
    def waits(self) -> bool:
        """Whether calls take real time; if False, they are made directly, without a thread or a time limit."""
        ...


class TimeSource(Protocol):
    """Protocol for the clock of a rig, which may be a virtual clock that advances by each pause without waiting."""

    def monotonic(self) -> float:
        """Return the time since an arbitrary start (s); it never decreases."""
        ...

    def sleep(self, seconds: float) -> None:
        """Wait for ``seconds``."""
        ...

    def wall(self) -> float:
        """Return the time since 1970-01-01 UTC (s); unlike `monotonic`, it may jump when the clock is set."""
        ...


class SystemTime:
    """The computer's clock, used with real devices.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.devices import SystemTime, simulated_rig
    >>> plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0], cutout=21)
    >>> with simulated_rig(plan, time=SystemTime()) as rig:  # with real waiting times; by default they take no time
    ...     print(type(rig.time).__name__)
    SystemTime
    """

    def monotonic(self) -> float:
        """Return the time of `time.monotonic` (s)."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Wait for ``seconds`` with `time.sleep`; a negative value does not wait."""
        time.sleep(max(0.0, seconds))

    def wall(self) -> float:
        """Return the time since 1970-01-01 UTC (s), from `time.time`."""
        return time.time()
