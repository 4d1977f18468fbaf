"""What a job did, when, and what it warned of: lines to read, copy and save. No Qt."""

from __future__ import annotations

import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Protocol, runtime_checkable

from lfcal.base import Progress, format_seconds
from lfcal.judge import Judged, judgement_of
from lfcal_gui.models.job import plain_record

MOST = 1000
"""Lines kept of one job: solvers say something at every step."""

_sinks: dict[int, Callable[[str], None]] = {}
_shown: Callable[..., None] | None = None
"""What this module shows warnings by, once it does."""
_lock = threading.Lock()


@dataclass(frozen=True)
class Said:
    """One line: when (s since 1970), how long after the job began (s), of which kind, and the words."""

    at: float
    after: float
    kind: str
    words: str

    def line(self) -> str:
        """Return it as one line of text."""
        return f"{datetime.fromtimestamp(self.at):%H:%M:%S}  {self.after:9.2f} s  {self.kind:<8} {self.words}"


def _steady() -> Callable[[], float]:
    """Return a clock that begins with the system's (s since 1970) and runs evenly, also where that one is set."""
    offset = time.time() - time.monotonic()
    return lambda: offset + time.monotonic()


class JobLog:
    """The lines of one job; written by its thread, read by the window's.

    Parameters
    ----------
    title
        What the job is called.
    command
        The same as a command, empty if there is none.
    now
        Returns the time (s since 1970). By default the system's clock at the start of the job, continued with a
        monotonic clock.
    """

    def __init__(self, title: str, command: str = "", now: Callable[[], float] | None = None) -> None:
        self.title = title
        self._now = now or _steady()
        self._begun = self._now()
        self._lines: list[Said] = []
        self._dropped = 0
        self._stage: tuple[str, float] | None = None
        self._latest: Progress | None = None
        self._over = False
        self._lock = threading.Lock()
        self.say("begin", title)
        for line in command.splitlines():
            self.say("command", line)

    @property
    def warned(self) -> int:
        """Number of warnings."""
        return sum(line.kind == "warning" for line in self.lines())

    def say(self, kind: str, words: str) -> None:
        """Add a line; of more than `MOST` the oldest that the job said by the way go."""
        at = self._now()
        with self._lock:
            if self._over:  # an abandoned job runs for a while; drop its lines
                return
            self._lines.append(Said(at, at - self._begun, kind, words))
            if len(self._lines) > MOST:
                told = (k for k, line in enumerate(self._lines) if line.kind in ("note", "stage"))
                del self._lines[next(told, 0)]
                self._dropped += 1

    def follow(self, record: Progress) -> None:
        """Add what is new in a record: the end of a stage, with its time, and a note."""
        before, self._latest = self._latest, plain_record(record)
        if self._stage is None or self._stage[0] != record.stage:
            self._end_stage(before)
            self._stage = (record.stage, self._now())
        if record.note and (before is None or before.note != record.note):
            self.say("note", f"{record.stage}: {record.note}")

    def _end_stage(self, last: Progress | None) -> None:
        if self._stage is not None and last is not None:
            self.say("stage", f"{_far(last)} in {format_seconds(self._now() - self._stage[1])}")
        self._stage = None

    def end(self, words: str, details: str = "") -> None:
        """Add how it ended, and the traceback of an unexpected error."""
        self._end_stage(self._latest)
        self.say("end", words)
        for line in details.rstrip().splitlines():
            self.say("trace", line)
        self._over = True

    def go_on(self) -> None:
        """Reopen the log of a job that resumes."""
        self._over, self._latest = False, None
        self.say("begin", "resumed")

    def lines(self) -> tuple[Said, ...]:
        """Return the lines so far."""
        with self._lock:
            return tuple(self._lines)

    def text(self) -> str:
        """Return all of it, with the stage that is under way."""
        begun = datetime.fromtimestamp(self._begun)
        head = [f"{self.title}, begun {begun:%Y-%m-%d %H:%M:%S}"]
        if self._dropped:
            head.append(f"({self._dropped} notes are left out)")
        latest, under_way = self._latest, self._stage is not None and not self._over
        now = [f"now: {_far(latest)}"] if under_way and latest is not None else []
        return "\n".join((*head, *(line.line() for line in self.lines()), *now)) + "\n"


def _far(record: Progress) -> str:
    done = " done" if record.per > 1 else ""
    return record.stage + (f": {record.count}{done}" if record.count else "")


@runtime_checkable
class Noted(Protocol):
    """A result of a job that says something of itself."""

    notes: Any


def notes_of(result: Any) -> tuple[str, ...]:
    """Return what a result says of itself: the verdict on what was judged, and its ``notes``, if those are lines."""
    verdict = (judgement_of(result).verdict,) if isinstance(result, Judged) else ()
    notes = result.notes if isinstance(result, Noted) else ()
    lines = isinstance(notes, list | tuple) and all(isinstance(one, str) for one in notes)
    return (*verdict, *notes) if lines else verdict


@contextmanager
def warnings_to(sink: Callable[[str], None]) -> Iterator[None]:
    """Hand what is warned of in this thread to ``sink`` as well, while the context lasts."""
    thread = threading.get_ident()
    with _lock:
        _hook()
        _sinks[thread] = sink
    try:
        yield
    finally:
        with _lock:
            _sinks.pop(thread, None)


def _hook() -> None:
    """Route the warnings of each thread to its log. The previous handler still receives them."""
    global _shown
    before = warnings.showwarning
    if before is _shown:
        return

    def show(message: Any, category: Any, *rest: Any, **more: Any) -> None:
        sink = _sinks.get(threading.get_ident())
        if sink is not None:
            sink(f"{category.__name__}: {' '.join(str(message).split())}")
        before(message, category, *rest, **more)

    warnings.showwarning = _shown = show
