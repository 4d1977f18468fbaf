"""Check of all records and frames of a session, which may be intact, damaged, or never taken.

A damaged recording is repaired so that its damaged frames can be taken again.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from enum import IntEnum
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.recording._recorded import Slots, files_made, opened, restore, slots_of
from lfcal.acquire.recording.recording_file import RecordingFile, RecordingJournal
from lfcal.acquire.recording.records import Kind, file_name
from lfcal.acquire.session_file import SessionFile
from lfcal.base import (
    Clock,
    FileFormatError,
    Work,
    drained,
    format_count,
    replace_whole,
    require_space,
    worker_count,
)
from lfcal.frames import Position

__all__ = ["DamagedFrame", "SessionReport", "iter_repair", "iter_verify", "verify"]

BLOCK_BYTES = 1 << 24
"""Approximate size of the blocks of frames that a thread checks (bytes)."""


class State(IntEnum):
    """State of a slot of a recording."""

    WHOLE = 0
    NEVER_TAKEN = 1
    FRAME_DAMAGED = 2
    RECORD_DAMAGED = 3
    LOST = 4


_STATE_WORDS = {
    State.FRAME_DAMAGED: "frame damaged",
    State.RECORD_DAMAGED: "record damaged",
    State.LOST: "lost",
}


@dataclass(frozen=True, slots=True)
class DamagedFrame:
    """A recorded frame that is damaged.

    ``file`` is the name of its file, and ``slot`` its index there. The ``kind`` is ``"position"``, ``"dark"``,
    ``"reference"`` or ``"control"``. The ``position`` (z, y, x) is that in the plan, and ``what`` describes the damage.
    Whether a later recording has an intact frame of the position is stated by ``replaced``.
    """

    file: str
    slot: int
    kind: str
    position: Position
    what: str
    replaced: bool = False


@dataclass(frozen=True, slots=True)
class FileReport:
    """Report on one file of a session: the states of its frames, and the fault of the file (empty: none)."""

    file: str
    frames: int
    whole: int
    damaged: int
    never_taken: int
    fault: str = ""


@dataclass(frozen=True, slots=True)
class SessionReport:
    """Result of a full check of a session.

    Attributes
    ----------
    path
        Folder of the session.
    files
        Reports on all files.
    damaged
        Frames that were recorded and are damaged or lost, in the order of files and slots.
    never_taken
        Positions (z, y, x) without any frame, intact or damaged.
    pending
        Positions (z, y, x) of damaged frames that will be recorded again when the session is resumed.
    lacking
        Number of acknowledged positions whose record is lost.
    """

    data: ClassVar[str] = "session"

    path: Path
    files: tuple[FileReport, ...]
    damaged: tuple[DamagedFrame, ...]
    never_taken: tuple[Position, ...]
    pending: tuple[Position, ...] = ()
    lacking: int = 0

    @property
    def ok(self) -> bool:
        """Whether no recorded frame is damaged, except frames that were recorded again."""
        return not self.lacking and not any(f.fault for f in self.files) and all(d.replaced for d in self.damaged)

    @property
    def known(self) -> str:
        """Text that states how many of all frames are intact."""
        whole, total = (sum(getattr(file, name) for file in self.files) for name in ("whole", "frames"))
        return f"intact in {whole:,} of {format_count(total, 'frame', 'frames')}"

    @property
    def to_redo(self) -> tuple[Position, ...]:
        """Positions (z, y, x) without an intact frame, although one was recorded, in ascending order."""
        found = {d.position for d in self.damaged if d.kind == "position" and not d.replaced}
        return tuple(sorted(found))

    @property
    def lost(self) -> int:
        """Number of frames to take again; a position that is damaged in several recordings is counted once."""
        return len(self.to_redo) + sum(d.kind != "position" for d in self.damaged)

    def lines(self, most: int = 20) -> Iterator[str]:
        """Yield a line of text for each damaged frame, at most ``most`` of them, and a line that counts the others."""
        for found in self.damaged[:most]:
            said = f"{found.what}, but recorded again since then" if found.replaced else found.what
            yield f"{found.kind} (z, y, x) = {tuple(found.position)}, {found.file}[{found.slot}]: {said}"
        if len(self.damaged) > most:
            yield f"and {len(self.damaged) - most:,} more (--json lists all)"

    def slots(self, file: str) -> NDArray[np.int64]:
        """Return the indices of the damaged frames in the file named ``file``, ``(n,)``."""
        return np.array([d.slot for d in self.damaged if d.file == file], np.int64)


def iter_verify(folder: Path, *, workers: int | None = None) -> Work[SessionReport]:
    """Check all records and frames of a session against their CRC-32 checksums, and return a report.

    Nothing is changed. The session may be in progress; frames that are being written are then reported as not taken.

    Parameters
    ----------
    folder
        Folder of the session.
    workers
        Number of threads. None: all processors.

    Raises
    ------
    StorageError, FileFormatError
        If there is no session, or its ``session.json`` is damaged.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.acquire import iter_verify
    >>> from lfcal.base import drain
    >>> for file in drain(iter_verify(Path("recorded"))).files:
    ...     print(file.file, file.whole, "of", file.frames)
    recording.h5 627 of 627
    checks.h5 8 of 8
    darks.h5 1 of 1
    """
    session = SessionFile.read(folder)
    schedules = [session.schedule(run) for run in range(len(session.recordings))]
    clock, done = Clock("check frames", sum(len(schedule) for schedule in schedules)), 0
    checked: list[_Checked] = []
    yield clock.at(0)
    for run, schedule in enumerate(schedules):
        for kind, made in files_made(session, run, schedule).items():
            part = _Checked(file_name(kind, run), run, slots_of(schedule, kind))
            with opened(folder / part.file, made, session.identity) as (file, part.fault):
                if file is None:
                    part.states[:] = State.LOST
                else:
                    complete = not file.layout.in_place or session.was_complete(run)
                    for count in part.look(file, complete, worker_count(workers)):
                        yield clock.at(done + count)
            done += len(part.states)
            checked.append(part)
    yield clock.at(done)
    return _report(folder, session, checked)


verify = drained(
    iter_verify,
    """
    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.acquire import DamagedFrame, SessionReport, verify
    >>> report: SessionReport = verify(Path("recorded"))
    >>> damaged: tuple[DamagedFrame, ...] = report.damaged
    >>> print(report.ok, len(damaged), "damaged,", len(report.never_taken), "never taken")
    True 0 damaged, 0 never taken
    """,
)


class _Checked:
    """One file while it is checked."""

    def __init__(self, file: str, run: int, slots: Slots) -> None:
        self.file, self.run, self.slots, self.fault = file, run, slots, ""
        self.in_place = False
        self.states = np.full(len(slots.flat), State.WHOLE, np.uint8)

    def look(self, file: RecordingFile, complete: bool, workers: int) -> Iterator[int]:
        """Determine the states of all slots in several threads; yields the number of slots checked."""
        blank = ~file.records.view(np.uint8).reshape(len(file.records), -1).any(axis=1)
        self.states[~file.taken] = State.RECORD_DAMAGED
        # a recording that was once complete had a record in every slot
        self.states[blank] = State.LOST if complete else State.NEVER_TAKEN
        layout = file.layout
        self.in_place = layout.in_place
        if self.in_place:
            ends = layout.frames_at + layout.frame_bytes * np.arange(1, layout.count + 1)
            self.states[file.taken & (ends > file.path.stat().st_size)] = State.LOST
        misplaced = (file.records["index"] != self.slots.flat) | (file.records["kind"] != self.slots.kinds)
        self.states[file.taken & misplaced & (self.states == State.WHOLE)] = State.RECORD_DAMAGED
        block = max(workers, BLOCK_BYTES // layout.frame_bytes)
        with ThreadPoolExecutor(workers) as pool:
            for start in range(0, len(self.states), block):
                slots = start + np.flatnonzero(self.states[start : start + block] == State.WHOLE)
                whole = np.fromiter(pool.map(file.is_whole, slots.tolist()), np.bool_, len(slots))
                self.states[slots[~whole]] = State.FRAME_DAMAGED
                yield min(start + block, len(self.states))

    def report(self) -> FileReport:
        """Return the report on the file."""
        count = np.bincount(self.states, minlength=len(State))
        damaged = int(count[State.FRAME_DAMAGED] + count[State.RECORD_DAMAGED] + count[State.LOST])
        never, whole = int(count[State.NEVER_TAKEN]), int(count[State.WHOLE])
        return FileReport(self.file, len(self.states), whole, damaged, never, self.fault)

    def damaged(self, shape: tuple[int, ...]) -> Iterator[DamagedFrame]:
        """Yield the damaged frames; ``shape`` is the shape of the plan's grid of positions."""
        for slot in np.flatnonzero(self.states > State.NEVER_TAKEN).tolist():
            z, y, x = (int(k) for k in np.unravel_index(self.slots.flat[slot], shape))
            kind = Kind(int(self.slots.kinds[slot])).name.lower()
            yield DamagedFrame(self.file, slot, kind, Position(z, y, x), _STATE_WORDS[State(self.states[slot])])


