"""A recording whose header is gone or whose end is cut off: where its frames lie follows from the session.

`lfcal.acquire.recording.slots.lay_out` puts the same recording at the same place every time, and the records prove it.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.recording.reader import RecordingFile
from lfcal.acquire.recording.records import FILES, Kind
from lfcal.acquire.recording.slots import Layout, lay_out, read_layout
from lfcal.errors import LfcalError
from lfcal.files import storage_errors
from lfcal.h5.probe import trust
from lfcal.system import OPEN_FLAGS, reserve, sync_data, write_at

__all__ = ["Made", "as_made", "opened", "recovered", "restore"]


@dataclass(frozen=True, slots=True)
class Made:
    """A recording as the session laid it out.

    ``layout`` says where everything lies; ``size`` (bytes) and ``header`` are the file's.
    """

    layout: Layout
    size: int
    header: bytes

    @property
    def frame_ends(self) -> NDArray[np.int64]:
        """Where in the file each frame ends (bytes), ``(N,)``."""
        layout = self.layout
        return layout.frames_at + layout.frame_bytes * np.arange(1, layout.count + 1, dtype=np.int64)


def as_made(kind: Kind, count: int, shape: tuple[int, int], dtype: np.dtype[Any], attributes: dict[str, Any]) -> Made:
    """Return how the file for ``kind`` was laid out; see `lfcal.acquire.recording.slots.Journal.create`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "layout.h5"  # sparse: it takes the room of its header only
        size, records_at = lay_out(path, count, shape, dtype, {**attributes, "holds": FILES[kind]})
        trust(path)
        with path.open("rb") as file:
            header = file.read(records_at)
        return Made(read_layout(path), size, header)


def recovered(path: Path, made: Made) -> RecordingFile | None:
    """Return a recording that HDF5 cannot open, read where it was ``made``; None where no frame is whole there.

    A packed recording may have its records at the same place, but never a frame.
    """
    try:
        file = RecordingFile(path, made.layout)
    except (LfcalError, OSError):
        return None
    within = np.flatnonzero(file.taken & (made.frame_ends <= path.stat().st_size))
    if any(file.is_whole(slot) for slot in within.tolist()):
        return file
    file.close()
    return None


def restore(path: Path, made: Made) -> None:
    """Give a recording its header and its size again; records and frames that are there stay as they are."""
    with storage_errors(path):
        descriptor = os.open(path, os.O_RDWR | OPEN_FLAGS)
        try:
            reserve(descriptor, made.size)
            write_at(descriptor, made.header, 0)
            sync_data(descriptor)
        finally:
            os.close(descriptor)


@contextmanager
def opened(path: Path, made: Made, identity: str) -> Iterator[tuple[RecordingFile | None, str]]:
    """Open a recording as far as that is possible; give it, or None, and what is wrong with the file."""
    fault, file = "", None
    try:
        file = RecordingFile(path)
        want, got = made.layout, file.layout
        if (got.count, got.shape, got.dtype) != (want.count, want.shape, want.dtype):
            fault = f"{got.count} frames of {got.shape} {got.dtype}, not those of this session"
        elif got.attributes.get("session") != identity:
            fault = "one of another session"
    except (OSError, RuntimeError, ValueError, KeyError, TypeError) as error:
        fault = " ".join(str(error).split()).removeprefix(f"{path}: ")
        size = path.stat().st_size if path.is_file() else 0
        file = recovered(path, made) if size else None
        if file is not None:
            fault = f"cut short: {size} of {made.size} bytes" if size < made.size else "its header is damaged"
    if fault and file is not None and file.layout is not made.layout:
        file.close()
        file = None
    try:
        yield file, fault
    finally:
        if file is not None:
            file.close()
