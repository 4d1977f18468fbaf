"""Make pages while the window is idle, so that a page appears quickly when the user first opens it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence

from PySide6.QtCore import QObject, QTimer
from PySide6.QtWidgets import QApplication

PAUSE_MS = 100
"""Time between two steps (ms)."""

BUSY_S = 0.01
"""Processor time of the window's thread between two steps above which the window counts as busy (s)."""


class Ahead(QObject):
    """Makes pages in short steps, as long as the user does nothing and no work is running.

    Parameters
    ----------
    keys
        Keys of the pages, in the order in which they are made.
    make
        Function that does the next step of making a page, and returns False if there is none.
    busy
        Function that returns whether work is running whose result will be shown soon.
    parent
        The window.
    """

    def __init__(
        self, keys: Sequence[str], make: Callable[[str], bool], busy: Callable[[], bool], parent: QObject
    ) -> None:
        super().__init__(parent)
        self._make, self._busy = make, busy
        self._steps, self._worked_s = self._all_steps(keys), 0.0
        self._timer = QTimer(self, interval=PAUSE_MS)
        self._timer.timeout.connect(self.step)

    @property
    def active(self) -> bool:
        """Whether pages are still being made."""
        return self._timer.isActive()

    def start(self) -> None:
        """Begin as soon as the window is idle."""
        self._timer.start()

    def stop(self) -> None:
        """Make no more pages."""
        self._timer.stop()

    def step(self) -> None:
        """Do one step if the window is idle."""
        worked_s, self._worked_s = self._worked_s, time.thread_time()
        held = QApplication.mouseButtons().value or QApplication.activePopupWidget() is not None
        if not (held or self._busy() or self._worked_s - worked_s > BUSY_S):
            if next(self._steps, None) is None:
                self.stop()
            self._worked_s = time.thread_time()

    def _all_steps(self, keys: Sequence[str]) -> Iterator[str]:
        """Make each page in its steps."""
        for key in keys:
            while self._make(key):
                yield key