def _report(folder: Path, session: SessionFile, checked: list[_Checked]) -> SessionReport:
    """Return the report on all files; of several recordings of a position, the newest is used."""
    shape = session.grid
    # the latest recording with an intact frame of the position, and the latest that will still take it
    newest, open_run = np.full(int(np.prod(shape)), -1), np.full(int(np.prod(shape)), -1)
    taken, wanted = np.zeros(len(newest), np.bool_), np.zeros(len(newest), np.bool_)
    for part in checked:
        if (part.slots.kinds == Kind.POSITION).all():
            wanted[part.slots.flat] = True
            newest[part.slots.flat[part.states == State.WHOLE]] = part.run
            open_run[part.slots.flat[(part.states != State.WHOLE) & part.in_place]] = part.run
            taken[part.slots.flat[part.states != State.NEVER_TAKEN]] = True
    damaged, pending = [], set()
    for part in checked:
        for found in part.damaged(shape):
            flat = np.ravel_multi_index(found.position, shape)
            is_position = found.kind == "position"
            damaged.append(replace(found, replaced=is_position and bool(newest[flat] > part.run)))
            if is_position and open_run[flat] > part.run:
                pending.add(found.position)
    never = tuple(Position(*p) for p in np.argwhere((wanted & ~taken).reshape(shape)).tolist())
    files = tuple(part.report() for part in checked)
    return SessionReport(folder, files, tuple(damaged), never, tuple(sorted(pending)), _lacking(session, taken))


