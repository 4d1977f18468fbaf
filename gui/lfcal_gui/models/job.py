"""Jobs of the window: their state, their logs, and the partial results they keep if they end early. No Qt."""

from __future__ import annotations

import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, fields, replace
from datetime import datetime
from enum import Enum
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from lfcal.base import InputError, LfcalError, Progress, format_seconds
from lfcal.judge import Judged, judgement_of
from lfcal.work import PASS, RunChoice, RunState, discard, parts_folder, read_events, read_run, stamp_of
from lfcal_gui.models.history import Taken


def plain_record(record: Progress) -> Progress:
    """Return the progress of ``record`` without other data, such as an intermediate volume."""
    return Progress(*(getattr(record, one.name) for one in fields(Progress)))


class JobState(Enum):
    """State of a job; the value is the displayed word."""

    WAITING = "waiting"
    RUNNING = "running"
    DONE = "done"
    CANCELLED = "stopped"
    FAILED = "failed"


class Keeping(Protocol):
    """Partial results of a job that ended early, from which it can resume. Not called in the window's thread."""

    @property
    def out(self) -> str:
        """Output of the job; a later job with the same output takes over the partial results of an earlier one."""
        ...

    def look(self) -> str:
        """Return what is kept as text, such as ``"12 of 40 planes"``; empty if nothing, after removing all files."""
        ...

    def discard(self) -> None:
        """Delete the partial results; raise `LfcalError` if that fails."""
        ...


@dataclass(frozen=True)
class WindowJob:
    """State of a job in the window.

    Attributes
    ----------
    number, title, page
        Number and title of the job, and key of its page.
    kind
        One of `lfcal_gui.models.next_step.JOBS` if the line of the next step shows it, else empty.
    state, progress
        State and latest progress.
    result
        Result, passed only to the receivers of its end; it is not stored.
    stopping
        Whether a stop was requested; cleaning up may take a while.
    error, details
        If it failed: the error in one line, and the traceback.
    kept
        Partial results kept after an early end, to resume or discard; empty if there are none.
    taken
        Its step in the history; None if it has none.
    started
        Time of its start or, while it waits, of its request (s, `time.monotonic`).
    before_s
        Duration (s) of the parts that ended before the current part. Each part has its own clock.
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
        """Return the job without its result, which its last progress record may contain as well."""
        return replace(self, result=None, progress=None if self.progress is None else plain_record(self.progress))

    def ended_words(self) -> str:
        """Return how the job ended, with its duration or its partial results, as text."""
        seconds = self.before_s + (0.0 if self.progress is None else self.progress.seconds)
        took = "" if self.progress is None else format_seconds(seconds)
        if self.state is JobState.FAILED:
            return f"failed: {self.error}" + (f"; {self.kept} are kept" if self.kept else "")
        if self.state is JobState.CANCELLED and self.kept:
            return f"stopped after {self.kept}"
        if self.state is JobState.CANCELLED:
            return f"stopped after {took}" if seconds else "stopped"
        return f"done in {took}" if took else "done"


MOST = 1000
"""Largest number of lines kept per job; solvers write a line at each step."""

_sinks: dict[int, Callable[[str], None]] = {}
_shown: Callable[..., None] | None = None
"""Warning handler of this module, once it is installed."""
_lock = threading.Lock()


@dataclass(frozen=True)
class Said:
    """One line of a log: time (s since 1970), time since the start of the job (s), kind and text."""

    at: float
    after: float
    kind: str
    words: str

    def line(self) -> str:
        """Return the line as text."""
        return f"{datetime.fromtimestamp(self.at):%H:%M:%S}  {self.after:9.2f} s  {self.kind:<8} {self.words}"


def _steady() -> Callable[[], float]:
    """Return a clock (s since 1970) that starts at the system time and is not affected by later changes of it."""
    offset = time.time() - time.monotonic()
    return lambda: offset + time.monotonic()


class JobLog:
    """Log of one job, written by its thread and read by the thread of the window.

    Parameters
    ----------
    title
        Title of the job.
    command
        The equivalent command; empty if there is none.
    now
        Function that returns the time (s since 1970). None: the system's time at the start of the job, continued with
        a monotonic clock.
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
        """Add a line; if there are more than `MOST`, drop the oldest minor ones."""
        at = self._now()
        with self._lock:
            if self._over:  # an abandoned job runs for a while; drop its lines
                return
            self._lines.append(Said(at, at - self._begun, kind, words))
            if len(self._lines) > MOST:
                noted = (k for k, line in enumerate(self._lines) if line.kind in ("note", "stage"))
                del self._lines[next(noted, 0)]
                self._dropped += 1

    def follow(self, record: Progress) -> None:
        """Add the news of a progress record: the end of a stage with its duration, or a note."""
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
        """Add how the job ended, and the traceback of an unexpected error."""
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
        """Return the complete log as text, with the current stage."""
        begun = datetime.fromtimestamp(self._begun)
        head = [f"{self.title}, begun {begun:%Y-%m-%d %H:%M:%S}"]
        if self._dropped:
            head.append(f"({self._dropped} notes are omitted)")
        latest, under_way = self._latest, self._stage is not None and not self._over
        now = [f"now: {_far(latest)}"] if under_way and latest is not None else []
        return "\n".join((*head, *(line.line() for line in self.lines()), *now)) + "\n"


