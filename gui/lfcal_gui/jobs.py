"""Long work as jobs, each in its own thread. Heavy jobs run one after the other, in a queue.

Threads never touch Qt: they store their records. A timer in the window's thread reads these and emits signals.
"""

from __future__ import annotations

import itertools
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from PySide6.QtCore import QObject, Signal

from lfcal.base import Cancelled, InputError, LfcalError, Progress, Work, WorkAbandoned, abandonable
from lfcal_gui._background import COMPUTATIONS_S, LOADS_S, BackgroundThreads
from lfcal_gui.models import JobLog, JobState, Keeping, Stamp, Taken, WindowJob, notes_of, stamp_of, warnings_to
from lfcal_gui.workers import keep, wait_for, words_of


class Line:
    """Queue of jobs by their numbers.

    Attributes
    ----------
    at_work
        The running job of the queue; None if there is none.
    """

    def __init__(self) -> None:
        self._waiting: list[int] = []
        self.at_work: int | None = None

    @property
    def waiting(self) -> tuple[int, ...]:
        """The queued jobs, the next one first."""
        return tuple(self._waiting)

    def add(self, number: int) -> None:
        """Add a job at the end of the queue."""
        self._waiting.append(number)

    def next(self) -> int | None:
        """Return the next job to start; None if a job is running or none is queued."""
        if self.at_work is not None or not self._waiting:
            return None
        self.at_work = self._waiting.pop(0)
        return self.at_work

    def leave(self, number: int) -> None:
        """Remove a job that has ended, or that no longer has to run."""
        if number == self.at_work:
            self.at_work = None
        elif number in self._waiting:
            self._waiting.remove(number)

    def move(self, number: int, by: int) -> bool:
        """Move a queued job ``by`` places, later if positive; return whether this changed the order."""
        if number not in self._waiting:
            return False
        at = self._waiting.index(number)
        to = min(max(at + by, 0), len(self._waiting) - 1)
        self._waiting.insert(to, self._waiting.pop(at))
        return to != at


@dataclass(frozen=True)
class JobRequest:
    """Request of a job, from which it starts, and resumes after a stop.

    ``work`` returns the work, and is called in the job's thread. ``on_done`` gets the result, ``on_failed`` and
    ``on_end`` get the job. ``before`` is called in the window's thread right before the job begins. ``needs`` are
    stamps of the files that the job reads, at the time of the request. The other fields are as in `Jobs.start`.
    """

    work: Callable[[], Work[Any]]
    on_done: Callable[[Any], None] | None = None
    on_failed: Callable[[WindowJob], None] | None = None
    on_end: Callable[[WindowJob], None] | None = None
    before: Callable[[], None] | None = None
    abandon: bool = False
    leave: bool = False
    at_once: bool = False
    keeping: Keeping | None = None
    needs: tuple[Stamp, ...] = field(default=())

    def check(self) -> None:
        """Raise `InputError` if a file has changed since the job was requested."""
        for stamp in self.needs:
            if stamp_of(stamp[0]) != stamp:
                name = Path(stamp[0]).name
                raise InputError.expected(
                    name,
                    "the file as it was when the job was started",
                    "a changed or missing file",
                    "start the job again",
                )

    @staticmethod
    def stamps(paths: Iterable[str]) -> tuple[Stamp, ...]:
        """Return the stamps of files. Missing files are omitted, because the work itself reports them."""
        return tuple(found for path in paths if (found := stamp_of(path)) is not None)


