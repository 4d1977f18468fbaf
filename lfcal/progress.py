"""Long work as a generator of immutable `Progress` records that anyone can drain or cancel.

Work that takes time is written once as ``iter_work(...) -> Work[Result]``; the plain ``work(...)`` is
`drained` from it. Closing the generator (`Generator.close`) cancels: the work cleans up behind itself.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import wraps
from inspect import signature
from typing import ParamSpec, TypeVar

__all__ = ["Clock", "Progress", "Unwanted", "Work", "drain", "drained", "leave_if_unwanted", "wanted_while"]

P = ParamSpec("P")
R = TypeVar("R")


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a piece of work has come.

    Attributes
    ----------
    done, total
        Units of work finished and in all (``total`` 0: not known).
    stage
        What is being done, for people.
    seconds
        Wall time since the work began.
    note
        Something worth a line, or empty.
    per
        Units of ``done`` and ``total`` in one that people count: a run of few long units moves in thousandths of them.
    """

    done: int
    total: int
    stage: str
    seconds: float = 0.0
    note: str = ""
    per: int = 1

    @property
    def fraction(self) -> float:
        """Finished share in [0, 1]."""
        return min(1.0, self.done / self.total) if self.total > 0 else 0.0

    @property
    def count(self) -> str:
        """How far it is as people count it; empty where the total is not known."""
        return f"{self.done // self.per} of {self.total // self.per}" if self.total else ""

    @property
    def eta_seconds(self) -> float | None:
        """Estimated seconds to the end, or None while there is nothing to go by."""
        if self.done <= 0 or self.total <= 0:
            return None
        return self.seconds * max(0, self.total - self.done) / self.done


Work = Generator[Progress, None, R]
"""A running piece of work: yields `Progress`, returns its result."""


class Clock:
    """Make `Progress` records of one stage against a common start time."""

    def __init__(self, stage: str, total: int) -> None:
        self.stage = stage
        self.total = total
        # perf_counter never goes backwards, unlike the clock of the day
        self._start = time.perf_counter()

    def at(self, done: int, note: str = "") -> Progress:
        """Return the record for ``done`` finished units."""
        return Progress(done, self.total, self.stage, time.perf_counter() - self._start, note)


def drain(work: Work[R], on_progress: Callable[[Progress], None] | None = None) -> R:
    """Run ``work`` to its end, hand each record to ``on_progress``, return its result."""
    try:
        while True:
            record = next(work)
            if on_progress is not None:
                on_progress(record)
    except StopIteration as stop:
        result: R = stop.value
        return result
    finally:
        # closes the generator also where the caller's own code raised: its files are closed then
        work.close()


def drained(work: Callable[P, Work[R]], doc: str = "") -> Callable[P, R]:
    """Return the plain function of ``iter_work``: ``work = drained(iter_work)`` runs it to its end.

    Parameters, defaults, types and docstring are those of ``iter_work``, so that the two cannot drift apart. It must be
    annotated as ``Work[...]``; ``doc`` replaces the docstring, for another example.
    """
    returned = signature(work).return_annotation
    if not (isinstance(returned, str) and returned.startswith("Work[")):
        raise TypeError(f"{work.__qualname__}: expected a result annotated as Work[...], got {returned}")

    @wraps(work)
    def whole(*args: P.args, **kwargs: P.kwargs) -> R:
        return drain(work(*args, **kwargs))

    whole.__name__ = work.__name__.replace("iter_", "", 1)
    whole.__qualname__ = work.__qualname__.removesuffix(work.__name__) + whole.__name__
    whole.__doc__ = doc or work.__doc__
    whole.__annotations__ = {**work.__annotations__, "return": returned[5:-1]}
    whole.__signature__ = signature(work).replace(return_annotation=returned[5:-1])  # type: ignore[attr-defined]
    return whole


class Unwanted(Exception):
    """Nobody waits for what is computed any more."""


_WANTED: ContextVar[Callable[[], bool] | None] = ContextVar("wanted", default=None)
"""Of this thread, and of those that help it in its context (`lfcal.threads.for_each_chunk`)."""


@contextmanager
def wanted_while(wanted: Callable[[], bool]) -> Iterator[None]:
    """Let what this thread computes end early, by `Unwanted`, once ``wanted`` says no.

    For functions that are no generators, and answer questions that may be asked anew before they are answered.
    """
    token = _WANTED.set(wanted)
    try:
        yield
    finally:
        _WANTED.reset(token)


def leave_if_unwanted() -> None:
    """Raise `Unwanted` where nobody waits for what this thread computes any more."""
    wanted = _WANTED.get()
    if wanted is not None and not wanted():
        raise Unwanted
