"""The record that goes with every frame: what it is, where it was taken, and proof that both are whole."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.devices.protocols import Point

__all__ = ["FILES", "RECORD", "Kind", "Note", "file_name", "frame_crc", "intact", "pack"]


class Kind(IntEnum):
    """What a frame is."""

    POSITION = 0
    DARK = 1
    REFERENCE = 2
    CONTROL = 3


FILES = {Kind.POSITION: "recording", Kind.REFERENCE: "checks", Kind.CONTROL: "checks", Kind.DARK: "darks"}
"""Which file each kind of frame goes to."""


def file_name(kind: Kind, run: int) -> str:
    """Return the name of the file for ``kind`` in recording number ``run`` (from 0)."""
    return f"{FILES[kind]}.h5" if run == 0 else f"{FILES[kind]}-{run + 1:03d}.h5"


RECORD = np.dtype(
    [
        ("index", "<u4"),  # position in the scan plan
        ("sequence", "<u4"),  # the session's count of acknowledged frames
        ("frame_crc", "<u4"),
        ("attempts", "<u2"),
        ("kind", "<u2"),
        ("row", "<i4"),  # sensor pixel of the frame's first row and column
        ("column", "<i4"),
        ("period_y", "<i2"),  # control frames: whole periods away from the plan's position
        ("period_x", "<i2"),
        ("saturated", "<u4"),  # saturated pixels in this frame
        ("sensor_saturated", "<u4"),  # saturated pixels in all that was read from the sensor
        ("target_um", "<f8", (3,)),
        ("stage_um", "<f8", (3,)),  # read back after the exposure
        ("exposure_s", "<f8"),
        ("time_s", "<f8"),  # seconds since 1970
        ("elapsed_s", "<f8"),  # seconds of recording, pauses and interruptions left out
        ("energy", "<f8"),  # sum of the frame's samples
        ("peak", "<f4"),
        ("record_crc", "<u4"),
        ("valid", "<u4"),
    ]
)
"""One record: 128 bytes, little-endian."""

_BODY = struct.Struct("<IIIHHiihhII3d3d4df")
_TAIL = struct.Struct("<II")
_MARK = 0x1FCA1


@dataclass(frozen=True, slots=True)
class Note:
    """What is noted with a frame; see `RECORD` for the meaning of each entry.

    ``stage_um`` and ``target_um`` in µm, times in s.
    """

    index: int
    kind: Kind
    row: int
    column: int
    target_um: Point
    stage_um: Point
    exposure_s: float
    time_s: float
    elapsed_s: float
    energy: float
    peak: float
    saturated: int = 0
    sensor_saturated: int = 0
    attempts: int = 1
    period_y: int = 0
    period_x: int = 0


def frame_crc(frame: bytes | memoryview) -> int:
    """Return the CRC-32 of a frame's bytes."""
    return zlib.crc32(frame)


def pack(note: Note, sequence: int, crc: int) -> bytes:
    """Return the 128 bytes of a record, closed with their own CRC-32 and the mark of validity."""
    body = _BODY.pack(
        note.index,
        sequence,
        crc,
        note.attempts,
        note.kind,
        note.row,
        note.column,
        note.period_y,
        note.period_x,
        note.saturated,
        note.sensor_saturated,
        *note.target_um,
        *note.stage_um,
        note.exposure_s,
        note.time_s,
        note.elapsed_s,
        note.energy,
        note.peak,
    )
    return body + _TAIL.pack(zlib.crc32(body), _MARK)


def intact(records: NDArray[Any]) -> NDArray[np.bool_]:
    """Return for each record whether it was written and is whole."""
    valid: NDArray[np.bool_] = records["valid"] == _MARK
    raw = np.ascontiguousarray(records).view(np.uint8).reshape(len(records), RECORD.itemsize)
    for k in np.flatnonzero(valid):
        valid[k] = zlib.crc32(raw[k, : _BODY.size].data) == records["record_crc"][k]
    return valid
