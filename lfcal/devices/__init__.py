"""Cameras, stages and lamps behind small protocols, found by name.

- ``protocols``: what a camera, a stage, a light and a clock must do; `Rig` holds them together
- ``errors``: what can go wrong with a device, by kind
- ``registry``: which backends there are, and why others are not; ``options`` reads their options
- ``backends``: real devices
- ``simulated``: a camera and a stage that need no hardware
"""

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
from lfcal.devices.options import limits_option, number_option
from lfcal.devices.protocols import (
    CameraDevice,
    Frame,
    Light,
    Limits,
    Point,
    Rig,
    Roi,
    Setting,
    StageDevice,
    SystemTime,
    TimeSource,
)
from lfcal.devices.registry import Backend, Finding, find_backends, get_backend, open_rig
from lfcal.devices.simulated.backend import simulated_rig

__all__ = [
    "Backend",
    "CameraDevice",
    "CameraError",
    "DeviceError",
    "DeviceLost",
    "DeviceMissing",
    "Finding",
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
