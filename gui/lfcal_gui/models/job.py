"""A piece of long work as the window knows it, and what it leaves where it ends early. No Qt."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, fields, replace
from enum import Enum
from typing import Any, Protocol

from lfcal.base import Progress, format_seconds
from lfcal_gui.models.history import Taken


def plain_record(record: Progress) -> Progress:
    """Return the progress of ``record`` without its other data, such as a volume so far."""
    return Progress(*(getattr(record, one.name) for one in fields(Progress)))


class JobState(Enum):
    """State of a job, with the word shown for it."""

    WAITING = "waiting"
    RUNNING = "running"
    DONE = "done"
    CANCELLED = "stopped"
    FAILED = "failed"


class Keeping(Protocol):
    """What a job keeps of its work if it ends early, so that it can resume. Not called in the window's thread."""

    @property
    def out(self) -> str:
        """What the job makes: of two jobs that make the same, what the earlier one has left is the later one's."""
        ...

    def look(self) -> str:
        """Return what is kept, such as ``"12 of 40 planes"``; empty where nothing is, and then nothing stays."""
        ...

    def discard(self) -> None:
        """Free it; raises `LfcalError` where that cannot be done."""
        ...


@dataclass(frozen=True)
class WindowJob:
    """State of a job in the window.

    Attributes
    ----------
    number, title, page
        Identity; ``page`` is the key of the page it belongs to.
    kind
        One of `lfcal_gui.models.next_step.JOBS` where the line of the next step follows it, else empty.
    state, progress
        How far it is.
    result
        Its result, for the receivers of its end only; it is not stored.
    stopping
        Whether it was asked to stop; it may take a while to clean up.
    error, details
        One line in words, and the trace to copy, when failed.
    kept
        What is kept of its work if it ended early, to resume or to discard; empty if nothing.
    taken
        Its step in the history of the session, None if it has none.
    started
        When it started, or was requested if it still waits (s, `time.monotonic`).
    before_s
        Seconds of the parts that ended before the part of the last progress. Each part has its own clock.
    """

    number: int
    title: str
    page: str
    kind: str = ""
    state: JobState = JobState.WAITING
    progress: Progress | None = None
    result: Any = None
    stopping: bool = False
    error: str = ""
    details: str = ""
    kept: str = ""
    taken: Taken | None = field(default=None, repr=False)
    started: float = field(default_factory=time.monotonic)
    before_s: float = 0.0

    @property
    def active(self) -> bool:
        """Whether the job waits or runs."""
        return self.state in (JobState.WAITING, JobState.RUNNING)

    def remembered(self) -> WindowJob:
        """Return the job without what it made, which its last record may hold, too: a volume, a chart."""
        return replace(self, result=None, progress=None if self.progress is None else plain_record(self.progress))

    def ended_words(self) -> str:
        """Return how it ended, with the time it took, or what is kept of it."""
        seconds = self.before_s + (0.0 if self.progress is None else self.progress.seconds)
        took = "" if self.progress is None else format_seconds(seconds)
        if self.state is JobState.FAILED:
            return f"failed: {self.error}" + (f"; {self.kept} are kept" if self.kept else "")
        if self.state is JobState.CANCELLED and self.kept:
            return f"stopped after {self.kept}"
        if self.state is JobState.CANCELLED:
            return f"stopped after {took}" if seconds else "stopped"
        return f"done in {took}" if took else "done"