def _far(record: Progress) -> str:
    done = " done" if record.per > 1 else ""
    return record.stage + (f": {record.count}{done}" if record.count else "")


@runtime_checkable
class Noted(Protocol):
    """Result of a job that has notes."""

    notes: Any


def notes_of(result: Any) -> tuple[str, ...]:
    """Return the notes of a result: its verdict, and its ``notes`` if they are lines of text."""
    verdict = (judgement_of(result).verdict,) if isinstance(result, Judged) else ()
    notes = result.notes if isinstance(result, Noted) else ()
    lines = isinstance(notes, list | tuple) and all(isinstance(one, str) for one in notes)
    return (*verdict, *notes) if lines else verdict


@contextmanager
def warnings_to(sink: Callable[[str], None]) -> Iterator[None]:
    """Also pass the warnings of this thread to ``sink`` while the context is active."""
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


def going_on() -> RunChoice:
    """Return how the window runs units: in its own process, resuming an earlier run of the same work."""
    return RunChoice("threads", begun="resume")


def stamp_of_files(*places: str, but: str) -> str:
    """Return a stamp that changes with the files of folders and lists. The output file ``but`` does not count.

    Only the recorded files of a session count: its folder often holds results, too.
    """
    from lfcal.frames import RECORDINGS, files_of

    made, found = Path(but).absolute(), set()
    for place in places:
        files = [path.absolute() for path in files_of(place) if path.is_file()]
        if place and (Path(place) / "session.json").is_file():
            files = [path for path in files if path.name.startswith((*RECORDINGS, "session"))]
        found |= set(files)
    return stamp_of(sorted(str(path) for path in found - {made}))


@dataclass(frozen=True)
class KeptRun:
    """Finished units of a run as partial results; see `lfcal_gui.models.job.Keeping`.

    Attributes
    ----------
    out
        The output file.
    """

    out: str

    def look(self) -> str:
        """Return the number of finished units as text; if no unit is finished, remove the folder of the run."""
        try:
            state = read_run(parts_folder(self.out))
        except InputError:  # it ended before the first unit
            return ""
        if state.running:  # run by another window, or by a command
            return ""
        which = state.title.rpartition(", ")[2]  # "simulate H.h5, pass 2 of 4"
        of_which = f" of {which}" if which.startswith(f"{PASS} ") else ""
        if state.count("done") or PASS in read_events(parts_folder(self.out)):
            return f"{state.count('done')} of {len(state.units)} {_kind(state)}{of_which}"
        with suppress(LfcalError):
            self.discard()
        return ""

    def discard(self) -> None:
        """Remove the units' files."""
        discard(parts_folder(self.out))


def _kind(state: RunState) -> str:
    """Return the plural name of the units, such as planes for units called ``"plane 0003"``."""
    kinds = {unit.name.rsplit(" ", 1)[0] for unit in state.units} or {"plane"}
    return f"{kinds.pop()}s" if len(kinds) == 1 else "units"
