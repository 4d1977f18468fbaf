"""The crash-safe recording: laid out once by HDF5, then written in place.

``frames[N, h, w]`` and ``records[N]`` are contiguous, allocated early and never filled, so that the HDF5
file is complete before the first frame. Each frame is written where HDF5 put its dataset, then its record,
then ``fdatasync``; only then is it acknowledged. A frame torn by a crash fails its CRC-32 and counts
as not taken. Any reader may open the file meanwhile.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.recording.records import RECORD, Note, frame_crc, pack
from lfcal.base import (
    OPEN_FLAGS,
    FileFormatError,
    StorageError,
    replace,
    reserve,
    storage_errors,
    sync_data,
    sync_folder,
    write_at,
)
from lfcal.base import read_at as read_bytes
from lfcal.base.h5 import H5File

__all__ = ["FORMAT", "VERSION", "Layout", "RecordingJournal", "lay_out", "read_at", "read_layout"]

FORMAT = "lfcal-recording"
VERSION = 1
PAGE = 4096


@dataclass(frozen=True, slots=True)
class Layout:
    """Where the frames and records of a recording lie.

    Attributes
    ----------
    count
        Slots for frames.
    shape, dtype
        Rows and columns of a frame, and its sample type.
    frames_at, records_at
        Offsets in the file (bytes); -1 once the recording is repacked into chunks.
    attributes
        What the file says of itself.
    """

    count: int
    shape: tuple[int, int]
    dtype: np.dtype[Any]
    frames_at: int
    records_at: int
    attributes: dict[str, Any]

    @property
    def frame_bytes(self) -> int:
        """Bytes of one frame."""
        return self.shape[0] * self.shape[1] * self.dtype.itemsize

    @property
    def in_place(self) -> bool:
        """Whether frames can still be written in place."""
        return self.frames_at >= 0 and self.records_at >= 0


def read_layout(path: Path) -> Layout:
    """Return the layout of recording ``path``, checked; raises `FileFormatError` if it is not one."""
    with H5File(path) as file:
        attributes = file.attributes()
        if attributes.text("format") != FORMAT:
            raise FileFormatError.expected(str(path), "a recording", "another HDF5 file", "choose recording.h5")
        if attributes.integer("version") != VERSION:
            raise FileFormatError.expected(
                str(path), f"version {VERSION}", attributes.integer("version"), "update lfcal"
            )
        frames = file.dataset("frames")
        records = file.dataset("records", dtype=RECORD)
        if frames.ndim != 3 or records.shape != (frames.shape[0],) or frames.dtype.kind not in "uf":
            raise FileFormatError.expected(
                str(path),
                "frames[N, h, w] and records[N]",
                f"{frames.shape} and {records.shape}",
                "take the recording from its source again",
            )
        frames_at, records_at = frames.offset, records.offset
        return Layout(
            int(frames.shape[0]),
            (int(frames.shape[1]), int(frames.shape[2])),
            frames.dtype,
            -1 if frames_at is None else frames_at,
            -1 if records_at is None else records_at,
            attributes.plain(),
        )


class RecordingJournal:
    """A recording open for writing; one program at a time (the session holds the lock).

    Parameters
    ----------
    path
        An existing recording that has not been repacked; see `create`.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.layout = read_layout(path)
        if not self.layout.in_place:
            raise StorageError(f"{path}: is finished and repacked; record what is to be redone beside it")
        with storage_errors(path):
            self._descriptor = os.open(path, os.O_RDWR | OPEN_FLAGS)
        self._closed = False

    @classmethod
    def create(
        cls, path: Path, count: int, shape: tuple[int, int], dtype: np.dtype[Any], attributes: dict[str, Any]
    ) -> RecordingJournal:
        """Lay out a recording of ``count`` frames of ``shape`` and ``dtype``, reserve it on disk and open it.

        Raises `StorageError` when the disk cannot hold it; nothing is left behind then.
        """
        part = path.with_name(f".{path.name}.part")
        try:
            with storage_errors(path):
                end, records_at = lay_out(part, count, shape, dtype, attributes)
                descriptor = os.open(part, os.O_RDWR | OPEN_FLAGS)
                try:
                    reserve(descriptor, end)
                    write_at(descriptor, bytes(count * RECORD.itemsize), records_at)
                    sync_data(descriptor)
                finally:
                    os.close(descriptor)
                # under its name only when it is laid out, reserved and on the disk
                replace(part, path)
                sync_folder(path.parent)
        finally:
            part.unlink(missing_ok=True)
        return cls(path)

    def put(self, slot: int, frame: NDArray[Any], note: Note, sequence: int) -> None:
        """Hand ``frame`` and its record to the operating system; they are safe after the next `sync`.

        ``frame`` is ``(h, w)`` of the recording's dtype. Raises `StorageError` if the disk refuses.
        """
        layout = self.layout
        if frame.shape != layout.shape or frame.dtype != layout.dtype or not 0 <= slot < layout.count:
            raise StorageError.expected(
                f"{self.path}: slot {slot}",
                f"{layout.shape} {layout.dtype} below {layout.count}",
                f"{frame.shape} {frame.dtype}",
                "start a new session",
            )
        data = np.ascontiguousarray(frame).data.cast("B")
        record = pack(note, sequence, frame_crc(data))
        try:
            # the frame before its record: a record alone must never be found
            write_at(self._descriptor, data, layout.frames_at + slot * layout.frame_bytes)
            write_at(self._descriptor, record, layout.records_at + slot * RECORD.itemsize)
        except OSError:
            with storage_errors(self.path):
                raise

    def sync(self) -> None:
        """Return when everything put is on the disk; raises `StorageError` if it is not, or the file is gone."""
        try:
            sync_data(self._descriptor)
            # a file that was removed still takes writes, which are lost when it is closed
            links = os.fstat(self._descriptor).st_nlink
        except OSError:
            with storage_errors(self.path):
                raise
        if links < 1:
            raise StorageError(f"{self.path}: was removed while recording; restore the folder, or start a new session")

    def records(self) -> NDArray[Any]:
        """Return all records ``[N]`` as they are on disk; see `RECORD`."""
        data = read_at(self._descriptor, self.layout.count * RECORD.itemsize, self.layout.records_at, self.path)
        return np.frombuffer(data, RECORD).copy()

    def copy(self, slot: int, frame: NDArray[Any], record: NDArray[Any]) -> None:
        """Hand over a frame of another recording with its record as it is; see `put`."""
        layout = self.layout
        with storage_errors(self.path):
            data = np.ascontiguousarray(frame).data.cast("B")
            write_at(self._descriptor, data, layout.frames_at + slot * layout.frame_bytes)
            write_at(self._descriptor, record.tobytes(), layout.records_at + slot * RECORD.itemsize)

    def close(self) -> None:
        """Close the file; may be called twice."""
        if not self._closed:
            self._closed = True
            os.close(self._descriptor)


