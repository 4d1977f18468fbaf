"""One recording read by anyone, while it is written or after it was repacked."""

from __future__ import annotations

import os
import threading
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.recording._slots import Layout, read_at, read_layout
from lfcal.acquire.recording.records import RECORD, frame_crc, intact
from lfcal.base import OPEN_FLAGS, FileFormatError, storage_errors
from lfcal.base.h5 import H5File

__all__ = ["RecordingFile"]


class RecordingFile:
    """Frames and records of one file, every frame checked against its CRC-32 as it is read.

    Reading is safe from several threads and does not disturb a writer.

    Parameters
    ----------
    path
        The file.
    layout
        Where frames and records lie, for a file that cannot say so itself; what lies beyond its end is missing.
    """

    def __init__(self, path: Path, layout: Layout | None = None) -> None:
        self.path = path
        self._damaged_file = layout is not None
        self.layout: Layout = layout or read_layout(path)
        self._lock = threading.Lock()
        self._descriptor: int | None = None
        self._file: H5File | None = None
        if self.layout.in_place:
            with storage_errors(path):
                self._descriptor = os.open(path, os.O_RDONLY | OPEN_FLAGS)
        else:
            self._file = H5File(path)
            self._frames = self._file.dataset("frames")
        self.records: NDArray[Any] = self._read_records()
        self.taken: NDArray[np.bool_] = intact(self.records)

    def read(self, slot: int) -> NDArray[Any]:
        """Return frame ``slot`` as a new array; raises `FileFormatError` if it is not what was recorded."""
        frame = self._frame(slot)
        if (
            frame is None
            or not self.taken[slot]
            or frame_crc(np.ascontiguousarray(frame).data.cast("B")) != self.records["frame_crc"][slot]
        ):
            raise FileFormatError.expected(
                f"{self.path.name}[{slot}]",
                "the recorded bytes",
                "damaged or never taken ones",
                "record it again (lfcal acquire --resume)",
            )
        return frame

    def _frame(self, slot: int) -> NDArray[Any] | None:
        """Return the samples of frame ``slot`` as they are, or None where HDF5 cannot decode them."""
        layout = self.layout
        if self._descriptor is not None:
            data = read_at(
                self._descriptor, layout.frame_bytes, layout.frames_at + slot * layout.frame_bytes, self.path
            )
            # frombuffer gives a read-only view of the bytes
            return np.frombuffer(data, layout.dtype).reshape(layout.shape).copy()
        try:
            # h5py's file is shared by all threads, a descriptor read at a position is not
            with self._lock:
                return self._frames.read(slot)
        except FileFormatError:
            return None

    def is_whole(self, slot: int) -> bool:
        """Return whether frame ``slot`` is what its record says, as both are on the disk now."""
        for attempt in range(2):
            try:
                self.read(slot)
            except (OSError, RuntimeError, ValueError):
                # a session that is being recorded may have written the frame since its record was read
                if attempt or not self._reread(slot):
                    return False
            else:
                return True
        return False

    def _reread(self, slot: int) -> bool:
        """Read one record again; return whether it changed."""
        if self._descriptor is None or self._damaged_file:
            return False
        at = self.layout.records_at + slot * RECORD.itemsize
        data = read_at(self._descriptor, RECORD.itemsize, at, self.path)
        if data == self.records[slot].tobytes():
            return False
        self.records[slot] = np.frombuffer(data, RECORD)[0]
        self.taken[slot] = intact(self.records[slot : slot + 1])[0]
        return True

    def close(self) -> None:
        """Close the file; may be called twice."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None
        if self._file is not None:
            self._file.close()
            self._file = None

    def __enter__(self) -> RecordingFile:
        """Return the recording."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the file."""
        self.close()

    def _read_records(self) -> NDArray[Any]:
        layout = self.layout
        if self._file is not None:
            return self._file.dataset("records", dtype=RECORD).read()
        assert self._descriptor is not None
        size = layout.count * RECORD.itemsize
        if self._damaged_file:
            size = max(0, min(size, os.fstat(self._descriptor).st_size - layout.records_at))
        data = read_at(self._descriptor, size, layout.records_at, self.path)
        return np.frombuffer(data.ljust(layout.count * RECORD.itemsize, b"\0"), RECORD).copy()
