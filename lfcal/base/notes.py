"""What long work says while it runs, one line at a time, to the logger ``lfcal``."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager

__all__ = ["note", "notes_to", "tell", "warn"]

LOG = logging.getLogger("lfcal")
LOG.addHandler(logging.NullHandler())


def note(text: str) -> None:
    """Say something that a user should know of what is made."""
    LOG.info("%s", text)


def warn(text: str) -> None:
    """Say something that a user should look at."""
    LOG.warning("%s", text)


def tell(text: str) -> None:
    """Say what happens meanwhile, such as a hold and its end, without a leading word."""
    LOG.info("%s", text, extra={"plain": True})


class _Lines(logging.Handler):
    def __init__(self, sink: Callable[[str], None]) -> None:
        super().__init__()
        self._sink = sink
        self._said: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        """Hand on one line; a note or warning once, as a task and the one after it may know the same."""
        if hasattr(record, "plain"):
            self._sink(record.getMessage())
            return
        word = "warning: " if record.levelno >= logging.WARNING else "note: "
        line = f"{word}{record.getMessage()}"
        if line not in self._said:
            self._said.add(line)
            self._sink(line)


@contextmanager
def notes_to(sink: Callable[[str], None]) -> Iterator[None]:
    """Hand what long work says to ``sink``, a line each, while the context lasts."""
    handler, level = _Lines(sink), LOG.level
    LOG.addHandler(handler)
    LOG.setLevel(logging.INFO)
    try:
        yield
    finally:
        LOG.removeHandler(handler)
        LOG.setLevel(level)
