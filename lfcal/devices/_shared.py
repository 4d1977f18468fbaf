"""What other packages of lfcal use of `lfcal.devices`, and nobody else: it may change."""

from __future__ import annotations

from lfcal.devices.calling import Caller
from lfcal.devices.checked import CheckedCamera, CheckedLight, CheckedStage
from lfcal.devices.gauges import FileGauge
from lfcal.devices.protocols import Gauge
from lfcal.devices.registry import BACKENDS

__all__ = [
    "BACKENDS",
    "Caller",
    "CheckedCamera",
    "CheckedLight",
    "CheckedStage",
    "FileGauge",
    "Gauge",
]
