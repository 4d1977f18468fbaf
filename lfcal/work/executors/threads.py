"""Executor in this process: units run one at a time with all threads, or concurrently if they state their memory."""

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
"""Fraction of the free memory at the start that concurrent units may use together."""

POLL_S = 0.2
"""Longest wait of `Threads.events` for concurrent units (s)."""


def concurrent_units(sizes: Iterable[int], threads: int, memory: int) -> int:
    """Return how many of the next units may run at the same time, at most one for each of the free ``threads``.

    ``sizes`` states the memory that each unit needs, and ``memory`` the memory that is left (bytes). A size of 0 marks
    a unit that runs alone. The result is 0 if the first unit runs alone or does not fit into ``memory``.
    """
    count = 0
    for size in itertools.islice(sizes, max(0, threads)):
        memory -= size
        if size == 0 or memory < 0:
            break
        count += 1
    return count


def concurrent_memory() -> int:
    """Return the memory (bytes) that concurrent units may use together: a fraction of the memory that is free now."""
    return int(FREE_SHARE * free_memory())


class _Team:
    """State that units in separate threads share with the waiting caller."""

    def __init__(self) -> None:
        self.news: queue.SimpleQueue[tuple[_Worker, Event]] = queue.SimpleQueue()
        self.stopped = False


class _Worker:
    """One unit in a separate thread, which may use ``threads`` threads in all."""

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
    """Executor that uses threads of this process; errors of a task are raised unchanged.

    Units that state their memory (`Unit.concurrent_bytes`) run concurrently as far as memory allows, and the threads
    are divided among them. This is faster than several threads per unit, which wait for each other. All other units run
    one after the other in the caller's thread, each with all threads. So do units of which memory allows only one at a
    time.
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
        """Stop the running units."""
        self._waiting.clear()
        self._team.stopped = True
        if self._alone is not None:
            self._alone[1].close()
            self._alone = None
        while self._busy:
            self._busy.pop().thread.join()

    def submit(self, job: Job) -> None:
        """Queue a unit."""
        self._waiting.append(job)

    def events(self) -> list[Event]:
        """Start waiting units and return their events; if none can start, return the next event of a running unit.

        A unit that runs alone is advanced by one step. For concurrent units, this waits briefly, and the result may be
        empty.
        """
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
        """Start waiting units, as far as threads and memory allow."""
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
        """Advance the unit that runs alone by one step."""
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
    "threads", "several planes at a time in this process, or one with all threads", lambda n, _: Threads(n)
)
