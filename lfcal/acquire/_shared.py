"""Names of `lfcal.acquire` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.acquire.frame_plan import frame_grid, frame_positions
from lfcal.acquire.lighting import check_light
from lfcal.acquire.live_coverage import SAMPLE
from lfcal.acquire.session import check_fixed, check_new
from lfcal.acquire.session_file import NAME, Devices, keep_task, optics_of

__all__ = [
    "NAME",
    "SAMPLE",
    "Devices",
    "check_fixed",
    "check_light",
    "check_new",
    "frame_grid",
    "frame_positions",
    "keep_task",
    "optics_of",
]
