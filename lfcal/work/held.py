"""What the units of a run share, made once in each process that does them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Generic, TypeVar

__all__ = ["Held"]

T = TypeVar("T")


class Held(Generic[T]):
    """Keep what the last run needed: an H, or frames with their corrections, may take most of the memory.

    Parameters
    ----------
    close
        Lets go of what is kept, before that of another run takes its place.
    """

    def __init__(self, close: Callable[[T], None]) -> None:
        self._close = close
        self._lock = threading.RLock()
        self._kept: tuple[object, T, bool] | None = None

    def get(self, key: object, make: Callable[[], T]) -> T:
        """Return what ``key`` tells from all others: what is kept, or what ``make`` gives."""
        with self._lock:
            if self._kept is None or self._kept[0] != key:
                self._drop()
                self._kept = key, make(), True
            return self._kept[1]

    @contextmanager
    def lent(self, key: object, value: T) -> Iterator[None]:
        """Let units that are done in this process use what their run has made itself, until the end of the block."""
        with self._lock:
            self._drop()
            self._kept = key, value, False
        try:
            yield
        finally:
            with self._lock:
                if self._kept is not None and self._kept[1] is value:
                    self._kept = None

    def _drop(self) -> None:
        kept, self._kept = self._kept, None
        if kept is not None and kept[2]:
            self._close(kept[1])
