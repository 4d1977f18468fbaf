"""What a session will cost and whether it can run, before anything moves."""

from __future__ import annotations

import math
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lfcal.acquire.lighting import check_light
from lfcal.acquire.motion import check_limits, limits_of
from lfcal.acquire.options import Options
from lfcal.acquire.recording.records import RECORD, Kind
from lfcal.acquire.schedule import Schedule
from lfcal.acquire.session import check_devices
from lfcal.acquire.session_file import frame_dtype
from lfcal.camera import Forecast, ScanPlan
from lfcal.devices.protocols import Rig
from lfcal.files import require_space, storage_errors
from lfcal.frames.source import Position

__all__ = ["SessionForecast", "forecast"]


@dataclass(frozen=True, slots=True)
class SessionForecast:
    """Cost of a session.

    Attributes
    ----------
    positions, other_frames
        Frames of the plan's positions, and dark, reference and control frames.
    seconds
        Exposures, settling and movement; retries and the approach from one side come on top (s).
    recording_bytes, free_bytes
        Size of the recording, and what the disk has.
    camera, stage
        The devices.
    """

    positions: int
    other_frames: int
    seconds: float
    recording_bytes: int
    free_bytes: int
    camera: str
    stage: str


def forecast(
    plan: ScanPlan, rig: Rig, options: Options, folder: Path, *, only: Sequence[Position] = ()
) -> SessionForecast:
    """Return what the session will cost, after checking devices, limits, light and disk; nothing moves.

    With ``only`` positions no others are recorded.

    Raises
    ------
    InputError, DeviceError, StorageError
        What would stop the session at its start.
    """
    devices = check_devices(plan, rig)
    schedule = Schedule.of(plan, options, only=only)
    moved = schedule.targets[schedule.kinds != Kind.DARK]
    check_limits(moved, limits_of(rig.stage), options.motion(plan).overshoot_um)
    dark = schedule.kinds == Kind.DARK
    if dark.any():
        check_light(rig)
    positions = schedule.count(Kind.POSITION)
    size = _recording_bytes(schedule, frame_dtype(plan, options, devices).itemsize)
    # the recording is reserved at once, and the session holds below its reserve
    require_space(folder, size + options.keep_free_bytes, what="the recording and its reserve")
    place = folder.absolute()
    while not place.exists():
        place = place.parent
    with storage_errors(place):
        free = shutil.disk_usage(place).free
    return SessionForecast(
        positions,
        len(schedule) - positions,
        _seconds(plan, options, schedule),
        size,
        free,
        devices.camera,
        devices.stage,
    )


def _recording_bytes(schedule: Schedule, sample_bytes: int) -> int:
    darks = schedule.count(Kind.DARK)
    lit = (len(schedule) - darks) * math.prod(schedule.window) * sample_bytes
    return lit + darks * math.prod(schedule.roi.shape) * 4 + len(schedule) * RECORD.itemsize


def _seconds(plan: ScanPlan, options: Options, schedule: Schedule) -> float:
    """Return the time of all frames; a reference or control frame takes that of a position."""
    planned = schedule.flat[schedule.kinds == Kind.POSITION]
    index = np.stack(np.unravel_index(planned, plan.shape[:3]), axis=1)
    cost = Forecast.of(plan, positions=plan.in_scan_order(index))
    hours = cost.exposure_hours * sum(options.bracket) + cost.settle_hours + cost.move_hours
    dark = schedule.kinds == Kind.DARK
    exposed = sum(plan.exposures[z] for z in schedule.planes[dark].tolist()) * sum(options.bracket) * options.darks
    lit = (len(schedule) - int(dark.sum())) / schedule.count(Kind.POSITION)
    return float(hours * 3600 * lit + exposed)
