"""The public names of `lfcal.devices`: each is loaded on first use."""

from __future__ import annotations

from lfcal.devices.errors import (
    CameraError,
    DeviceError,
    DeviceLost,
    DeviceMissing,
    FrameTimeout,
    IncompleteFrame,
    LimitError,
    NotInPosition,
    StageError,
    StaleFrame,
    WrongFrame,
)
from lfcal.devices.protocols import (
    CameraDevice,
    Frame,
    Light,
    Limits,
    Point,
    Roi,
    Setting,
    StageDevice,
    SystemTime,
    TimeSource,
)
from lfcal.devices.registry import (
    Backend,
    BackendStatus,
    find_backends,
    get_backend,
    limits_option,
    number_option,
    open_rig,
)
from lfcal.devices.rig import Rig
from lfcal.devices.simulated import simulated_rig

__all__ = [
    "Backend",
    "BackendStatus",
    "CameraDevice",
    "CameraError",
    "DeviceError",
    "DeviceLost",
    "DeviceMissing",
    "Frame",
    "FrameTimeout",
    "IncompleteFrame",
    "Light",
    "LimitError",
    "Limits",
    "NotInPosition",
    "Point",
    "Rig",
    "Roi",
    "Setting",
    "StageDevice",
    "StageError",
    "StaleFrame",
    "SystemTime",
    "TimeSource",
    "WrongFrame",
    "find_backends",
    "get_backend",
    "limits_option",
    "number_option",
    "open_rig",
    "simulated_rig",
]
