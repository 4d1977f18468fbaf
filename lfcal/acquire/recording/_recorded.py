"""One file of a session as it was recorded: what should be in it, whatever is left of it."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.recording._contents import Slots, files_made, slots_of
from lfcal.acquire.recording._recovery import opened
from lfcal.acquire.recording.reader import RecordingFile
from lfcal.acquire.recording.records import Kind, file_name
from lfcal.acquire.schedule import Schedule
from lfcal.acquire.session_file import SessionFile
from lfcal.base import FileFormatError

__all__ = ["RecordedFile"]


class RecordedFile:
    """The frames of one kind in one recording of a session; those that are lost are there and cannot be read.

    Attributes
    ----------
    slots
        What belongs into each slot.
    records
        ``(N,)`` what is noted of each frame; where that is lost, what the plan says.
    there
        ``(N,)`` whether a slot holds a frame, or held one.
    fault
        What is wrong with the file itself, empty for nothing.

    Parameters
    ----------
    folder, session, run, schedule, kind
        Which file of which session, and the steps of its recording.

    Raises
    ------
    FileFormatError
        If the file is another session's.
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
                str(folder / self.name), f"{count} frames", self._file.layout.count, "restore this session's file"
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
        """Return the name of a frame for messages."""
        return f"{self.name}[{slot}]"

    def check(self) -> None:
        """Raise `FileFormatError` where the file itself is damaged or gone."""
        if self.fault:
            raise FileFormatError(
                f"{self._path}: {self.fault}; lfcal verify says what is lost, --skip-damaged leaves it out"
            )

    def read(self, slot: int) -> NDArray[Any]:
        """Return frame ``slot``; raises `FileFormatError` if it is not what was recorded."""
        if self._file is None:
            raise FileFormatError.expected(
                self.label(slot), "the recorded bytes", "a file that cannot be read", "restore it, or record this again"
            )
        return self._file.read(slot)

    def close(self) -> None:
        """Close the file; may be called twice."""
        self._stack.close()
