"""A recording whose header is gone or whose end is cut off: where its frames lie follows from the session.

`lfcal.acquire.recording._slots.lay_out` puts the same recording at the same place every time, and the records prove it.
"""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.recording._slots import Layout, lay_out, read_layout
from lfcal.acquire.recording.reader import RecordingFile
from lfcal.acquire.recording.records import FILES, Kind
from lfcal.base import OPEN_FLAGS, LfcalError, reserve, storage_errors, sync_data, write_at
from lfcal.base.h5 import trust

__all__ = ["Made", "opened", "recovered", "restore"]


class Made:
    """A recording as the session lays it out; where its parts lie is found out when it is asked for.

    Parameters
    ----------
    kind, count, shape, dtype
        What the frames are, how many, rows and columns, and sample type.
    attributes
        What the file says of itself.
    """

    def __init__(
        self, kind: Kind, count: int, shape: tuple[int, int], dtype: np.dtype[Any], attributes: dict[str, Any]
    ) -> None:
        self.frames = count, shape, dtype
        self._attributes = {**attributes, "holds": FILES[kind]}

    @property
    def layout(self) -> Layout:
        """Where everything lies."""
        return self._laid_out[0]

    @property
    def size(self) -> int:
        """Bytes of the file."""
        return self._laid_out[1]

    @property
    def header(self) -> bytes:
        """What the file begins with."""
        return self._laid_out[2]

    @property
    def frame_ends(self) -> NDArray[np.int64]:
        """Where in the file each frame ends (bytes), ``(N,)``."""
        layout = self.layout
        return layout.frames_at + layout.frame_bytes * np.arange(1, layout.count + 1, dtype=np.int64)

    @cached_property
    def _laid_out(self) -> tuple[Layout, int, bytes]:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "layout.h5"  # sparse: it takes the room of its header only
            size, records_at = lay_out(path, *self.frames, self._attributes)
            trust(path)
            with path.open("rb") as file:
                header = file.read(records_at)
            return read_layout(path), size, header


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
        got = file.layout
        if (got.count, got.shape, got.dtype) != made.frames:
            fault = f"{got.count} frames of {got.shape} {got.dtype}, not those of this session"
        elif got.attributes.get("session") != identity:
            fault = "one of another session"
    except (OSError, RuntimeError, ValueError, KeyError, TypeError) as error:
        fault = _told(" ".join(str(error).split()).removeprefix(f"{path}: "))
        size = path.stat().st_size if path.is_file() else 0
        file = recovered(path, made) if size else None
        if file is not None:
            fault = f"cut short: {size} of {made.size} bytes" if size < made.size else "its header is damaged"
    # another session's, and not one that was read where this session's frames lie
    if fault and file is not None and file.layout is not made.layout:
        file.close()
        file = None
    try:
        yield file, fault
    finally:
        if file is not None:
            file.close()


def _told(error: str) -> str:
    """Return what was found in place of what: the sentence stands within another that says what to do."""
    found = re.fullmatch(r"(?:[^:]*: )?expected (.+?), got (.+?)(?:; .*)?", error)
    return f"{found[2]} in place of {found[1]}" if found else error
