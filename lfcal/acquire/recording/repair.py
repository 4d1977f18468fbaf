"""A damaged recording made ready to take its damaged frames again."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lfcal.acquire.recording._contents import files_made
from lfcal.acquire.recording._recovery import restore
from lfcal.acquire.recording._slots import RecordingJournal
from lfcal.acquire.recording._verify import SessionReport
from lfcal.acquire.recording.reader import RecordingFile
from lfcal.acquire.recording.records import Kind, file_name
from lfcal.acquire.session_file import SessionFile
from lfcal.base import Clock, FileFormatError, Work, replace_whole, require_space
from lfcal.frames import Position

__all__ = ["iter_repair"]


def iter_repair(folder: Path, session: SessionFile, report: SessionReport) -> Work[tuple[Position, ...]]:
    """Make the files of a session take their damaged frames again; return the positions that need a new recording.

    A file in place gets its header and its size back where it lacks them. Packed dark and check frames are few: their
    file is laid out in place again with what is whole. A packed recording stays as it is, and its damaged positions are
    returned, but for those that a later recording, begun and not finished, will take.

    Raises
    ------
    FileFormatError
        If nothing of a file can be read: it is better restored than recorded again unasked.
    """
    damaged: set[str] = {found.file for found in report.damaged if not found.replaced}
    faults = {file.file: file for file in report.files if file.fault}
    packed: set[str] = set()
    for run in range(len(session.recordings)):
        for kind, made in files_made(session, run, session.schedule(run)).items():
            name = file_name(kind, run)
            if name in faults:
                if not faults[name].whole:
                    raise FileFormatError.expected(
                        str(folder / name), "a file of this session", faults[name].fault, "restore this session's file"
                    )
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
    """Lay a packed recording out in place again, without its ``damaged`` slots; the file is replaced whole or not."""
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
        source.close()  # Windows replaces no file that is open
