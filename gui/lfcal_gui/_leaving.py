"""Waiting for what is at work before a window closes, without holding it."""

from __future__ import annotations

import time
from collections.abc import Callable

from PySide6.QtCore import QObject, QTimer

from lfcal_gui.jobs import Jobs

LOOK_MS = 20
"""Between two looks whether the window can close (ms)."""


class Leaving(QTimer):
    """Calls ``done`` once nothing is at work that is worth waiting for, with whether something still is."""

    def __init__(self, jobs: Jobs, done: Callable[[bool], None], parent: QObject) -> None:
        super().__init__(parent)
        self._jobs, self._done, self._began = jobs, done, time.monotonic()
        self.setInterval(LOOK_MS)
        self.timeout.connect(self._look)
        self.start()

    def _look(self) -> None:
        if not self._jobs.waits_for(time.monotonic() - self._began):
            self.stop()
            self._done(self._jobs.waits_for(0))
