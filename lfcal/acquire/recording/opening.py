"""Open the frames of a session of any kind."""

from __future__ import annotations

from pathlib import Path

from lfcal.acquire.recording.source import RecordingSource, TargetRecording
from lfcal.acquire.session_file import NAME, SessionFile
from lfcal.frames.sources import FrameOptions, SourceKind

__all__ = ["SOURCE", "open_session"]


def open_session(folder: Path, *, skip_damaged: bool = False) -> RecordingSource:
    """Open the session in ``folder``, and return the source of its frames.

    For a session of a target, it is a `TargetRecording` of whole frames, else a `RecordingSource` of cutouts.
    ``skip_damaged`` is as in `RecordingSource`.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.acquire import RecordingSource, open_session
    >>> session: RecordingSource
    >>> with open_session(Path("recorded")) as session:
    ...     print(len(session), "frames of", session.dtype, "- the first at", tuple(session.info(0).position))
    627 frames of uint16 - the first at (0, 0, 0)
    """
    kind = RecordingSource if SessionFile.read(folder).target is None else TargetRecording
    return kind(folder, skip_damaged=skip_damaged)


def _open(path: Path, options: FrameOptions) -> RecordingSource:
    options.refuse("recorded session", "skip_damaged")
    return open_session(path, skip_damaged=options.skip_damaged)


SOURCE = SourceKind("recorded session", lambda path: (path / NAME).is_file(), _open)
