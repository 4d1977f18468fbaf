"""Units in this process: one after the other with all threads, or, where they are made for it, one beside another."""

from __future__ import annotations

import itertools
import queue
import threading
from collections import deque
from collections.abc import Iterable
from typing import Self

from lfcal.base import Progress, Work, WorkAbandoned, abandonable, drain, free_memory, worker_count
from lfcal.work.executors.base import Event, EventKind, ExecutorKind
from lfcal.work.unit import Job, numbered

__all__ = ["EXECUTOR", "Threads", "concurrent_memory", "concurrent_units"]

FREE_SHARE = 0.6
"""Of the memory that is free when the first unit begins, what units beside each other may take together."""

POLL_S = 0.2
"""Seconds that `Threads.events` waits at most for units beside each other."""


def concurrent_units(sizes: Iterable[int], threads: int, memory: int) -> int:
    """Return how many units of ``sizes`` bytes each run at the same time; 0: none fits.

    A size of 0 is that of a unit that is done alone.
    """
    count = 0
    for size in itertools.islice(sizes, max(0, threads)):
        memory -= size
        if size == 0 or memory < 0:
            break
        count += 1
    return count


def concurrent_memory() -> int:
    """Return the bytes that units may take together that run at the same time."""
    return int(FREE_SHARE * free_memory())


class _Team:
    """What units in threads of their own share with who waits for them."""

    def __init__(self) -> None:
        self.news: queue.SimpleQueue[tuple[_Worker, Event]] = queue.SimpleQueue()
        self.stopped = False


class _Worker:
    """One unit in a thread of its own, which may use ``threads`` in all."""

    def __init__(self, team: _Team, number: int, job: Job, threads: int) -> None:
        self.team, self.number, self.job, self.threads = team, number, job, threads
        self.name = f"thread {number + 1}"
        self.thread = threading.Thread(target=self._serve, name=f"lfcal unit {number}")
        self.thread.start()

    def _serve(self) -> None:
        try:
            with numbered(self.number), abandonable(lambda: not self.team.stopped):
                seal = drain(self.job.steps(self.threads), self._report)
        except WorkAbandoned:
            return
        except Exception as error:
            self._say(Event(self.job, EventKind.FAILED, self.name, error=error))
        else:
            self._say(Event(self.job, EventKind.DONE, self.name, share=1.0, seal=seal))

    def _report(self, record: Progress) -> None:
        if self.team.stopped:
            raise WorkAbandoned
        self._say(Event(self.job, EventKind.ADVANCED, self.name, record.fraction, record.stage))

    def _say(self, event: Event) -> None:
        self.team.news.put((self, event))


class Threads:
    """See `lfcal.work.executors.base.Executor`; what a task raises reaches the caller as it is.

    Units that state the memory they take (`Unit.concurrent_bytes`) run at the same time as far as memory reaches, the
    threads divided among them: of two threads on one unit each waits for what the other alone can do. All others are
    done one after the other, with all threads, in the caller's.
    """

    name, place, ahead = "threads", "", False

    def __init__(self, workers: int | None = None) -> None:
        self.workers = worker_count(workers)
        self._waiting: deque[Job] = deque()
        self._alone: tuple[Job, Work[str]] | None = None
        self._team = _Team()
        self._busy: list[_Worker] = []
        self._memory = 0

    def __enter__(self) -> Self:
        """Start."""
        self._memory = concurrent_memory()
        return self

    def __exit__(self, *error: object) -> None:
        """Stop the units that are under way."""
        self._waiting.clear()
        self._team.stopped = True
        if self._alone is not None:
            self._alone[1].close()
            self._alone = None
        while self._busy:
            self._busy.pop().thread.join()

    def submit(self, job: Job) -> None:
        """Take a unit."""
        self._waiting.append(job)

    def events(self) -> list[Event]:
        """Go one step further with a unit that is alone, or return what happened to those beside each other."""
        begun = self._begin()
        if begun:
            return begun
        if self._alone is not None:
            return [self._step(*self._alone)]
        if not self._busy:
            return []
        try:
            worker, event = self._team.news.get(timeout=POLL_S)
        except queue.Empty:
            return []
        if event.kind is not EventKind.ADVANCED:
            worker.thread.join()
            self._busy.remove(worker)
        return [event]

    def _begin(self) -> list[Event]:
        """Begin what waits, as far as there are threads and memory for it."""
        found: list[Event] = []
        while self._waiting and self._alone is None:
            free = self.workers - sum(worker.threads for worker in self._busy)
            taken = sum(worker.job.unit.concurrent_bytes for worker in self._busy)
            count = concurrent_units((job.unit.concurrent_bytes for job in self._waiting), free, self._memory - taken)
            if count <= 1 and not self._busy:
                job = self._waiting.popleft()
                self._alone = job, job.steps(self.workers)
                return [Event(job, EventKind.STARTED, "this process")]
            if count == 0:
                break
            number = min(set(range(self.workers)) - {worker.number for worker in self._busy})
            worker = _Worker(self._team, number, self._waiting.popleft(), -(-free // count))
            self._busy.append(worker)
            found.append(Event(worker.job, EventKind.STARTED, worker.name))
        return found

    def _step(self, job: Job, steps: Work[str]) -> Event:
        """Go one step further with the unit that is done alone."""
        try:
            record = next(steps)
        except StopIteration as end:
            self._alone = None
            return Event(job, EventKind.DONE, share=1.0, seal=end.value)
        except Exception as error:
            self._alone = None
            return Event(job, EventKind.FAILED, error=error)
        return Event(job, EventKind.ADVANCED, share=record.fraction, stage=record.stage)


EXECUTOR = ExecutorKind(
    "threads", "planes beside each other in this process, or one with all threads", lambda n, _: Threads(n)
)
