"""Names of `lfcal.devices.simulated` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.devices.simulated.backend import SimBackend, inject, simulated_rig
from lfcal.devices.simulated.faults import CAMERA_FAULTS, FAULTS, GAUGE_FAULTS, STAGE_FAULTS, DeviceFault, parse_faults

__all__ = [
    "CAMERA_FAULTS",
    "FAULTS",
    "GAUGE_FAULTS",
    "STAGE_FAULTS",
    "DeviceFault",
    "SimBackend",
    "inject",
    "parse_faults",
    "simulated_rig",
]
