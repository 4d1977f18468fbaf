"""Units one after the other in this process, each with all threads: as quick as work that is not divided."""

from __future__ import annotations

from collections import deque
from typing import Self

from lfcal.progress import Work
from lfcal.threads import worker_count
from lfcal.work.executors.base import Event, ExecutorKind, What
from lfcal.work.unit import Job

__all__ = ["EXECUTOR", "Threads"]


class Threads:
    """See `lfcal.work.executors.base.Executor`; what a task raises reaches the caller as it is."""

    name, place = "threads", ""

    def __init__(self, workers: int | None = None) -> None:
        self.workers = worker_count(workers)
        self._waiting: deque[Job] = deque()
        self._current: tuple[Job, Work[str]] | None = None

    def __enter__(self) -> Self:
        """Start."""
        return self

    def __exit__(self, *error: object) -> None:
        """Stop the unit that is under way."""
        if self._current is not None:
            self._current[1].close()
            self._current = None
        self._waiting.clear()

    def submit(self, job: Job) -> None:
        """Take a unit."""
        self._waiting.append(job)

    def events(self) -> list[Event]:
        """Go one step further with the first unit."""
        if self._current is None:
            if not self._waiting:
                return []
            job = self._waiting.popleft()
            self._current = job, job.steps(self.workers)
            return [Event(job, What.STARTED, "this process")]
        job, steps = self._current
        try:
            record = next(steps)
        except StopIteration as end:
            self._current = None
            return [Event(job, What.DONE, share=1.0, seal=end.value)]
        except Exception as error:
            self._current = None
            return [Event(job, What.FAILED, error=error)]
        return [Event(job, What.ADVANCED, share=record.fraction, stage=record.stage)]


EXECUTOR = ExecutorKind("threads", "planes one after the other, all threads on each", lambda n, _: Threads(n))
