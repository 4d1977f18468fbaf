"""Cameras, stages and lamps behind small protocols, found by name.

- ``protocols``: what a camera, a stage, a light and a clock must do; `Rig` holds them together
- ``errors``: what can go wrong with a device, by kind
- ``registry``: which backends there are, and why others are not
- ``backends``: real devices
- ``simulated``: a camera and a stage that need no hardware
"""

from lfcal.devices.errors import DeviceError, DeviceMissing
from lfcal.devices.protocols import CameraDevice, Frame, Light, Rig, Roi, Setting, StageDevice, SystemTime, TimeSource
from lfcal.devices.registry import Backend, Finding, find_backends, get_backend, open_rig
from lfcal.devices.simulated.backend import simulated_rig

__all__ = [
    "Backend",
    "CameraDevice",
    "DeviceError",
    "DeviceMissing",
    "Finding",
    "Frame",
    "Light",
    "Rig",
    "Roi",
    "Setting",
    "StageDevice",
    "SystemTime",
    "TimeSource",
    "find_backends",
    "get_backend",
    "open_rig",
    "simulated_rig",
]
