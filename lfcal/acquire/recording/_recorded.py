"""Compare the expected with the existing content of one file of a recorded session.

The header may be missing and the end truncated. `lfcal.acquire.recording.recording_file.lay_out` always places the same
recording at the same offsets. The session therefore determines where the frames are, and the records prove it.
"""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.recording.recording_file import Layout, RecordingFile, lay_out, read_layout
from lfcal.acquire.recording.records import FILES, RECORD, Kind, file_name
from lfcal.acquire.recording.store import files_of
from lfcal.acquire.schedule import Schedule
from lfcal.acquire.session_file import SessionFile, frame_dtype
from lfcal.base import (
    OPEN_FLAGS,
    FileFormatError,
    LfcalError,
    format_pixels,
    reserve,
    storage_errors,
    sync_data,
    write_at,
)
from lfcal.base.h5 import trust

__all__ = ["RecordedFile", "Slots", "files_made", "opened", "restore", "slots_of"]


class Made:
    """Expected layout of a recording; offsets are computed on first use.

    Parameters
    ----------
    kind, count, shape, dtype
        Kind, number, shape (rows, columns) and sample type of the frames.
    attributes
        Attributes of the file.
    """

    def __init__(
        self, kind: Kind, count: int, shape: tuple[int, int], dtype: np.dtype[Any], attributes: dict[str, Any]
    ) -> None:
        self.frames = count, shape, dtype
        self._attributes = {**attributes, "holds": FILES[kind]}

    @property
    def layout(self) -> Layout:
        """Offsets of all parts."""
        return self._laid_out[0]

    @property
    def size(self) -> int:
        """Size of the file (bytes)."""
        return self._laid_out[1]

    @property
    def header(self) -> bytes:
        """Bytes of the file's header."""
        return self._laid_out[2]

    @property
    def frame_ends(self) -> NDArray[np.int64]:
        """Offset in the file of the end of each frame, ``(N,)`` (bytes)."""
        layout = self.layout
        return layout.frames_at + layout.frame_bytes * np.arange(1, layout.count + 1, dtype=np.int64)

    @cached_property
    def _laid_out(self) -> tuple[Layout, int, bytes]:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "layout.h5"  # sparse: only its header takes disk space
            size, records_at = lay_out(path, *self.frames, self._attributes)
            trust(path)
            with path.open("rb") as file:
                header = file.read(records_at)
            return read_layout(path), size, header


def recovered(path: Path, made: Made) -> RecordingFile | None:
    """Open a recording that HDF5 cannot open, with the expected layout; None if it contains no intact frame.

    A packed recording may have its records at the same offset, but never its frames.
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
    """Restore header and size of a recording; records and frames in the file are not changed."""
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
    """Yield a recording, opened as far as possible (else None), and the fault of the file (empty: none)."""
    fault, file = "", None
    try:
        file = RecordingFile(path)
        got = file.layout
        if (got.count, got.shape, got.dtype) != made.frames:
            fault = (
                f"it contains {got.count} frames of {format_pixels(got.shape)} ({got.dtype}), not those of this session"
            )
        elif got.attributes.get("session") != identity:
            fault = "the file belongs to another session"
    except (OSError, RuntimeError, ValueError, KeyError, TypeError) as error:
        fault = _in_sentence(" ".join(str(error).split()).removeprefix(f"{path}: "))
        size = path.stat().st_size if path.is_file() else 0
        file = recovered(path, made) if size else None
        if file is not None:
            fault = (
                f"the file is cut short: {size} of {made.size} bytes" if size < made.size else "its header is damaged"
            )
    # from another session, unless it was read at the offsets of this session's frames
    if fault and file is not None and file.layout is not made.layout:
        file.close()
        file = None
    try:
        yield file, fault
    finally:
        if file is not None:
            file.close()


def _in_sentence(error: str) -> str:
    """Return an error's message without its remedy, in the form "found instead of expected" if it states both."""
    found = re.fullmatch(r"(?:[^:]*: )?expected (.+?), got (.+?)(?:; .*)?", error)
    return f"{found[2]} instead of {found[1]}" if found else error.partition("; ")[0]


