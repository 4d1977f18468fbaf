"""Names of `lfcal.devices` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.devices.calling import Caller
from lfcal.devices.checked import CheckedCamera, CheckedLight, CheckedStage
from lfcal.devices.protocols import Gauge
from lfcal.devices.registry import BACKENDS
from lfcal.devices.rig import FileGauge

__all__ = [
    "BACKENDS",
    "Caller",
    "CheckedCamera",
    "CheckedLight",
    "CheckedStage",
    "FileGauge",
    "Gauge",
]
