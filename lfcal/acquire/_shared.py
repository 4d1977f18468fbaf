"""Names of `lfcal.acquire` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.acquire.earlier import EarlierFrames, EarlierRuns, PlaneSum
from lfcal.acquire.frame_plan import frame_grid, frame_positions
from lfcal.acquire.lighting import check_light
from lfcal.acquire.session import check_fixed, check_new
from lfcal.acquire.session_file import NAME, Devices, keep_task, optics_of
from lfcal.acquire.stills import iter_stills, recipe_of, still_files

__all__ = [
    "NAME",
    "Devices",
    "EarlierFrames",
    "EarlierRuns",
    "PlaneSum",
    "check_fixed",
    "check_light",
    "check_new",
    "frame_grid",
    "frame_positions",
    "iter_stills",
    "keep_task",
    "optics_of",
    "recipe_of",
    "still_files",
]
