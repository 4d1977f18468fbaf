"""One recording file: created by HDF5 without data, then written in place; readable at any time, also after repacking.

``frames[N, h, w]`` and ``records[N]`` are contiguous, allocated early and never filled, so that the HDF5 file is
complete before the first frame. Each frame is written at its offset in the HDF5 dataset, followed by its record and
``fdatasync``; only then is it acknowledged. A frame that a crash left incomplete fails the check of its CRC-32, and is
regarded as not taken. Other programs may read the file at the same time.
"""

from __future__ import annotations

import os
import threading
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.recording.records import RECORD, Note, frame_crc, intact, pack
from lfcal.base import (
    OPEN_FLAGS,
    FileFormatError,
    StorageError,
    format_pixels,
    replace,
    reserve,
    storage_errors,
    sync_data,
    sync_folder,
    write_at,
)
from lfcal.base import read_at as read_bytes
from lfcal.base.h5 import H5File

__all__ = ["Layout", "RecordingFile", "RecordingJournal", "lay_out", "read_layout"]

FORMAT = "lfcal-recording"
VERSION = 1
PAGE = 4096


@dataclass(frozen=True, slots=True)
class Layout:
    """Location of the frames and records of a recording.

    Attributes
    ----------
    count
        Number of slots for frames.
    shape, dtype
        Rows and columns of a frame, and its sample type.
    frames_at, records_at
        Offsets of the first frame and the first record in the file (bytes); -1 once the recording is repacked into
        chunks.
    attributes
        Attributes of the file.
    """

    count: int
    shape: tuple[int, int]
    dtype: np.dtype[Any]
    frames_at: int
    records_at: int
    attributes: dict[str, Any]

    @property
    def frame_bytes(self) -> int:
        """Size of one frame (bytes)."""
        return self.shape[0] * self.shape[1] * self.dtype.itemsize

    @property
    def in_place(self) -> bool:
        """Whether frames can still be written in place."""
        return self.frames_at >= 0 and self.records_at >= 0


def read_layout(path: Path) -> Layout:
    """Read and check the layout of recording ``path``.

    Raises `FileFormatError` if it is not a recording, or has another format version.
    """
    with H5File(path) as file:
        attributes = file.attributes()
        if attributes.text("format") != FORMAT:
            raise FileFormatError.expected(
                str(path),
                "a recording of lfcal",
                "an HDF5 file of another format",
                "choose the recording.h5 of a session",
            )
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
                f"the shapes {frames.shape} and {records.shape}",
                "get the recording from its source again",
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
    """A recording that is open for writing by the program that has the lock of the session.

    Parameters
    ----------
    path
        An existing recording; see `create`. `StorageError` is raised if it was repacked.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.layout = read_layout(path)
        if not self.layout.in_place:
            raise StorageError(
                f"{path}: the recording is packed, so nothing can be added; record further positions in a new session"
            )
        with storage_errors(path):
            self._descriptor = os.open(path, os.O_RDWR | OPEN_FLAGS)
        self._closed = False

    @classmethod
    def create(
        cls, path: Path, count: int, shape: tuple[int, int], dtype: np.dtype[Any], attributes: dict[str, Any]
    ) -> RecordingJournal:
        """Create a recording for ``count`` frames of ``shape`` and ``dtype``, reserve its disk space, and open it.

        ``shape`` is ``(rows, columns)``, and ``attributes`` are written to the HDF5 file.

        If the disk is too small, `StorageError` is raised and no file is left.
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
                # rename it only when it is laid out, reserved and on disk
                replace(part, path)
                sync_folder(path.parent)
        finally:
            part.unlink(missing_ok=True)
        return cls(path)

    def put(self, slot: int, frame: NDArray[Any], note: Note, sequence: int) -> None:
        """Hand ``frame`` and its record to the operating system; they are safe after the next `sync`.

        ``slot`` is an index from 0 below the recording's ``count``, and ``sequence`` the frame's number in the session.
        Raises `StorageError` if the frame does not have the shape and dtype of the recording, or cannot be written.
        """
        layout = self.layout
        if frame.shape != layout.shape or frame.dtype != layout.dtype or not 0 <= slot < layout.count:
            raise StorageError.expected(
                f"{self.path}: slot {slot}",
                f"a slot below {layout.count}, and a frame of {format_pixels(layout.shape)} of {layout.dtype}",
                f"a frame of {format_pixels(frame.shape)} of {frame.dtype}",
                "start a new session",
            )
        data = np.ascontiguousarray(frame).data.cast("B")
        record = pack(note, sequence, frame_crc(data))
        try:
            # the frame before its record, so that a record never exists without its frame
            write_at(self._descriptor, data, layout.frames_at + slot * layout.frame_bytes)
            write_at(self._descriptor, record, layout.records_at + slot * RECORD.itemsize)
        except OSError:
            with storage_errors(self.path):
                raise

    def sync(self) -> None:
        """Wait until all frames passed to `put` are on disk; raise `StorageError` if this fails."""
        try:
            sync_data(self._descriptor)
            # a removed file still accepts writes, which are lost when it is closed
            links = os.fstat(self._descriptor).st_nlink
        except OSError:
            with storage_errors(self.path):
                raise
        if links < 1:
            raise StorageError(f"{self.path}: removed while recording; restore the folder, or start a new session")

    def records(self) -> NDArray[Any]:
        """Return the records of all slots as stored, ``(count,)`` of type `RECORD`; all zeros for empty slots."""
        data = read_at(self._descriptor, self.layout.count * RECORD.itemsize, self.layout.records_at, self.path)
        return np.frombuffer(data, RECORD).copy()

    def copy(self, slot: int, frame: NDArray[Any], record: NDArray[Any]) -> None:
        """Write a frame of another recording and its unchanged record into ``slot``; call `sync` to make them safe."""
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
    """Return ``size`` bytes at ``offset`` of an open file; raise `FileFormatError` if there are fewer.

    ``path`` names the file in error messages.
    """
    with storage_errors(path):
        data = read_bytes(descriptor, size, offset)
    if len(data) != size:
        raise FileFormatError.expected(
            str(path), f"{size} bytes at {offset}", len(data), "the file was cut short; restore it from a copy"
        )
    return data


