"""What an executor is, and what it reports of the units it was given."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Protocol, Self

from lfcal.base import Registry
from lfcal.work.unit import Job

__all__ = ["EXECUTORS", "FINAL_EVENTS", "Event", "EventKind", "Executor", "ExecutorKind"]


class EventKind(Enum):
    """What happened to a unit."""

    STARTED = "started"
    ADVANCED = "advanced"
    DONE = "done"
    FAILED = "failed"
    """Its task raised; it would again."""
    LOST = "lost"
    """Its worker ended, or its file was held by another program: it may be tried again."""


@dataclass(frozen=True, slots=True)
class Event:
    """News of one unit.

    Attributes
    ----------
    job
        Which.
    kind
        What happened.
    worker
        Who does it, for people.
    share
        Of the unit that is done, in [0, 1].
    stage
        What is being done, for people.
    seconds
        That the unit took, where the worker says it.
    error
        Of `EventKind.FAILED` and `EventKind.LOST`.
    seal
        Of `EventKind.DONE`: that of its file (see `lfcal.work.unit.seal_of`).
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
"""After these the executor knows the unit no longer."""


class Executor(Protocol):
    """Does units, several at a time or one after the other. A context: at its end whatever is under way is stopped.

    Attributes
    ----------
    name
        As in `ExecutorKind`.
    workers
        Units or threads at work at a time.
    place
        Where its workers can be watched, an address; empty where they cannot.
    ahead
        Whether workers have their next unit before one has ended; else they get it in the next call of `events`.
    """

    name: str
    workers: int
    place: str
    ahead: bool

    def __enter__(self) -> Self:
        """Start."""
        ...

    def __exit__(self, *error: object) -> None:
        """Stop everything that is under way; nothing half-written stays."""
        ...

    def submit(self, job: Job) -> None:
        """Take a unit; it is begun when a worker is free."""
        ...

    def events(self) -> list[Event]:
        """Return what happened since the last call; waits a moment for something to happen."""
        ...


@dataclass(frozen=True)
class ExecutorKind:
    """An executor by name.

    Attributes
    ----------
    name
        What ``--executor`` calls it.
    title
        What it is, in a line.
    make
        Makes one of ``workers`` (None: what this machine has) at an ``address`` (empty: none is given).
    addressed
        Whether it takes an address.
    """

    name: str
    title: str
    make: Callable[[int | None, str], Executor]
    addressed: bool = False


EXECUTORS: Registry[ExecutorKind] = Registry("executor", "lfcal.work.executors", "EXECUTOR", "lfcal.executors")
"""All executors by name."""
