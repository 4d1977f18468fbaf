"""Protocol for executors, and the events that they report about units."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Protocol, Self

from lfcal.base import Registry
from lfcal.work.unit import Job

__all__ = ["EXECUTORS", "FINAL_EVENTS", "Event", "EventKind", "Executor", "ExecutorKind"]


class EventKind(Enum):
    """Kind of an event of a unit."""

    STARTED = "started"
    ADVANCED = "advanced"
    DONE = "done"
    FAILED = "failed"
    """The task raised an error, for which the unit is not tried again."""
    LOST = "lost"
    """The worker ended, or a file could not be read or written: the unit may be tried again."""


@dataclass(frozen=True, slots=True)
class Event:
    """An event of a unit that an executor reports.

    Attributes
    ----------
    job
        The submitted unit.
    kind
        Kind of the event.
    worker
        Name of the worker, for display.
    share
        Fraction of the unit that is done, in [0, 1].
    stage
        Current step, for display.
    seconds
        Duration of the unit (s); None if the worker does not report it.
    error
        For `EventKind.FAILED` and `EventKind.LOST`, the error.
    seal
        For `EventKind.DONE`, the seal of the unit's file (see `lfcal.work.unit.seal_of`).
    """

    job: Job
    kind: EventKind
    worker: str = ""
    share: float = 0.0
    stage: str = ""
    seconds: float | None = None
    error: Exception | None = None
    seal: str = ""


FINAL_EVENTS = (EventKind.DONE, EventKind.FAILED, EventKind.LOST)
"""Kinds of the events after which the executor is no longer responsible for the unit."""


class Executor(Protocol):
    """Protocol for executors, which process units concurrently or one after the other.

    Use an executor as a context manager, which stops all running units at the end.

    Attributes
    ----------
    name
        As in `ExecutorKind`.
    workers
        Largest number of units or threads that run at the same time.
    place
        Address of a dashboard that shows the workers; empty if there is none.
    ahead
        Whether a worker receives its next unit before it has finished the current one; otherwise it receives it at the
        next call of `events`.
    """

    name: str
    workers: int
    place: str
    ahead: bool

    def __enter__(self) -> Self:
        """Start."""
        ...

    def __exit__(self, *error: object) -> None:
        """Stop all running units; no incomplete file remains."""
        ...

    def submit(self, job: Job) -> None:
        """Queue a unit, which starts when a worker is free."""
        ...

    def events(self) -> list[Event]:
        """Return new events; if there are none, wait briefly for one. Further events may follow at the next call."""
        ...


@dataclass(frozen=True)
class ExecutorKind:
    """A kind of executor: its name and its constructor.

    Attributes
    ----------
    name
        Name given to ``--executor``.
    title
        Short description.
    make
        Function that returns an executor, given ``workers`` (None: ``LFCAL_WORKERS``, or else one for each processor of
        this machine) and ``address`` (empty: none).
    addressed
        Whether the executor accepts an address.
    """

    name: str
    title: str
    make: Callable[[int | None, str], Executor]
    addressed: bool = False


EXECUTORS: Registry[ExecutorKind] = Registry("executor", "lfcal.work.executors", "EXECUTOR", "lfcal.executors")
"""All executors by name."""