def lay_out(
    path: Path, count: int, shape: tuple[int, int], dtype: np.dtype[Any], attributes: dict[str, Any]
) -> tuple[int, int]:
    """Create the HDF5 file of a recording, without writing frames or records.

    It has ``attributes`` and space for ``count`` frames of ``shape`` and ``dtype``. The offsets (bytes) at which the
    frames end and the records begin are returned.
    """
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


class RecordingFile:
    """Frames and records of one file; every frame is checked against its CRC-32 when it is read.

    Reading is safe from several threads and does not disturb a writer.

    Parameters
    ----------
    path
        The file.
    layout
        Layout to use in place of a damaged header; data beyond the end of the file count as missing. None: read it from
        the header.
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
        """Return frame ``slot`` as a new array; raise `FileFormatError` if it is damaged or was not recorded."""
        frame = self._frame(slot)
        if (
            frame is None
            or not self.taken[slot]
            or frame_crc(np.ascontiguousarray(frame).data.cast("B")) != self.records["frame_crc"][slot]
        ):
            raise FileFormatError.expected(
                f"{self.path.name}[{slot}]",
                "the recorded bytes",
                "damaged or missing ones",
                "record it again (lfcal acquire --resume)",
            )
        return frame

    def _frame(self, slot: int) -> NDArray[Any] | None:
        """Return the samples of frame ``slot`` without a check; None if HDF5 cannot decode them."""
        layout = self.layout
        if self._descriptor is not None:
            data = read_at(
                self._descriptor, layout.frame_bytes, layout.frames_at + slot * layout.frame_bytes, self.path
            )
            # frombuffer gives a read-only view of the bytes
            return np.frombuffer(data, layout.dtype).reshape(layout.shape).copy()
        try:
            # all threads share h5py's file position, but reading a descriptor at an offset needs none
            with self._lock:
                return self._frames.read(slot)
        except FileFormatError:
            return None

    def is_whole(self, slot: int) -> bool:
        """Return whether frame ``slot`` was recorded and agrees with the CRC-32 in its record."""
        for attempt in range(2):
            try:
                self.read(slot)
            except (OSError, RuntimeError, ValueError):
                # a running session may have written the frame after its record was read
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
