"""One recording read by anyone, while it is written or after it was repacked."""

from __future__ import annotations

import os
import threading
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.recording.records import RECORD, frame_crc, intact
from lfcal.acquire.recording.slots import Layout, read_at, read_layout
from lfcal.errors import FileFormatError
from lfcal.files import storage_errors
from lfcal.h5.file import H5File
from lfcal.system import OPEN_FLAGS

__all__ = ["RecordingFile"]


class RecordingFile:
    """Frames and records of one file, every frame checked against its CRC-32 as it is read.

    Reading is safe from several threads and does not disturb a writer.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.layout: Layout = read_layout(path)
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
        layout = self.layout
        if self._descriptor is not None:
            data = read_at(
                self._descriptor, layout.frame_bytes, layout.frames_at + slot * layout.frame_bytes, self.path
            )
            # frombuffer gives a read-only view of the bytes
            frame = np.frombuffer(data, layout.dtype).reshape(layout.shape).copy()
        else:
            # h5py's file is shared by all threads, a descriptor read at a position is not
            with self._lock:
                frame = self._frames.read(slot)
        if (
            not self.taken[slot]
            or frame_crc(np.ascontiguousarray(frame).data.cast("B")) != self.records["frame_crc"][slot]
        ):
            raise FileFormatError.expected(
                f"{self.path.name} frame {slot}",
                "the recorded bytes",
                "damaged or never taken ones",
                "record this position again",
            )
        return frame

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
        data = read_at(self._descriptor, layout.count * RECORD.itemsize, layout.records_at, self.path)
        return np.frombuffer(data, RECORD).copy()