class JobThread:
    """Run the work of a job, and record its progress.

    ``ended`` is called with the job's number and the fields of the `WindowJob` that its end changes. ``stop`` is set
    when the job must end. ``before_s`` counts the seconds of its finished parts.
    """

    def __init__(
        self, number: int, asked: JobRequest, log: JobLog, ended: Callable[[int, dict[str, Any]], None]
    ) -> None:
        self.number, self.asked, self._log, self._ended = number, asked, log, ended
        self.stop = threading.Event()
        self.before_s, self.reported = 0.0, 0.0
        self._newest: deque[Progress] = deque(maxlen=1)
        self.thread = threading.Thread(target=self._run, name=f"lfcal-job-{number}", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self.thread.start()

    def take(self) -> Progress | None:
        """Return the newest progress record; None if it was already returned."""
        try:
            return self._newest.pop()
        except IndexError:
            return None

    def _run(self) -> None:
        end: dict[str, Any]
        with warnings_to(lambda words: self._log.say("warning", words)):
            try:
                end = {"state": JobState.DONE, "result": self._follow()}
            except (Cancelled, WorkAbandoned):
                end = {"state": JobState.CANCELLED, "kept": self._kept()}
            except BaseException as error:
                keep(f"job {self.number}", error)
                trace = traceback.format_exc()
                end = {"state": JobState.FAILED, "error": words_of(error), "details": trace, "kept": self._kept()}
        self._ended(self.number, end)

    def _follow(self) -> Any:
        self.asked.check()
        running, last = self.asked.work(), 0.0
        try:
            while True:
                with abandonable(lambda: not (self.asked.leave and self.stop.is_set())):
                    record = next(running)
                self._log.follow(record)
                if self.stop.is_set():
                    raise Cancelled("stopped")
                if record.seconds < last:  # another clock
                    self.before_s += last
                last = record.seconds
                self._newest.append(record)
        except StopIteration as end:
            return end.value
        finally:
            running.close()

    def _kept(self) -> str:
        """Return a description of the partial results that the work has left; empty if there are none."""
        try:
            return "" if self.asked.keeping is None else self.asked.keeping.look()
        except (LfcalError, OSError) as error:
            keep(f"job {self.number}", error)
            return ""


TELL_S = 0.03
"""Shortest time between two reported progress records of a job (s)."""

JOBS_S = 30.0
"""Longest time that closing waits for jobs to clean up (s)."""

WAITS = "waiting for other jobs; Jobs shows the order"
"""Status shown for a queued job."""


class Jobs(BackgroundThreads):
    """Run `lfcal.base.progress.Work` in threads, and report in the window's thread."""

    changed = Signal(object)
    """A `WindowJob`, whenever one of its fields changes."""

    finished = Signal(object)
    """A `WindowJob` that is done, stopped or failed."""

    queued = Signal()
    """The queue has changed."""

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._numbers = itertools.count(1)
        self._jobs: dict[int, WindowJob] = {}
        self._logs: dict[int, JobLog] = {}
        self._asked: dict[int, JobRequest] = {}  # of jobs that run, wait, or can resume
        self._running: dict[int, JobThread] = {}
        self._line = Line()
        self._abandoned: list[threading.Thread] = []

    # -- long work -------------------------------------------------------------------------------------
    def start(
        self,
        title: str,
        page: str,
        work: Callable[[], Work[Any]],
        on_done: Callable[[Any], None] | None = None,
        on_failed: Callable[[WindowJob], None] | None = None,
        *,
        kind: str = "",
        on_end: Callable[[WindowJob], None] | None = None,
        before: Callable[[], None] | None = None,
        abandon: bool = False,
        leave: bool = False,
        at_once: bool = False,
        keeping: Keeping | None = None,
        needs: Iterable[str] = (),
        taken: Taken | None = None,
    ) -> int:
        """Run ``work()`` in its own thread when its turn comes; return the job's number.

        Parameters
        ----------
        title, page, kind
            Title of the job, key of its page, and its kind as in `WindowJob`.
        work, on_done, on_failed, on_end, before
            As in `lfcal_gui.jobs.JobRequest`.
        abandon
            Whether the job only opens files before its first record. Until then, stopping does not wait for it.
        leave
            Whether the job writes nothing and may compute long between two records. Stopping never waits for it.
        at_once
            Whether the job skips the queue, because it is short, or uses devices that do not wait.
        keeping
            Partial results of the job if it ends early.
        needs
            Files that the job reads. If one of them has changed when the turn of the job comes, the job fails.
        taken
            Entry of the history if the job succeeds.
        """
        number = next(self._numbers)
        stamps = JobRequest.stamps(needs)
        asked = JobRequest(work, on_done, on_failed, on_end, before, abandon, leave, at_once, keeping, stamps)
        if keeping is not None:
            self._take_over(keeping)
        self._jobs[number] = WindowJob(number, title, page, kind, taken=taken)
        step = None if taken is None else taken.step
        self._logs[number] = JobLog(title, "" if step is None else step.shell())
        self._asked[number] = asked
        self._enter(number)
        return number

    def _enter(self, number: int) -> None:
        """Start a job, or add it to the queue."""
        if self._leaving:
            self._end(number, state=JobState.CANCELLED)
            return
        if self._asked[number].at_once:
            self.changed.emit(self._jobs[number])
            self._begin(number)
            return
        self._line.add(number)
        self.changed.emit(self._jobs[number])
        self._advance()
        self.queued.emit()

    def _advance(self) -> None:
        """Start the next job of the queue if none is running."""
        number = None if self._closed or self._leaving else self._line.next()
        if number is not None:
            self._begin(number)
            self.queued.emit()

    def _begin(self, number: int) -> None:
        asked = self._asked[number]
        if asked.before is not None:
            asked.before()
        self._timer.start()
        running = self._running[number] = JobThread(number, asked, self._logs[number], self._ended)
        running.start()
        self._change(number, state=JobState.RUNNING, started=time.monotonic())

    def log(self, number: int) -> JobLog:
        """Return the log of a job."""
        return self._logs[number]

    def cancel(self, number: int) -> None:
        """Ask a running job to stop and clean up, or remove a queued one. Unknown numbers, such as 0, are ignored."""
        if number not in self._jobs or not self._jobs[number].active:
            return
        running = self._running.get(number)
        if running is None:
            self._logs[number].say("stop", "removed from the queue")
            self._end(number, state=JobState.CANCELLED)
            return
        if not running.stop.is_set():
            self._logs[number].say("stop", "stop requested")
        running.stop.set()
        opening = running.asked.abandon and self._jobs[number].progress is None
        if opening or running.asked.leave:
            self._abandoned.append(running.thread)
            self._show_progress(running)
            self._end(number, join_s=0, state=JobState.CANCELLED)
        elif not self._jobs[number].stopping:
            self._change(number, stopping=True)

    def cancel_all(self) -> None:
        """Ask all jobs to stop, first the queued ones, because otherwise the next of them would start."""
        for number in (*self._line.waiting, *self._running):
            self.cancel(number)

    def jobs(self) -> list[WindowJob]:
        """Return all jobs since the start, newest first."""
        return sorted(self._jobs.values(), key=lambda job: -job.number)

    def running_pages(self) -> set[str]:
        """Return the keys of the pages that have a running or queued job."""
        return {job.page for job in self._jobs.values() if job.active}

    @property
    def busy(self) -> bool:
        """Whether there is a running or queued job, or a computation whose result has not been delivered yet."""
        return super().busy or any(job.active for job in self._jobs.values())

    # -- the queue -------------------------------------------------------------------------------------
    def waiting(self) -> tuple[int, ...]:
        """Return the numbers of the queued jobs, the next one first."""
        return self._line.waiting

    def move(self, number: int, by: int) -> None:
        """Move a queued job ``by`` places, later if positive."""
        if self._line.move(number, by):
            self.queued.emit()

    # -- what is kept of jobs that ended early ---------------------------------------------------------
    def keeps(self, number: int) -> bool:
        """Return whether a running or queued job keeps partial results if it ends early."""
        asked = self._asked.get(number)
        return asked is not None and asked.keeping is not None

    def go_on(self, number: int) -> None:
        """Queue again a job that ended early, to resume it from its original request."""
        if number not in self._asked or not self._jobs[number].kept:
            return
        self._logs[number].go_on()
        ended = self._jobs[number]
        self._jobs[number] = WindowJob(number, ended.title, ended.page, ended.kind, taken=ended.taken)
        self._enter(number)

    def discard(self, number: int) -> None:
        """Delete the partial results of a job that ended early; if this fails, the job shows the reason."""
        asked = self._asked.get(number)
        if asked is None or asked.keeping is None or not self._jobs[number].kept:
            return

        def gone(_: None) -> None:
            if self._jobs[number].kept:
                self._forget_kept(number)

        def refused(words: str) -> None:
            self._change(number, error=words)

        self.compute(f"discard {number}", asked.keeping.discard, gone, refused)

    def _take_over(self, keeping: Keeping) -> None:
        """Hand the partial results of earlier jobs with the same output over to a new job."""
        for number, asked in list(self._asked.items()):
            if asked.keeping is not None and asked.keeping.out == keeping.out and self._jobs[number].kept:
                self._forget_kept(number)

    def _forget_kept(self, number: int) -> None:
        del self._asked[number]
        self._change(number, kept="")

    # -- the window's thread ---------------------------------------------------------------------------
    def _look(self) -> None:
        for running in tuple(self._running.values()):
            if time.monotonic() - running.reported > TELL_S:
                self._show_progress(running)

    def _show_progress(self, running: JobThread) -> None:
        """Report the newest record of a job. It is never dropped, since the next one may take long."""
        record = running.take()
        if record is not None:
            running.reported = time.monotonic()
            self._change(running.number, progress=record)

    def _ended(self, number: int, changes: dict[str, Any]) -> None:
        """Pass the end of a job from its thread to the window's thread."""

        def take() -> None:
            running = self._running.get(number)
            if running is not None:  # else it was already abandoned
                self._show_progress(running)  # its last progress, and the time of a short job
                self._end(number, **changes)

        self.hand_over(take)

    def _change(self, number: int, **changes: Any) -> WindowJob:
        job = replace(self._jobs[number], **changes)
        self._jobs[number] = job
        self.changed.emit(job)
        return job

    def _end(self, number: int, join_s: float = 5, **changes: Any) -> None:
        running = self._running.pop(number, None)
        self._line.leave(number)
        job = self._change(number, before_s=0.0 if running is None else running.before_s, **changes)
        self._log_end(job)
        if running is not None:
            running.thread.join(join_s)
        # keep the request of a job that can resume, never the result of one
        asked = self._asked[number] if job.kept else self._asked.pop(number)
        self._jobs[number] = job.remembered()
        if self._closed:
            return
        try:
            self._report(job, asked)
        finally:  # report the end even if handling the result failed
            self.finished.emit(job)
            self._advance()
            self.queued.emit()

    def _report(self, job: WindowJob, asked: JobRequest) -> None:
        try:
            if job.state is JobState.DONE and asked.on_done is not None:
                asked.on_done(job.result)
            elif job.state is JobState.FAILED and asked.on_failed is not None:
                asked.on_failed(job)
        finally:
            if asked.on_end is not None:
                asked.on_end(job)

    def _log_end(self, job: WindowJob) -> None:
        log = self._logs[job.number]
        for note in notes_of(job.result):
            log.say("note", note)
        if job.state is JobState.DONE and job.taken is not None and job.taken.out:
            log.say("wrote", job.taken.out)
        log.end(job.ended_words(), job.details)

    def leave(self) -> None:
        """Ask all jobs to stop, and start no others. `waits_for` returns whether to wait for them."""
        super().leave()
        self.cancel_all()

    def waits_for(self, seconds: float) -> bool:
        """Return whether closing should still wait for running work, ``seconds`` after `leave`."""
        left = self._loads.alive or any(thread.is_alive() for thread in self._abandoned)
        return (
            (bool(self.running_pages()) and seconds < JOBS_S)
            or (self.computing and seconds < COMPUTATIONS_S)
            or (left and seconds < LOADS_S)
        )

    def close(self, wait_s: float = JOBS_S) -> None:
        """Stop all jobs, and wait at most ``wait_s`` seconds for their threads; later results are discarded."""
        self._closed = True
        running = list(self._running.values())
        for one in running:
            one.stop.set()
        wait_for([one.thread for one in running if not one.asked.leave], wait_s)
        left = [*self._abandoned, *(one.thread for one in running if one.asked.leave)]
        wait_for(left, min(wait_s, LOADS_S))
        super().close(wait_s)
