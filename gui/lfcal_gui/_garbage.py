"""Collect cyclic garbage in the window's thread only, and old objects only while the window is idle.

Python collects in whichever thread happens to allocate. A widget that is part of a cycle would then be destroyed by a
worker, which ends the program. While a `Collector` lives, collection happens in the event loop only. Each tick collects
new objects, in a few milliseconds. Collecting all objects takes a tenth of a second once libraries are loaded, which
would be noticed while the user works.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable

from PySide6.QtCore import QObject, QTimer

INTERVAL_MS = 500
BUSY_S = 0.02
"""Processor time of the window's thread between two ticks below which the window counts as idle (s)."""

CALM_TICKS = 4
"""Number of ticks without work before all generations are collected."""

LATEST_TICKS = 240
"""Number of ticks after which all generations are collected even if the window is busy."""


class Collector(QObject):
    """Switch automatic collection off until `close`; check every half second whether a generation is due.

    The first collector excludes the objects that exist when it is made: modules and their functions, two thirds of all
    objects, which never become garbage.

    Parameters
    ----------
    parent
        Owner of the collector.
    busy
        Function that returns whether work is running; the window then counts as busy.
    """

    _first = True

    def __init__(self, parent: QObject | None = None, busy: Callable[[], bool] = lambda: False) -> None:
        super().__init__(parent)
        self._busy = busy
        self._was_on = gc.isenabled()
        gc.disable()
        if Collector._first:  # gc.get_freeze_count would be slow: it counts all objects
            Collector._first = False
            gc.freeze()
        self._calm, self._ticks, self._worked_s = 0, 0, time.thread_time()
        self._timer = QTimer(self, interval=INTERVAL_MS)
        self._timer.timeout.connect(self.collect)
        self._timer.start()

    def collect(self) -> None:
        """Collect the youngest generation if it is due; older ones if the window is idle, or after a long time."""
        worked_s, self._worked_s = self._worked_s, time.thread_time()
        # the result of a job will be shown soon
        waiting = self._busy()
        self._calm = 0 if waiting or self._worked_s - worked_s >= BUSY_S else self._calm + 1
        self._ticks += 1
        youngest, younger, _ = gc.get_count()
        limits = gc.get_threshold()
        if younger > limits[1] and (self._calm >= CALM_TICKS or self._ticks >= LATEST_TICKS):
            gc.collect()
            self._ticks = 0
        elif youngest > limits[0]:
            gc.collect(0)
        self._worked_s = time.thread_time()

    def close(self) -> None:
        """Restore Python's automatic collection."""
        self._timer.stop()
        if self._was_on:
            gc.enable()
