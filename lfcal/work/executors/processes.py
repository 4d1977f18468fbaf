"""Executor with separate processes of one thread each; a crash of one does not affect the others."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait
from types import ModuleType
from typing import Any, Self

from lfcal.base import LfcalError, Progress, StorageError, bounded_threads, drain, worker_count
from lfcal.work.executors.base import Event, EventKind, ExecutorKind
from lfcal.work.unit import Job, numbered

__all__ = ["EXECUTOR", "Processes", "WorkerLost", "news", "without_script"]

POLL_S = 0.2
"""Longest wait of `Processes.events`, and time between two progress reports of a unit (s)."""

KILLED = -9
"""Exit code of a killed process on most systems; assumed if the exit code is unknown."""

_SCRIPT = threading.Lock()
"""Lock held while the program's script is hidden."""


class WorkerLost(LfcalError):
    """Error for a worker that ended before its unit was finished, for example because memory was insufficient."""


class TaskFailed(LfcalError):
    """Unexpected error of a task, which is a defect; the message states where it was raised."""


def news(error: Exception) -> tuple[EventKind, Exception]:
    """Return the kind of event for an error of a task, and the error in a form that can be sent between processes."""
    if isinstance(error, StorageError):  # another program may be writing the file, or the disk be full temporarily
        return EventKind.LOST, error
    if isinstance(error, LfcalError):
        return EventKind.FAILED, error
    trace, where = error.__traceback__, ""
    while trace is not None:
        where, trace = f"{os.path.basename(trace.tb_frame.f_code.co_filename)}:{trace.tb_lineno}", trace.tb_next
    return EventKind.FAILED, TaskFailed(f"{type(error).__name__} at {where}: {error}")


def _serve(link: Connection, number: int) -> None:
    """Process the units that arrive through ``link`` until it is closed; the main function of worker ``number``."""
    # Ctrl-C reaches every process of a terminal, but only the first should handle it and end the others
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with bounded_threads(1), numbered(number), suppress(EOFError, BrokenPipeError):
        while True:
            job: Job = link.recv()
            try:
                seal = drain(job.steps(1), _ProgressReporter(link))
            except Exception as error:
                what, details = news(error)
                link.send((what, {"error": details}))
            else:
                link.send((EventKind.DONE, {"share": 1.0, "seal": seal}))


@contextmanager
def without_script() -> Iterator[None]:
    """Return a context in which new processes do not run the program's script again, as multiprocessing otherwise does.

    A unit names the module of its task and needs nothing from the script. Without this context, a script without ``if
    __name__ == "__main__":`` would start its work again in each process.
    """
    with _SCRIPT:
        script = sys.modules["__main__"]
        sys.modules["__main__"] = ModuleType("__main__")
        try:
            yield
        finally:
            sys.modules["__main__"] = script


class _ProgressReporter:
    """Reports progress through a link at intervals."""

    def __init__(self, link: Connection) -> None:
        self.link, self.last = link, 0.0

    def __call__(self, record: Progress) -> None:
        now = time.monotonic()
        if now - self.last >= POLL_S:
            self.last = now
            self.link.send((EventKind.ADVANCED, {"share": record.fraction, "stage": record.stage}))


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


class _Worker:
    """One process and its unit."""

    def __init__(self, number: int) -> None:
        context = multiprocessing.get_context("spawn")
        self.number = number
        self.link, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, number), daemon=True)
        with without_script():
            self.process.start()
        theirs.close()
        self.job: Job | None = None

    @property
    def name(self) -> str:
        return f"process {self.process.pid}"

    def end(self) -> None:
        self.process.kill()
        self.process.join()
        self.link.close()


class Processes:
    """Executor that uses separate processes; one that ends early is replaced, and its unit is reported as lost."""

    name, place, ahead = "processes", "", False

    def __init__(self, workers: int | None = None) -> None:
        self.workers = worker_count(workers)
        self._waiting: deque[Job] = deque()
        self._team: list[_Worker] = []

    def __enter__(self) -> Self:
        """Start; processes are created when there are units for them."""
        return self

    def __exit__(self, *error: object) -> None:
        """End the processes; the next writer removes their incomplete files."""
        self._waiting.clear()
        while self._team:
            self._team.pop().end()

    def submit(self, job: Job) -> None:
        """Queue a unit."""
        self._waiting.append(job)

    def events(self) -> list[Event]:
        """Return the starts of units and at most one event of each busy process; if there are none, wait briefly."""
        found = self._begin()
        busy = {worker.link: worker for worker in self._team if worker.job is not None}
        for link in wait(list(busy), timeout=0 if found else POLL_S):
            assert isinstance(link, Connection)
            found.append(self._event_of(busy[link]))
        return found

    def _begin(self) -> list[Event]:
        """Give waiting units to idle workers."""
        found = []
        idle = deque(worker for worker in self._team if worker.job is None)
        while self._waiting and (idle or len(self._team) < self.workers):
            worker = idle.popleft() if idle else _Worker(self._free_number())
            if worker not in self._team:
                self._team.append(worker)
            try:
                worker.link.send(self._waiting[0])
            except OSError:  # it ended while it was idle
                self._replace(worker)
                continue
            worker.job = self._waiting.popleft()
            found.append(Event(worker.job, EventKind.STARTED, worker.name))
        return found

    def _free_number(self) -> int:
        """Return the smallest free worker number; a process that ended frees its number."""
        taken = {worker.number for worker in self._team}
        return min(set(range(len(taken) + 1)) - taken)

    def _event_of(self, worker: _Worker) -> Event:
        job = worker.job
        assert job is not None
        try:
            message: Any = worker.link.recv()
        except (EOFError, OSError):
            code = self._replace(worker)
            how = f"signal {-code}" if code < 0 else f"exit code {code}"
            return Event(job, EventKind.LOST, worker.name, error=WorkerLost(f"its process ended ({how})"))
        what, details = message
        if what is not EventKind.ADVANCED:
            worker.job = None
        return Event(job, what, worker.name, **details)

    def _replace(self, worker: _Worker) -> int:
        """Release a worker that ended; return its exit code."""
        self._team.remove(worker)
        worker.process.join(1.0)
        code = worker.process.exitcode
        worker.end()
        return KILLED if code is None else code


EXECUTOR = ExecutorKind("processes", "as many planes at a time as there are processes", lambda n, _: Processes(n))
