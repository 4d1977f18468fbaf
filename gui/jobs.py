"""What the window does in threads: long work as jobs, quick computations, files that are opened.

Stale results are dropped. Threads never touch Qt. They put records into a queue; a timer in the window's thread takes
them out and emits signals there.
"""

from __future__ import annotations

import itertools
import queue
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any

from PySide6.QtCore import QObject, QTimer, Signal

from gui.garbage import Collector
from gui.loads import Loads
from gui.models.history import Taken
from gui.models.job_log import JobLog, notes_of, warnings_to
from gui.workers import Workers, keep, wait_for, words_of
from lfcal.errors import Cancelled
from lfcal.progress import Progress, Work
from lfcal.units import format_seconds

__all__ = ["JOBS_S", "Job", "JobState", "Jobs"]

POLL_MS = 8
TELL_S = 0.03
"""Between two records of a job that are told (s)."""

JOBS_S, COMPUTATIONS_S, LOADS_S = 30.0, 5.0, 1.0
"""How long closing waits for jobs, which clean up behind themselves, for computations, and for files (s)."""


class JobState(Enum):
    """State of a job, with the word shown for it."""

    WAITING = "waiting"
    RUNNING = "running"
    DONE = "done"
    CANCELLED = "stopped"
    FAILED = "failed"


@dataclass(frozen=True)
class Job:
    """What the window knows of a piece of long work.

    Attributes
    ----------
    number, title, page
        Identity; ``page`` is the key of the page it belongs to.
    state, progress
        How far it is.
    result
        What it returned, for those who are told of its end; it is not remembered.
    stopping
        Whether it was asked to stop; it may take a while to clean up.
    error, details
        One line in words, and the trace to copy, when failed.
    taken
        What it does as a step of the sitting's history, None if it is none.
    before_s
        Seconds of its parts that were over before that of the last progress, each with a clock of its own.
    """

    number: int
    title: str
    page: str
    state: JobState = JobState.WAITING
    progress: Progress | None = None
    result: Any = None
    stopping: bool = False
    error: str = ""
    details: str = ""
    taken: Taken | None = field(default=None, repr=False)
    started: float = field(default_factory=time.monotonic)
    before_s: float = 0.0

    @property
    def active(self) -> bool:
        """Whether the job waits or runs."""
        return self.state in (JobState.WAITING, JobState.RUNNING)

    def ended_words(self) -> str:
        """Return how it ended, with the time it took."""
        seconds = self.before_s + (0.0 if self.progress is None else self.progress.seconds)
        took = "" if self.progress is None else format_seconds(seconds)
        if self.state is JobState.FAILED:
            return f"failed: {self.error}"
        if self.state is JobState.CANCELLED:
            return f"stopped after {took}" if seconds else "stopped"
        return f"done in {took}" if took else "done"


