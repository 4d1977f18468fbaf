"""Long work as a generator of immutable `Progress` records that any caller can run or cancel.

Work that takes time is written once as ``iter_work(...) -> Generator[Progress, None, Result]``. The plain function is
derived from it: ``work = drained(iter_work)``. Closing the generator (`Generator.close`) cancels the work, which then
cleans up.
"""

from __future__ import annotations

import inspect
import re
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import update_wrapper
from inspect import Parameter, Signature
from types import FunctionType
from typing import Any, Concatenate, ParamSpec, Protocol, TypeVar, cast, get_args, get_origin, overload

__all__ = [
    "Clock",
    "Progress",
    "Work",
    "WorkAbandoned",
    "abandonable",
    "drain",
    "drained",
    "in_place_of",
    "raise_if_abandoned",
]

P = ParamSpec("P")
Q = ParamSpec("Q")
S = TypeVar("S")
R = TypeVar("R")
R_co = TypeVar("R_co", covariant=True)


@dataclass(frozen=True, slots=True)
class Progress:
    """Progress of a piece of work.

    Attributes
    ----------
    done, total
        Number of finished units of work, and total number (0: unknown).
    stage
        Name of the current stage, for display.
    seconds
        Wall time since the work began (s).
    note
        Remark to display; may be empty.
    per
        Number of units of ``done`` per displayed unit. Work with a few long units is counted in thousandths of them.
    """

    done: int
    total: int
    stage: str
    seconds: float = 0.0
    note: str = ""
    per: int = 1

    @property
    def fraction(self) -> float:
        """Finished fraction of the work, in [0, 1]; 0 if the total is unknown."""
        return min(1.0, self.done / self.total) if self.total > 0 else 0.0

    @property
    def count(self) -> str:
        """Finished and total number of displayed units, as text; empty if the total is unknown."""
        return f"{self.done // self.per} of {self.total // self.per}" if self.total else ""

    @property
    def eta_seconds(self) -> float | None:
        """Estimated remaining time (s); None before the first unit is finished, or if the total is unknown."""
        if self.done <= 0 or self.total <= 0:
            return None
        return self.seconds * max(0, self.total - self.done) / self.done


Work = Generator[Progress, None, R]
"""A running piece of work: yields `Progress`, returns its result."""


class Clock:
    """Clock that creates the `Progress` records of a ``stage`` with ``total`` units; it starts when it is created."""

    def __init__(self, stage: str, total: int) -> None:
        self.stage = stage
        self.total = total
        # perf_counter never goes backwards, unlike the wall clock
        self._start = time.perf_counter()

    def at(self, done: int, note: str = "") -> Progress:
        """Return the `Progress` record for ``done`` finished units, with the remark ``note``."""
        return Progress(done, self.total, self.stage, time.perf_counter() - self._start, note)


def drain(work: Work[R], on_progress: Callable[[Progress], None] | None = None) -> R:
    """Run the generator ``work`` to its end, call ``on_progress`` with each `Progress` record, and return the result.

    Examples
    --------
    >>> from lfcal.base import Progress, drain
    >>> def iter_add(a, b):
    ...     yield Progress(1, 1, "add")
    ...     return a + b
    >>> drain(iter_add(2, 3))
    5
    """
    try:
        while True:
            record = next(work)
            if on_progress is not None:
                on_progress(record)
    except StopIteration as stop:
        result: R = stop.value
        return result
    finally:
        # close the generator even if the caller's code raised, so that its files are closed
        work.close()


STEPS = ("Yields", "Examples")
"""Sections of a generator's docstring that do not apply to the function derived from it."""

_HEADING = re.compile(r"^([A-Z][A-Za-z ]+)\n-{3,}$", re.MULTILINE)


class Drained(Protocol[P, R_co]):
    """A function made by `drained`: it has the parameters of its generator, and ``on_progress``."""

    __name__: str
    __qualname__: str

    @overload
    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R_co: ...
    @overload
    def __call__(self, *args: Any, on_progress: Callable[[Progress], None] | None, **kwargs: Any) -> R_co: ...
    @overload
    def __get__(self, instance: None, owner: type) -> Drained[P, R_co]: ...
    @overload
    def __get__(self: Drained[Concatenate[S, Q], R_co], instance: S, owner: type) -> Drained[Q, R_co]: ...


