"""Predict the cost of a session and whether it can run, before anything moves."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lfcal.acquire._motion import check_limits
from lfcal.acquire.frame_plan import FramePlan
from lfcal.acquire.lighting import check_light
from lfcal.acquire.options import Options
from lfcal.acquire.recording import Kind, recording_bytes
from lfcal.acquire.schedule import Schedule
from lfcal.acquire.session import check_devices, check_fixed
from lfcal.acquire.session_file import frame_dtype
from lfcal.base import require_space, storage_errors
from lfcal.camera import Forecast, ScanPlan, readout_hours
from lfcal.devices import Rig
from lfcal.frames import Position

__all__ = ["SessionForecast", "forecast"]

STAGE_UM_PER_S = 1000.0
"""Speed of the stage that `Forecast.of` assumes by default (µm/s)."""


@dataclass(frozen=True, slots=True)
class SessionForecast:
    """Predicted cost of a session.

    Attributes
    ----------
    positions, other_frames
        Number of frames at the plan's positions (for a target, number of the plan's frames), and total number of dark,
        reference and control frames.
    seconds
        Duration of exposures, settling, moves and, if known, readout (s). Retries, and detours to approach positions
        from one side, are not included.
    recording_bytes, free_bytes
        Size of the recording, and free disk space (bytes).
    camera, stage
        Names of the devices.
    readout_seconds
        Time for readout (s), included in `seconds`; None if the camera's frame rate is unknown.
    """

    positions: int
    other_frames: int
    seconds: float
    recording_bytes: int
    free_bytes: int
    camera: str
    stage: str
    readout_seconds: float | None = None


def forecast(
    plan: ScanPlan | FramePlan,
    rig: Rig,
    options: Options,
    folder: Path,
    *,
    only: Sequence[Position] = (),
    frames_per_s: float | None = None,
) -> SessionForecast:
    """Predict the cost of a session after checking devices, limits, light and disk space; nothing moves.

    Parameters
    ----------
    plan, rig, options, only
        As in `iter_record`.
    folder
        Folder of the session, whose disk must have enough free space.
    frames_per_s
        Highest frame rate of the camera for the region that is read (frames/s). None: unknown.

    Raises
    ------
    InputError, DeviceError, StorageError
        If the session could not start.

    Examples
    --------
    >>> from pathlib import Path
    >>> from dataclasses import replace
    >>> from lfcal.camera import ScanPlan, preset
    >>> plan = replace(ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0], cutout=21), period=(2, 3))
    >>> from lfcal.devices import simulated_rig
    >>> from lfcal.acquire import Options, SessionForecast, forecast
    >>> expected: SessionForecast = forecast(plan, simulated_rig(plan), Options(darks=4), Path("new"))
    >>> print(expected.positions, "positions and", expected.other_frames, "other frames")
    6 positions and 3 other frames
    """
    scan = plan.scan
    devices = check_devices(scan, rig)
    check_fixed(devices, options)
    if isinstance(plan, ScanPlan):
        schedule = Schedule.of(plan, options, only=only)
    else:
        schedule = Schedule.of_frames(plan, options)
    moved = schedule.targets[schedule.kinds != Kind.DARK]
    check_limits(moved, rig.stage.limits, options.motion(scan).overshoot_um)
    dark = schedule.kinds == Kind.DARK
    if dark.any():
        check_light(rig)
    positions = schedule.count(Kind.POSITION)
    size = recording_bytes(schedule, frame_dtype(scan, options, devices))
    require_space(folder, size + options.reserve(size), what="the recording and its reserve")
    place = folder.absolute()
    while not place.exists():
        place = place.parent
    with storage_errors(place):
        free = shutil.disk_usage(place).free
    reading = readout_hours(_exposures(scan, options, schedule), frames_per_s)
    return SessionForecast(
        positions,
        len(schedule) - positions,
        _seconds(scan, options, schedule, whole=scan is not plan) + 3600 * (reading or 0.0),
        size,
        free,
        devices.camera,
        devices.stage,
        None if reading is None else 3600 * reading,
    )


def _exposures(plan: ScanPlan, options: Options, schedule: Schedule) -> int:
    """Return the number of exposures that the camera makes."""
    darks = schedule.count(Kind.DARK)
    return len(options.bracket) * ((len(schedule) - darks) * plan.frames_averaged + darks * options.darks)


def _seconds(plan: ScanPlan, options: Options, schedule: Schedule, *, whole: bool) -> float:
    """Return the time for all frames (s); a reference or control frame is assumed to take as long as a position."""
    planned = schedule.kinds == Kind.POSITION
    if whole:
        planes, places = schedule.planes[planned], schedule.targets[planned]
        exposing = sum(plan.exposures[z] for z in planes.tolist()) * plan.frames_averaged
        way = float(np.abs(np.diff(places, axis=0)).max(axis=1).sum()) if len(places) > 1 else 0.0
        hours = (exposing * sum(options.bracket) + len(planes) * plan.settle_s + way / STAGE_UM_PER_S) / 3600
    else:
        index = np.stack(np.unravel_index(schedule.flat[planned], plan.shape[:3]), axis=1)
        cost = Forecast.of(plan, positions=plan.in_scan_order(index))
        hours = cost.exposure_hours * sum(options.bracket) + cost.settle_hours + cost.move_hours
    dark = schedule.kinds == Kind.DARK
    exposed = sum(plan.exposures[z] for z in schedule.planes[dark].tolist()) * sum(options.bracket) * options.darks
    lit = (len(schedule) - int(dark.sum())) / schedule.count(Kind.POSITION)
    return float(hours * 3600 * lit + exposed)