class Jobs(QObject):
    """Run `lfcal.progress.Work` in threads; report in the window's thread."""

    changed = Signal(object)
    """A `Job`, whenever one of its fields changes."""

    finished = Signal(object)
    """A `Job` that is done, stopped or failed."""

    trouble = Signal(str)
    """Why a computation failed whose caller did not ask to be told."""

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._queue: queue.SimpleQueue[tuple[str, Any]] = queue.SimpleQueue()
        self._numbers = itertools.count(1)
        self._jobs: dict[int, Job] = {}
        self._logs: dict[int, JobLog] = {}
        self._before_s: dict[int, float] = {}
        self._newest: dict[int, Progress] = {}  # put there by the threads of jobs, taken out by the window's
        self._told: dict[int, float] = {}
        self._stops: dict[int, threading.Event] = {}
        self._threads: dict[int, threading.Thread] = {}
        self._callbacks: dict[int, tuple[Callable[[Any], None] | None, Callable[[Job], None] | None]] = {}
        self._workers = Workers(2, "lfcal-compute")
        self._opening: set[int] = set()
        self._left: set[int] = set()
        self._abandoned: list[threading.Thread] = []
        self._loads = Loads(lambda call: self._queue.put(("call", call)))
        self._generation: dict[str, int] = {}
        self._pending: dict[str, int] = {}
        self._timer = QTimer(self)
        self._timer.setInterval(POLL_MS)
        self._timer.timeout.connect(self._take)
        self._closed = False
        self._collector = Collector(self)  # threads must not destroy widgets

    # -- long work -------------------------------------------------------------------------------------
    def start(
        self,
        title: str,
        page: str,
        work: Callable[[], Work[Any]],
        on_done: Callable[[Any], None] | None = None,
        on_failed: Callable[[Job], None] | None = None,
        *,
        abandon: bool = False,
        leave: bool = False,
        taken: Taken | None = None,
    ) -> int:
        """Run ``work()`` in a thread of its own; return the job's number.

        ``abandon``: until its first record it only opens files, so that stopping it then need not wait for it.
        ``leave``: it writes nothing at all and may compute for long between two records; stopping never waits for it.
        ``taken``: what enters the history if it ends well.
        """
        number = next(self._numbers)
        job = Job(number, title, page, taken=taken)
        self._jobs[number] = job
        step = None if taken is None else taken.step
        self._logs[number] = JobLog(title, "" if step is None else step.shell())
        self._stops[number] = threading.Event()
        self._callbacks[number] = (on_done, on_failed)
        if abandon:
            self._opening.add(number)
        if leave:
            self._left.add(number)
        thread = threading.Thread(target=self._run, args=(number, work), name=f"lfcal-job-{number}", daemon=True)
        self._threads[number] = thread
        self._timer.start()
        self.changed.emit(job)
        thread.start()
        return number

    def _run(self, number: int, work: Callable[[], Work[Any]]) -> None:
        log = self._logs[number]
        with warnings_to(lambda words: log.say("warning", words)):
            self._follow(number, work, log)

    def _follow(self, number: int, work: Callable[[], Work[Any]], log: JobLog) -> None:
        stop, last = self._stops[number], 0.0
        try:
            running = work()
            try:
                while True:
                    record = next(running)
                    log.follow(record)
                    if stop.is_set():
                        raise Cancelled("stopped")
                    if record.seconds < last:  # another clock
                        self._before_s[number] = self._before_s.get(number, 0.0) + last
                    last = record.seconds
                    self._newest[number] = record
            except StopIteration as end:
                self._queue.put(("done", (number, end.value)))
            finally:
                running.close()
        except Cancelled:
            self._queue.put(("cancelled", (number,)))
        except BaseException as error:
            keep(f"job {number}", error)
            self._queue.put(("failed", (number, words_of(error), traceback.format_exc())))

    def log(self, number: int) -> JobLog:
        """Return what a job did and said so far."""
        return self._logs[number]

    def cancel(self, number: int) -> None:
        """Ask a job to stop; it cleans up behind itself."""
        if number in self._stops:
            if not self._stops[number].is_set():
                self._logs[number].say("stop", "asked to stop")
            self._stops[number].set()
            opening = number in self._opening and self._jobs[number].progress is None
            if opening or number in self._left:
                self._abandoned.append(self._threads[number])
                self._end(number, join_s=0, state=JobState.CANCELLED)
            elif not self._jobs[number].stopping:
                self._change(number, stopping=True)

    def jobs(self) -> list[Job]:
        """Return all jobs since the start, newest first."""
        return sorted(self._jobs.values(), key=lambda job: -job.number)

    def running_pages(self) -> set[str]:
        """Return the keys of the pages that have a job at work."""
        return {job.page for job in self._jobs.values() if job.active}

    @property
    def busy(self) -> bool:
        """Whether a job or a computation is at work, or its result waits to be shown."""
        at_work = bool(self._loads) or any(self._pending.values())
        return at_work or any(job.active for job in self._jobs.values())

    # -- quick computations ----------------------------------------------------------------------------
    def compute(
        self,
        group: str,
        function: Callable[[], Any],
        on_result: Callable[[Any], None],
        on_error: Callable[[str], None] | None = None,
    ) -> None:
        """Compute in the background; only the newest request of a ``group`` reports.

        While one request of the group is being computed, at most one more waits: the newest.
        """
        if self._closed:
            return
        generation = self._next(group)
        self._workers.submit(lambda: self._compute(group, generation, function, on_result, on_error))
        self._pending[group] = self._pending.get(group, 0) + 1
        self._timer.start()

    def _next(self, group: str) -> int:
        self._generation[group] = self._generation.get(group, 0) + 1
        return self._generation[group]

    def _compute(
        self,
        group: str,
        generation: int,
        function: Callable[[], Any],
        on_result: Callable[[Any], None],
        on_error: Callable[[str], None] | None,
    ) -> None:
        if self._generation.get(group) != generation or self._closed:
            self._queue.put(("stale", group))
            return
        try:
            self._queue.put(("result", (group, generation, on_result, function())))
        except BaseException as error:
            keep(group, error)
            self._queue.put(("error", (group, generation, on_error, words_of(error))))

    # -- opening files ---------------------------------------------------------------------------------
    def load(
        self,
        group: str,
        function: Callable[[], Any],
        on_result: Callable[[Any], None],
        on_error: Callable[[str], None] | None = None,
        discard: Callable[[Any], None] | None = None,
    ) -> None:
        """Open something in a thread of its own, which a disk that does not answer may keep for ever.

        Only the newest request of a ``group`` reports. It waits for an earlier one unless that is dropped; what comes
        too late is handed to ``discard``.
        """
        if not self._closed:
            self._loads.start(group, function, on_result, on_error or self.trouble.emit, discard)
            self._timer.start()

    def loading(self, group: str) -> bool:
        """Return whether something of the group is being opened."""
        return group in self._loads

    def drop(self, group: str) -> None:
        """Wait no longer for what is being opened."""
        self._loads.drop(group)

    # -- the window's thread ---------------------------------------------------------------------------
    def _take(self) -> None:
        while True:
            try:
                kind, data = self._queue.get_nowait()
            except queue.Empty:
                break
            if kind in ("done", "cancelled", "failed"):  # how far it came, and how long a short job took
                self._tell(data[0], ended=kind == "done")
            self._handle(kind, data)
        for number in tuple(self._newest):
            if time.monotonic() - self._told.get(number, 0.0) > TELL_S:
                self._tell(number)
        if not self.busy:
            self._timer.stop()

    def _tell(self, number: int, *, ended: bool = False) -> None:
        """Tell the newest record of a job; it is never dropped: the next may be long in coming."""
        record = self._newest.pop(number, None)
        if record is None or not self._jobs[number].active:
            return
        self._told[number] = time.monotonic()
        state = self._jobs[number].state if ended else JobState.RUNNING
        self._change(number, state=state, progress=record)

    def _handle(self, kind: str, data: Any) -> None:
        if kind == "call":
            data()
        elif kind in ("result", "error"):
            group, generation, callback, value = data
            self._pending[group] -= 1
            if self._generation.get(group) == generation and not self._closed:
                (callback or self.trouble.emit)(value)
        elif kind == "stale":
            self._pending[data] -= 1
        elif kind == "done":
            self._end(data[0], state=JobState.DONE, result=data[1])
        elif kind == "cancelled":
            self._end(data[0], state=JobState.CANCELLED)
        elif kind == "failed":
            number, words, details = data
            self._end(number, state=JobState.FAILED, error=words, details=details)

    def _change(self, number: int, **changes: Any) -> Job:
        job = replace(self._jobs[number], **changes)
        self._jobs[number] = job
        self.changed.emit(job)
        return job

    def _end(self, number: int, join_s: float = 5, **changes: Any) -> None:
        if not self._jobs[number].active:  # it was abandoned before
            return
        job = self._change(number, before_s=self._before_s.pop(number, 0.0), **changes)
        self._log_end(job)
        self._opening.discard(number)
        self._left.discard(number)
        self._threads.pop(number).join(join_s)
        self._stops.pop(number)
        on_done, on_failed = self._callbacks.pop(number)
        # jobs are remembered as long as the window; what they made is not
        self._jobs[number] = replace(job, result=None)
        if self._closed:
            return
        try:
            if job.state is JobState.DONE and on_done is not None:
                on_done(job.result)
            elif job.state is JobState.FAILED and on_failed is not None:
                on_failed(job)
        finally:  # whoever waits for the end hears of it, whatever its result met with
            self.finished.emit(job)

    def _log_end(self, job: Job) -> None:
        log = self._logs[job.number]
        for note in notes_of(job.result):
            log.say("note", note)
        if job.state is JobState.DONE and job.taken is not None and job.taken.out:
            log.say("wrote", job.taken.out)
        log.end(job.ended_words(), job.details)

    def close(self, wait_s: float = JOBS_S) -> None:
        """Stop everything and wait for the threads, for jobs at most ``wait_s``; nothing reports afterwards."""
        self._closed = True
        for stop in self._stops.values():
            stop.set()
        wait_for([thread for number, thread in self._threads.items() if number not in self._left], wait_s)
        wait_for([*self._abandoned, *(self._threads[number] for number in self._left)], LOADS_S)
        self._loads.close(LOADS_S)
        self._workers.close(COMPUTATIONS_S)
        self._timer.stop()
        self._collector.close()
