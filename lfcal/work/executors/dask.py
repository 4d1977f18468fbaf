"""Executor on workers of dask.distributed: a local cluster, or one whose scheduler is already running."""

from __future__ import annotations

import itertools
import logging
import queue
import re
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, Self

from lfcal.base import InputError, LfcalError, bounded_threads, drain, worker_count
from lfcal.work.executors.base import Event, EventKind, ExecutorKind
from lfcal.work.executors.processes import POLL_S, WorkerLost, news, without_script
from lfcal.work.unit import Job, numbered

__all__ = ["EXECUTOR", "Dask", "do"]

CONNECT_TIMEOUT_S = 20.0
"""Seconds within which a scheduler must answer."""

ADDRESS = re.compile(r"([a-z]+://)?([\w.-]+|\[[\da-fA-F:.]+\]):\d{1,5}", re.ASCII)

SETTINGS: dict[str, Any] = {
    # dask's default returns freed memory to the system: each array is then mapped and zeroed again, which takes a
    # fifth of the time of a unit. A value in the user's environment has priority.
    "distributed.nanny.pre-spawn-environ": {"MALLOC_TRIM_THRESHOLD_": None},
    # the profiler samples all threads every 10 ms for a page of the dashboard; it is not needed
    "distributed.worker.profile.enabled": False,
    # by default the event loops are checked every 20 ms, which takes 3 % of a processor
    "distributed.admin.tick.interval": "500ms",
}
"""Settings of local workers that differ from dask's defaults."""


def do(job: Job) -> tuple[str, str, dict[str, Any]]:
    """Process a unit on a worker; return the value of an `EventKind`, the worker's address, and more event fields."""
    from distributed import get_worker

    worker, began = get_worker(), time.perf_counter()
    here = str(worker.address)
    try:
        with bounded_threads(1), numbered(worker.name):
            seal = drain(job.steps(1))
    except Exception as error:
        what, details = news(error)
        return what.value, here, {"seconds": time.perf_counter() - began, "error": details}
    return EventKind.DONE.value, here, {"seconds": time.perf_counter() - began, "seal": seal}


class Dask:
    """Executor that uses workers of dask.distributed; see `lfcal.work.executors.base.Executor`.

    Workers receive paths and plain values, never arrays. The files must be on a disk that all workers can access.

    Raises
    ------
    InputError
        If dask.distributed is not installed, the address is invalid, or no scheduler answers.
    """

    name, ahead = "dask", True

    def __init__(self, workers: int | None = None, address: str = "") -> None:
        try:
            import distributed
        except ImportError:
            raise InputError('dask.distributed is not installed; run: pip install "lfcal[cluster]"') from None
        if address and not ADDRESS.fullmatch(address):
            raise InputError.expected(
                "scheduler",
                "an address such as tcp://host:8786",
                repr(address),
                "give the address that the scheduler prints",
            )
        self._library: Any = distributed
        self.workers, self.address, self.place = worker_count(workers), address, ""
        self._stack = ExitStack()
        self._client: Any = None
        self._news: queue.SimpleQueue[tuple[Job, Any]] = queue.SimpleQueue()
        self._begun: list[Job] = []
        self._count = itertools.count()

    def __enter__(self) -> Self:
        """Start a local cluster of workers with one thread each, or connect to the scheduler."""
        with self._stack as stack:
            if self.address:
                try:
                    client = self._library.Client(self.address, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
                except OSError as error:
                    wanted = f"an answer from {self.address} within {CONNECT_TIMEOUT_S:g} s"
                    raise InputError.expected("scheduler", wanted, "none", "check the address") from error
            else:
                cluster = stack.enter_context(self._local())
                client = self._library.Client(cluster, set_as_default=False)
            stack.callback(client.close)
            self._client, self.place = client, str(client.dashboard_link)
            if self.address:
                self.workers = max(1, len(client.scheduler_info()["workers"]))
            self._stack = stack.pop_all()
        return self

    @contextmanager
    def _local(self) -> Iterator[Any]:
        """Return a context with a local cluster."""
        import dask

        # the journal reports the state of workers; dask's own log lines would break the progress bar of a command
        logger = logging.getLogger("distributed")
        before = logger.level
        logger.setLevel(logging.ERROR)
        # replacement workers get the same settings
        with dask.config.set(SETTINGS), without_script():
            cluster = self._library.LocalCluster(
                n_workers=self.workers, threads_per_worker=1, dashboard_address="127.0.0.1:0", memory_limit=0
            )
        try:
            yield cluster
        finally:
            cluster.close()
            logger.setLevel(before)

    def __exit__(self, *error: object) -> None:
        """Cancel units that have not started, and end the local cluster."""
        self._stack.close()

    def submit(self, job: Job) -> None:
        """Queue a unit."""
        # in order, because files are joined while units run; at equal priority, the last submitted would run first
        key, first = f"{job.unit.name}-{next(self._count)}-{job.out}", -job.number
        future = self._client.submit(do, job, pure=False, key=key, priority=first)
        future.add_done_callback(lambda done: self._news.put((job, done)))
        self._begun.append(job)

    def events(self) -> list[Event]:
        """Return the starts of units submitted since the last call, and the end of at most one unit.

        If no unit was submitted, wait briefly for an end.
        """
        found = [Event(job, EventKind.STARTED, "cluster") for job in self._begun]
        self._begun.clear()
        try:
            found.append(self._ended(*self._news.get(timeout=0 if found else POLL_S)))
        except queue.Empty:
            pass
        return found

    def _ended(self, job: Job, future: Any) -> Event:
        if future.status == "finished":
            what, worker, details = future.result()
            return Event(job, EventKind(what), worker, **details)
        reason = future.exception() if future.status == "error" else None
        if isinstance(reason, LfcalError):
            return Event(job, EventKind.FAILED, error=reason)
        message = type(reason).__name__ if reason is not None else future.status
        return Event(job, EventKind.LOST, error=WorkerLost(f"its worker ended ({message})"))


EXECUTOR = ExecutorKind("dask", "workers of dask.distributed, here or on a cluster", Dask, addressed=True)
