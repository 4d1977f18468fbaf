"""Base class of executors, and the events that they report about units."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Protocol, Self

from lfcal.base import Registry
from lfcal.work.unit import Job

__all__ = ["EXECUTORS", "FINAL_EVENTS", "Event", "EventKind", "Executor", "ExecutorKind"]


class EventKind(Enum):
    """Kinds of events of a unit."""

    STARTED = "started"
    ADVANCED = "advanced"
    DONE = "done"
    FAILED = "failed"
    """The task raised an error, and would raise it again."""
    LOST = "lost"
    """The worker ended, or another program held the file: the unit may be tried again."""


@dataclass(frozen=True, slots=True)
class Event:
    """An event of one unit.

    Attributes
    ----------
    job
        The unit.
    kind
        What happened.
    worker
        Name of the worker, for display.
    share
        Fraction of the unit that is done, in [0, 1].
    stage
        Current step, for display.
    seconds
        Duration of the unit, if the worker reports it.
    error
        Error of `EventKind.FAILED` and `EventKind.LOST`.
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
"""Events after which the executor has no record of the unit."""


class Executor(Protocol):
    """Base class of executors, which do units concurrently or one after the other.

    As a context manager, it stops all running units at its end.

    Attributes
    ----------
    name
        As in `ExecutorKind`.
    workers
        Number of units or threads that run at a time.
    place
        Address of a dashboard that shows the workers; empty if there is none.
    ahead
        Whether workers get the next unit before they have finished one; otherwise they get it at the next call of
        `events`.
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
        """Accept a unit; it begins when a worker is free."""
        ...

    def events(self) -> list[Event]:
        """Return the events since the last call, after a short wait for one."""
        ...


@dataclass(frozen=True)
class ExecutorKind:
    """Name and constructor of an executor.

    Attributes
    ----------
    name
        Name given to ``--executor``.
    title
        Short description.
    make
        Function that makes an executor from ``workers`` (None: all processors of this machine) and ``address`` (empty:
        none).
    addressed
        Whether the executor accepts an address.
    """

    name: str
    title: str
    make: Callable[[int | None, str], Executor]
    addressed: bool = False


EXECUTORS: Registry[ExecutorKind] = Registry("executor", "lfcal.work.executors", "EXECUTOR", "lfcal.executors")
"""All executors by name."""
