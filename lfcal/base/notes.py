"""Messages that long work reports while it runs, one line at a time, to the logger ``lfcal``."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager

__all__ = ["announce", "note", "notes_to", "warn"]

LOG = logging.getLogger("lfcal")
LOG.addHandler(logging.NullHandler())


def note(text: str) -> None:
    """Log a note: a fact about the result that users should know."""
    LOG.info("%s", text)


def warn(text: str) -> None:
    """Log a warning: a fact that users should check."""
    LOG.warning("%s", text)


def announce(text: str) -> None:
    """Log an event, such as the start and end of a pause, without a leading "note:" or "warning:"."""
    LOG.info("%s", text, extra={"plain": True})


class _Lines(logging.Handler):
    def __init__(self, sink: Callable[[str], None]) -> None:
        super().__init__()
        self._sink = sink
        self._said: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        """Pass on one line; notes and warnings that several tasks repeat are reported once."""
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
    """Return a context in which the notes, warnings and events of long work are passed to ``sink``, one line each.

    A note or warning that is repeated is passed only once.
    """
    handler, level = _Lines(sink), LOG.level
    LOG.addHandler(handler)
    LOG.setLevel(logging.INFO)
    try:
        yield
    finally:
        LOG.removeHandler(handler)
        LOG.setLevel(level)