def _lacking(session: SessionFile, taken: NDArray[np.bool_]) -> int:
    """Return the number of positions that the last run acknowledged but that are missing."""
    ended = [run for run in session.runs if run.ended]
    # later recordings number their own positions
    if len(session.recordings) > 1 or not ended:
        return 0
    return max(0, ended[-1].acknowledged - int(taken.sum()))


def iter_repair(folder: Path, session: SessionFile, report: SessionReport) -> Work[tuple[Position, ...]]:
    """Prepare the files of a session for taking damaged frames again; return the positions that need a new recording.

    Header and size of an unpacked file are restored if necessary. Packed dark and check frames are few, so their file
    is written again with the intact frames. A packed recording is not changed; its damaged positions are returned,
    except those that an unfinished later recording will take.

    Raises
    ------
    FileFormatError
        If a file is completely unreadable and must be restored from a copy.
    """
    damaged: set[str] = {found.file for found in report.damaged if not found.replaced}
    faults = {file.file: file for file in report.files if file.fault}
    packed: set[str] = set()
    for run in range(len(session.recordings)):
        for kind, made in files_made(session, run, session.schedule(run)).items():
            name = file_name(kind, run)
            if name in faults:
                if not faults[name].whole:
                    raise FileFormatError(f"{folder / name}: {faults[name].fault}; restore it from a copy")
                restore(folder / name, made)
            elif name in damaged and not _in_place(folder / name):
                if kind is Kind.POSITION:
                    packed.add(name)
                else:
                    yield from _iter_unpack(folder / name, report.slots(name))
    found = {d.position for d in report.damaged if d.file in packed and not d.replaced}
    return tuple(sorted(found - set(report.pending)))


def _in_place(path: Path) -> bool:
    with RecordingFile(path) as file:
        return file.layout.in_place


def _iter_unpack(path: Path, damaged: np.ndarray[tuple[int], np.dtype[np.int64]]) -> Work[None]:
    """Write a packed recording in place again, without its ``damaged`` slots; an incomplete file never replaces it."""
    with RecordingFile(path) as source, replace_whole(path) as part:
        layout = source.layout
        require_space(path.parent, layout.count * layout.frame_bytes, what=path.name)
        attributes = {key: v for key, v in layout.attributes.items() if key not in ("format", "version")}
        clock = Clock(f"unpack {path.name}", layout.count)
        journal = RecordingJournal.create(part, layout.count, layout.shape, layout.dtype, attributes)
        try:
            for slot in np.setdiff1d(np.flatnonzero(source.taken), damaged).tolist():
                yield clock.at(slot)
                journal.copy(slot, source.read(slot), source.records[slot])
            journal.sync()
        finally:
            journal.close()
        source.close()  # Windows cannot replace an open file
