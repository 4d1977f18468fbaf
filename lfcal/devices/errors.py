"""Errors of devices; the class determines whether an action is tried again."""

from __future__ import annotations

from lfcal.base import InputError, LfcalError, StorageError

__all__ = [
    "CameraError",
    "DeviceError",
    "DeviceLost",
    "DeviceMissing",
    "FrameTimeout",
    "IncompleteFrame",
    "LimitError",
    "NotInPosition",
    "StageError",
    "StaleFrame",
    "WrongFrame",
    "driver_errors",
]


class DeviceError(LfcalError):
    """A device failed to do what was requested."""


class DeviceMissing(DeviceError):
    """A backend or a device is missing; the message states what to install or switch on."""


class DeviceLost(DeviceError):
    """A device no longer answers; trying again does not help."""


class CameraError(DeviceError):
    """The camera failed to do what was requested; trying again may help."""


class FrameTimeout(CameraError):
    """No frame arrived in time."""


class IncompleteFrame(CameraError):
    """A frame arrived with missing parts."""


class StaleFrame(CameraError):
    """A frame is old: its exposure started before the source had arrived, or its number did not increase."""


class WrongFrame(CameraError):
    """The shape or sample type of a frame differs from that reported by the camera."""


class StageError(DeviceError):
    """The stage failed to do what was requested; trying again may help."""


class NotInPosition(StageError):
    """The read-back position deviates from the target by more than the tolerance."""


class LimitError(StageError, InputError):
    """A target position, or the approach to it, is outside the stage's limits; nothing was moved."""


class driver_errors:
    """Context manager that converts errors of a driver to a `DeviceError` whose message names the device.

    ``device`` is the name. Drivers raise errors of their libraries, such as RuntimeError, or an OSError of the USB bus.
    An OSError, or a StorageError of a device that works with files, would otherwise be mistaken for an error of the
    recording's disk. Other errors of lfcal, and Ctrl-C, are not converted.
    """

    # a class: entered about ten times per frame, where a generator would take as long as the frame's checks
    __slots__ = ("_device",)

    def __init__(self, device: str) -> None:
        self._device = device

    def __enter__(self) -> None:
        """Enter the context."""

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """Raise `DeviceError` instead of the driver's error or exit; lfcal's errors and Ctrl-C are not changed."""
        if isinstance(error, StorageError):
            raise DeviceError(f"{self._device}: {error}") from error
        if isinstance(error, Exception | SystemExit | GeneratorExit) and not isinstance(error, LfcalError):
            what = f"{type(error).__name__}: {error}"
            raise DeviceError(f"{self._device}: {what}; check its driver, cable and power") from error
