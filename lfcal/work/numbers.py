"""Which of the workers that share a run this one is: what there are several of, as accelerators, is dealt out by it."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

__all__ = ["numbered", "worker_number"]

_NUMBER: ContextVar[int] = ContextVar("worker", default=0)


def worker_number() -> int:
    """Return the number of the worker that does the present unit, from 0; 0 where there is one alone."""
    return _NUMBER.get()


@contextmanager
def numbered(name: int | str) -> Iterator[None]:
    """Give the units inside this block a worker's number, or one that follows from its name."""
    text = str(name)
    token = _NUMBER.set(int(text) if text.isdecimal() else zlib.crc32(text.encode()))
    try:
        yield
    finally:
        _NUMBER.reset(token)