class Slots(NamedTuple):
    """Expected content of the ``N`` slots of one file.

    ``kinds`` ``(N,)``, ``flat`` ``(N,)`` (positions of the plan) and ``origins`` ``(N, 2)`` (row and column of the
    first pixel on the sensor) have the same meaning as in `Schedule`.
    """

    kinds: NDArray[np.uint8]
    flat: NDArray[np.int64]
    origins: NDArray[np.int64]

    def records(self, exposures_s: NDArray[np.float64]) -> NDArray[np.void]:
        """Return substitutes ``(N,)`` for lost records, with the exposure of each slot's plane (s)."""
        records = np.zeros(len(self.flat), RECORD)
        records["index"], records["kind"], records["exposure_s"] = self.flat, self.kinds, exposures_s
        records["row"], records["column"] = self.origins.T
        return records


def slots_of(schedule: Schedule, kind: Kind) -> Slots:
    """Return the expected slots of the file for ``kind``."""
    here = np.isin(schedule.kinds, [k for k in Kind if file_name(k, 0) == file_name(kind, 0)])
    order = np.argsort(schedule.slots[here])
    kinds, flat, origins = (values[here][order] for values in (schedule.kinds, schedule.flat, schedule.origins))
    return Slots(kinds.astype(np.uint8), flat.astype(np.int64), origins.astype(np.int64))


def files_made(session: SessionFile, run: int, schedule: Schedule) -> dict[Kind, Made]:
    """Return the expected layout of the files of recording ``run``, by kind of frame."""
    plans = files_of(schedule, frame_dtype(session.plan, session.options, session.devices))
    about = session.attributes(run, schedule)
    return {kind: Made(kind, *plan, about) for kind, plan in plans.items()}


class RecordedFile:
    """The frames of one kind in one recording of a session; lost ones are included, but cannot be read.

    Attributes
    ----------
    slots
        Expected content of each slot.
    records
        Record of each frame ``(N,)``; the values of the plan if it is lost.
    there
        Whether each slot contains or contained a frame, ``(N,)``.
    fault
        Fault of the file itself; empty if there is none.

    Parameters
    ----------
    folder, session, run, schedule, kind
        Folder of the session, the session, number and steps of the recording, and kind of the frames.

    Raises
    ------
    FileFormatError
        If the file belongs to another session.
    """

    def __init__(self, folder: Path, session: SessionFile, run: int, schedule: Schedule, kind: Kind) -> None:
        self.name = file_name(kind, run)
        self._path = folder / self.name
        self.slots: Slots = slots_of(schedule, kind)
        self._stack = ExitStack()
        made = files_made(session, run, schedule)[kind]
        self._file: RecordingFile | None
        self._file, self.fault = self._stack.enter_context(opened(self._path, made, session.identity))
        count = len(self.slots.flat)
        if self._file is not None and self._file.layout.count != count:
            self.close()
            raise FileFormatError.expected(
                str(folder / self.name), f"{count} frames", self._file.layout.count, "restore it from a copy"
            )
        taken = self._taken()
        complete = self._file is None or not self._file.layout.in_place or session.was_complete(run)
        self.there = taken | complete
        planes = self.slots.flat // (session.grid[1] * session.grid[2])
        self.records: NDArray[Any] = self.slots.records(np.array(session.plan.exposures)[planes])
        if self._file is not None:
            self.records[taken] = self._file.records[taken]

    def _taken(self) -> NDArray[np.bool_]:
        return np.zeros(len(self.slots.flat), np.bool_) if self._file is None else self._file.taken

    def label(self, slot: int) -> str:
        """Return a label of the frame in slot ``slot``, for messages."""
        return f"{self.name}[{slot}]"

    def check(self) -> None:
        """Raise `FileFormatError` if the file itself is damaged or missing."""
        if self.fault:
            raise FileFormatError(
                f"{self._path}: {self.fault}; copy the file again, or leave out the lost frames (--skip-damaged); "
                "lfcal verify lists these frames"
            )

    def read(self, slot: int) -> NDArray[Any]:
        """Return frame ``slot``; raises `FileFormatError` if it differs from what was recorded."""
        if self._file is None:
            raise FileFormatError.expected(
                self.label(slot),
                "the recorded bytes",
                "an unreadable file",
                "restore it from a copy, or record it again",
            )
        return self._file.read(slot)

    def close(self) -> None:
        """Close the file; may be called twice."""
        self._stack.close()
