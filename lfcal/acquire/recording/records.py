"""Record of each frame: its kind, position and measurements, and checksums of frame and record."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, fields
from enum import IntEnum, IntFlag
from operator import attrgetter
from typing import Annotated, Any, get_type_hints

import numpy as np
from numpy.typing import NDArray

from lfcal.devices import Point

__all__ = ["FILES", "RECORD", "Kind", "Note", "Suspicion", "file_name", "frame_crc", "intact", "pack", "suspicions"]


class Kind(IntEnum):
    """Kind of a frame; the numbers are stored in the record."""

    POSITION = 0
    DARK = 1
    REFERENCE = 2
    CONTROL = 3


class Suspicion(IntFlag):
    """Flags for possible faults in the content of a stored frame."""

    NONE = 0
    BLANK = 1  # no light where some is expected
    LIGHT = 2  # more or less light than at the positions around
    DISPLACED = 4  # the image is not at its expected position
    DARK_LEVEL = 8  # the sensor's dark level changed
    CLIPPED = 16  # saturated although its neighbours are far from saturation
    REPEATED = 32  # the content is that of another frame
    TORN = 64  # part of the content is that of an earlier frame
    EXPOSURE = 128  # the exposure differs from the requested one

    @property
    def words(self) -> str:
        """Names of the suspected faults, separated by commas."""
        return ", ".join(str(flag.name).lower().replace("_", " ") for flag in Suspicion if flag and flag in self)


FILES = {Kind.POSITION: "recording", Kind.REFERENCE: "checks", Kind.CONTROL: "checks", Kind.DARK: "darks"}
"""File in which each kind of frame is stored."""


def file_name(kind: Kind, run: int) -> str:
    """Return the name of the file that contains frames of ``kind`` in recording number ``run`` (from 0)."""
    return f"{FILES[kind]}.h5" if run == 0 else f"{FILES[kind]}-{run + 1:03d}.h5"


@dataclass(frozen=True, slots=True, kw_only=True)
class Note:
    """Record of a frame; the fields, their order and their stored types define the layout in the file.

    ``index`` is the flat position in the plan, ``(z * ny + y) * nx + x``, from which a control frame is displaced by
    ``period_y`` and ``period_x`` whole periods. ``kind`` is the kind of the frame. ``target_um`` and ``stage_um`` are
    the target and the read-back stage coordinates (x, y, z) in µm. ``exposure_s`` is the exposure time (s), ``time_s``
    the time since 1970-01-01 UTC (s), and ``elapsed_s`` the time since the start of the recording, without pauses and
    interruptions (s). ``energy`` is the sum and ``peak`` the highest of all samples (counts). ``row`` and ``column``
    are the sensor coordinates of the frame's first pixel. ``saturated`` and ``sensor_saturated`` are the numbers of
    saturated pixels in the frame, and in the whole region read from the sensor. ``attempts`` is the number of attempts
    to take the frame, and ``suspicion`` contains the suspected faults. ``sequence`` and ``frame_crc`` are filled in
    when the frame is written.

    Examples
    --------
    >>> from pathlib import Path
    >>> from dataclasses import replace
    >>> from lfcal.camera import ScanPlan, preset
    >>> plan = replace(ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0], cutout=21), period=(2, 3))
    >>> from lfcal.devices import simulated_rig
    >>> from lfcal.acquire import Note, ScheduledFrame, record
    >>> def watch(step: ScheduledFrame, note: Note, frame):
    ...     if note.index == 5:
    ...         print(f"position 5: exposed {1e3 * note.exposure_s:.0f} ms, {note.saturated} saturated pixels")
    >>> _ = record(Path("new"), plan, simulated_rig(plan), observers=(watch,))
    position 5: exposed 20 ms, 0 saturated pixels
    """

    index: Annotated[int, "<u4"]  # position in the scan plan, (z * ny + y) * nx + x
    sequence: Annotated[int, "<u4"] = 0  # the session's count of acknowledged frames
    frame_crc: Annotated[int, "<u4"] = 0
    attempts: Annotated[int, "<u2"] = 1  # in the record, `suspicion` is their high byte
    kind: Annotated[Kind, "<u2"]
    row: Annotated[int, "<i4"]  # sensor coordinates of the frame's first pixel
    column: Annotated[int, "<i4"]
    period_y: Annotated[int, "<i2"] = 0  # control frames: whole periods away from the plan's position
    period_x: Annotated[int, "<i2"] = 0
    saturated: Annotated[int, "<u4"] = 0  # saturated pixels in this frame
    sensor_saturated: Annotated[int, "<u4"] = 0  # saturated pixels in all that was read from the sensor
    target_um: Annotated[Point, "3<f8"]
    stage_um: Annotated[Point, "3<f8"]  # read back after the exposure
    exposure_s: Annotated[float, "<f8"]
    time_s: Annotated[float, "<f8"]  # seconds since 1970
    elapsed_s: Annotated[float, "<f8"]  # seconds of recording, without pauses and interruptions
    energy: Annotated[float, "<f8"]  # sum of the frame's samples
    peak: Annotated[float, "<f4"]
    suspicion: Suspicion = (
        Suspicion.NONE
    )  # has no separate field, so that recordings of all versions have the same form


STORED = tuple(field.name for field in fields(Note) if field.name != "suspicion")


def _layout() -> list[tuple[str, str]]:
    types = get_type_hints(Note, include_extras=True)
    return [(name, types[name].__metadata__[0]) for name in STORED]


RECORD = np.dtype([*_layout(), ("record_crc", "<u4"), ("valid", "<u4")])
"""One record: the fields of `Note`, their CRC-32 and a mark of validity; 128 bytes, little-endian."""

_values = attrgetter(*STORED)  # of a note, in the record's order
_BODY = RECORD.itemsize - 8  # a record's CRC-32 covers everything before itself
_MARK = 0x1FCA1
ATTEMPTS = 0xFF
"""Highest number of attempts that a record can store."""


def frame_crc(frame: bytes | memoryview) -> int:
    """Return the CRC-32 of a frame's bytes."""
    return zlib.crc32(frame)


def pack(note: Note, sequence: int, crc: int) -> bytes:
    """Return the 128 bytes of the record of ``note``, with the frame's sequence number and its CRC-32."""
    record = np.array((*_values(note), 0, _MARK), RECORD)
    record["sequence"], record["frame_crc"] = sequence, crc
    if note.suspicion or note.attempts > ATTEMPTS:
        record["attempts"] = min(note.attempts, ATTEMPTS) | int(note.suspicion) << 8
    record["record_crc"] = zlib.crc32(record.tobytes()[:_BODY])
    return record.tobytes()


def suspicions(records: NDArray[Any]) -> NDArray[np.uint8]:
    """Return the `Suspicion` bits stored with each record, ``(n,)``."""
    return (np.asarray(records["attempts"]) >> 8).astype(np.uint8)


def intact(records: NDArray[Any]) -> NDArray[np.bool_]:
    """Return a mask ``(n,)`` of the records that were written and are intact."""
    # a slot that was never written is all zeros; so compute the CRC-32 only of marked ones
    valid: NDArray[np.bool_] = records["valid"] == _MARK
    raw = np.ascontiguousarray(records).view(np.uint8).reshape(len(records), RECORD.itemsize)
    for k in np.flatnonzero(valid):
        valid[k] = zlib.crc32(raw[k, :_BODY].data) == records["record_crc"][k]
    return valid
