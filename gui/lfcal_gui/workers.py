"""Threads that keep the window responsive when a file blocks, and one-line texts of errors. No Qt."""

from __future__ import annotations

import itertools
import logging
import queue
import threading
import time
from collections.abc import Callable
from typing import Any

from lfcal.base import LfcalError, storage_words
from lfcal_gui.models import said_in_window

LOG = logging.getLogger("lfcal.gui")
"""Logger of the window; `lfcal_gui.log` writes it to a file."""

MAX_WORDS = 500
_numbers = itertools.count(1)


def words_of(error: BaseException) -> str:
    """Return a one-line text of an error, at most 500 characters. Unexpected errors include their type."""
    text = " ".join(str(error).split())
    if isinstance(error, MemoryError):
        text = "memory: not enough is free; close other programs, or choose a smaller cutout, region or period"
    elif isinstance(error, LfcalError):
        text = said_in_window(text)
    elif isinstance(error, OSError) and error.filename is not None:
        text = storage_words(error, error.filename)
    else:
        text = f"{type(error).__name__}: {text}" if text else type(error).__name__
    return text if len(text) <= MAX_WORDS else f"{text[: MAX_WORDS - 2]} …"


def keep(what: str, error: BaseException) -> None:
    """Log an error, with its traceback if it was unexpected."""
    if isinstance(error, LfcalError):
        LOG.info("%s: %s", what, words_of(error))
    else:
        LOG.error("%s: %s", what, words_of(error), exc_info=error)


class Workers:
    """A few threads that run queued calls in order.

    They are daemons: unlike a thread of an executor, one whose call never returns does not prevent the program's end.
    """

    def __init__(self, count: int, name: str) -> None:
        self._calls: queue.SimpleQueue[Callable[[], Any] | None] = queue.SimpleQueue()
        self._closing = threading.Event()
        self._threads = [
            threading.Thread(target=self._work, name=f"{name}-{k}", daemon=True) for k in range(1, count + 1)
        ]
        for thread in self._threads:
            thread.start()

    def submit(self, call: Callable[[], Any]) -> None:
        """Run ``call``, which must not raise, as soon as a thread is free."""
        self._calls.put(call)

    def _work(self) -> None:
        while (call := self._calls.get()) is not None:
            if not self._closing.is_set():
                call()

    def close(self, timeout_s: float) -> None:
        """Drop queued calls, and wait at most ``timeout_s`` seconds in total for the running ones."""
        self._closing.set()
        for _ in self._threads:
            self._calls.put(None)
        wait_for(self._threads, timeout_s)


def wait_for(threads: list[threading.Thread], timeout_s: float) -> None:
    """Wait until the threads have ended, at most ``timeout_s`` seconds for all of them."""
    end = time.monotonic() + timeout_s
    for thread in threads:
        thread.join(max(0.0, end - time.monotonic()))


def start_thread(call: Callable[[], None], name: str) -> threading.Thread:
    """Run ``call`` in its own daemon thread."""
    thread = threading.Thread(target=call, name=f"{name}-{next(_numbers)}", daemon=True)
    thread.start()
    return thread