def drained(work: Callable[P, Generator[Progress, None, R]], doc: str = "") -> Drained[P, R]:
    """Return a function that runs the generator of ``work`` to its end, as ``assemble`` does for ``iter_assemble``.

    The function has the parameters of ``work``, returns its result, and belongs to the same module or class. Its
    additional keyword ``on_progress`` is a function that is called with each `Progress` record.

    Parameters
    ----------
    work
        A function or method named ``iter_...`` that returns a generator of `Progress`.
    doc
        Parts of the docstring that differ from that of ``work``: a summary, sections in numpy style, or both. The
        sections Yields and Examples of ``work`` are left out.

    Examples
    --------
    >>> from lfcal.base import Clock, Work, drained
    >>> def iter_add(a: int, b: int = 1) -> Work[int]:
    ...     yield Clock("add", 1).at(1)
    ...     return a + b
    >>> add = drained(iter_add, "Add two numbers.")
    >>> print(add.__name__, add(2, b=3), add.__doc__)
    add 5 Add two numbers.
    """
    run = drain

    def whole(*args: Any, on_progress: Callable[[Progress], None] | None = None, **kwargs: Any) -> R:
        return run(work(*args, **kwargs), on_progress)

    own = in_place_of(work, whole)
    own.__name__ = work.__name__.removeprefix("iter_")
    own.__qualname__ = work.__qualname__.removesuffix(work.__name__) + own.__name__
    own.__doc__ = docstring_of(work.__doc__ or "", doc)
    result = _result_of(work)
    _sign(own, _with_progress(inspect.signature(work)).replace(return_annotation=result))
    return cast(Drained[P, R], own)


def _with_progress(signature: Signature) -> Signature:
    """Return the signature with the keyword ``on_progress`` after its other keywords."""
    known = list(signature.parameters.values())
    end = len(known) - sum(one.kind is Parameter.VAR_KEYWORD for one in known)
    annotation = "Callable[[Progress], None] | None"
    known.insert(end, Parameter("on_progress", Parameter.KEYWORD_ONLY, default=None, annotation=annotation))
    return signature.replace(parameters=known)


def in_place_of(function: Callable[..., Any], made: Callable[..., Any], signature: Signature | None = None) -> Any:
    """Return the nested function ``made`` as if it were defined in place of ``function``, with its docstring.

    Doctest, pickle and `inspect` then treat it as part of that module. ``made`` must use only its closure, no global
    names. Its signature is ``signature``, or that of ``function`` if None.
    """
    # doctest finds functions by the globals of their module
    own = FunctionType(made.__code__, function.__globals__, closure=made.__closure__)
    update_wrapper(own, function)
    own.__kwdefaults__ = made.__kwdefaults__
    if signature is not None:
        _sign(own, signature)
    return own


def _sign(function: FunctionType, signature: Signature) -> None:
    function.__signature__ = signature  # type: ignore[attr-defined]
    known = {name: one.annotation for name, one in signature.parameters.items()}
    known["return"] = signature.return_annotation
    function.__annotations__ = {name: said for name, said in known.items() if said is not Signature.empty}


def _result_of(work: Callable[..., Any]) -> Any:
    """Return the annotation of the result of ``work``, such as R for ``Work[R]``."""
    annotation = work.__annotations__.get("return")
    if isinstance(annotation, str):
        if annotation.startswith("Work["):
            return annotation.removeprefix("Work[").removesuffix("]")
        # an alias for work with a special kind of progress, such as `SolverWork`
        annotation = work.__globals__.get(annotation, annotation)
    if get_origin(annotation) is not Generator:
        raise TypeError(f"{work.__qualname__}: expected a result annotated as Work[...], got {annotation}")
    return get_args(annotation)[-1]


def docstring_of(generator: str, doc: str = "") -> str:
    """Return the docstring of a function derived from a generator.

    It is the docstring ``generator`` without the sections Yields and Examples. A summary or section in ``doc`` replaces
    that of ``generator``, or is added.
    """
    kept = {heading: text for heading, text in _parts_of(generator).items() if heading not in STEPS}
    merged = kept | {heading: text for heading, text in _parts_of(doc).items() if text}
    return "\n\n".join(text for text in merged.values() if text)


def _parts_of(doc: str) -> dict[str, str]:
    """Return the parts of a docstring: its summary, its description, and its sections with headings."""
    head, *rest = _HEADING.split(inspect.cleandoc(doc))
    summary, _, description = head.strip().partition("\n\n")
    parts = {"summary": summary, "description": description}
    for heading, text in zip(rest[::2], rest[1::2], strict=True):
        parts[heading] = f"{heading}\n{'-' * len(heading)}\n{text.strip()}"
    return parts


class WorkAbandoned(Exception):
    """The computed result is no longer needed."""


_NEEDED: ContextVar[Callable[[], bool] | None] = ContextVar("needed", default=None)
"""Function given to `abandonable`, for this thread and its helpers (`lfcal.base.threads.for_each_chunk`)."""


@contextmanager
def abandonable(needed: Callable[[], bool]) -> Iterator[None]:
    """Return a context in which `raise_if_abandoned` ends this thread's computation when ``needed`` returns False.

    Use it for functions that are not generators, and whose results may become unnecessary before they return.
    """
    token = _NEEDED.set(needed)
    try:
        yield
    finally:
        _NEEDED.reset(token)


def raise_if_abandoned() -> None:
    """Raise `WorkAbandoned` if this thread's result is no longer needed; do nothing outside `abandonable`."""
    needed = _NEEDED.get()
    if needed is not None and not needed():
        raise WorkAbandoned
