"""Recordings damaged as disks and copies damage them."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np

from lfcal.acquire.recording.recording_file import read_layout
from lfcal.acquire.recording.records import RECORD

PAGE = 4096


def flip(path: Path, offset: int, bits: int = 0x10) -> None:
    """Flip bits of one byte."""
    with path.open("r+b") as file:
        file.seek(offset)
        byte = file.read(1)[0]
        file.seek(offset)
        file.write(bytes([byte ^ bits]))


def wipe(path: Path, offset: int, size: int = PAGE) -> None:
    """Overwrite bytes with zeros."""
    with path.open("r+b") as file:
        file.seek(offset)
        file.write(bytes(size))


def frame_at(path: Path, slot: int) -> tuple[int, int]:
    """Return where the bytes of a frame lie in a recording, in place or packed, and how many they are."""
    layout = read_layout(path)
    if layout.in_place:
        return layout.frames_at + slot * layout.frame_bytes, layout.frame_bytes
    with h5py.File(path, "r") as file:
        info = file["frames"].id.get_chunk_info_by_coord((slot, 0, 0))
        return int(info.byte_offset), int(info.size)


def record_at(path: Path, slot: int) -> int:
    """Return where a record lies."""
    with h5py.File(path, "r", locking=False) as file:
        return int(file["records"].id.get_offset()) + slot * RECORD.itemsize


def rot_frame(path: Path, slot: int) -> None:
    """Flip a bit in the middle of a frame."""
    at, size = frame_at(path, slot)
    flip(path, at + size // 2)


def rot_record(path: Path, slot: int) -> None:
    """Flip a bit of the stage's read-back in a record."""
    flip(path, record_at(path, slot) + 70)


def wipe_record(path: Path, slot: int) -> None:
    """Overwrite a record with zeros."""
    wipe(path, record_at(path, slot), RECORD.itemsize)


def wipe_frame(path: Path, slot: int) -> None:
    """Overwrite a frame with zeros."""
    wipe(path, *frame_at(path, slot))


ROTS: dict[str, Callable[[Path, int], None]] = {
    "bit of a frame": rot_frame,
    "frame of zeros": wipe_frame,
    "bit of a record": rot_record,
    "record of zeros": wipe_record,
}


def cut(path: Path, size: int) -> None:
    """Cut a file short."""
    os.truncate(path, size)


def frames_on_page(path: Path, offset: int) -> set[int]:
    """Return the slots of the frames of a recording in place that have bytes on one page other than zero."""
    layout, data = read_layout(path), np.fromfile(path, np.uint8)
    places = np.arange(offset, offset + PAGE)
    places = places[(places < len(data)) & (places >= layout.frames_at)]
    return set(((places[data[places] != 0] - layout.frames_at) // layout.frame_bytes).tolist())