def read_at(descriptor: int, size: int, offset: int, path: Path) -> bytes:
    """Return ``size`` bytes of an open file at ``offset``; ``path`` is for messages."""
    with storage_errors(path):
        data = read_bytes(descriptor, size, offset)
    if len(data) != size:
        raise FileFormatError.expected(str(path), f"{size} bytes at {offset}", len(data), "the file was cut short")
    return data


def lay_out(
    path: Path, count: int, shape: tuple[int, int], dtype: np.dtype[Any], attributes: dict[str, Any]
) -> tuple[int, int]:
    """Make the HDF5 file without any data; return the end of the frames and the start of the records."""
    import h5py

    access = h5py.h5p.create(h5py.h5p.FILE_ACCESS)
    access.set_alignment(PAGE, PAGE)
    access.set_fclose_degree(h5py.h5f.CLOSE_STRONG)
    with h5py.File(h5py.h5f.create(os.fsencode(path), h5py.h5f.ACC_TRUNC, fapl=access)) as file:
        file.attrs.update({"format": FORMAT, "version": VERSION, **attributes})
        records_at = _allocate(file, b"records", RECORD, (count,))
        frames_at = _allocate(file, b"frames", dtype, (count, *shape))
    return frames_at + count * shape[0] * shape[1] * dtype.itemsize, records_at


def _allocate(file: Any, name: bytes, dtype: np.dtype[Any], shape: tuple[int, ...]) -> int:
    import h5py

    how = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    how.set_layout(h5py.h5d.CONTIGUOUS)
    how.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    how.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    space = h5py.h5s.create_simple(shape)
    dataset = h5py.h5d.create(file.id, name, h5py.h5t.py_create(dtype, logical=True), space, how)
    return int(dataset.get_offset())
