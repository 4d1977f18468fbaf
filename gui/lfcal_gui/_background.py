"""What the window does beside itself: quick computations, files that are opened; stale results are dropped.

Threads never touch Qt. They put what is to be done into a queue; a timer in the window's thread takes it out.
"""

from __future__ import annotations

import queue
from collections.abc import Callable
from typing import Any

from PySide6.QtCore import QObject, QTimer, Signal

from lfcal_gui._computations import Computations
from lfcal_gui._garbage import Collector
from lfcal_gui._loads import Loads

__all__ = ["COMPUTATIONS_S", "LOADS_S", "BackgroundThreads"]

POLL_MS = 8

COMPUTATIONS_S, LOADS_S = 5.0, 1.0
"""How long closing waits for computations, and for files (s)."""


class BackgroundThreads(QObject):
    """Threads of the window, and the way back from them into its own."""

    trouble = Signal(str)
    """Why a computation failed whose caller did not ask to be told."""

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._calls: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._computations = Computations(self.hand_over)
        self._loads = Loads(self.hand_over)
        self._timer = QTimer(self)
        self._timer.setInterval(POLL_MS)
        self._timer.timeout.connect(self._take)
        self._closed = self._leaving = False
        self._collector = Collector(self, lambda: self.busy)  # threads must not destroy widgets

    @property
    def busy(self) -> bool:
        """Whether something is at work, or its result waits to be shown."""
        return bool(self._loads) or bool(self._computations)

    # -- quick computations ----------------------------------------------------------------------------
    def compute(
        self,
        group: str,
        function: Callable[[], Any],
        on_result: Callable[[Any], None],
        on_error: Callable[[str], None] | None = None,
    ) -> None:
        """Compute in the background; only the newest request of a ``group`` reports.

        While one request of the group is being computed, at most one more waits: the newest.
        """
        if not self._closed:
            self._computations.start(group, function, on_result, on_error or self.trouble.emit)
            self._timer.start()

    @property
    def computing(self) -> bool:
        """Whether something is computed, or its result waits to be shown."""
        return bool(self._computations)

    # -- opening files ---------------------------------------------------------------------------------
    def load(
        self,
        group: str,
        function: Callable[[], Any],
        on_result: Callable[[Any], None],
        on_error: Callable[[str], None] | None = None,
        discard: Callable[[Any], None] | None = None,
    ) -> None:
        """Open something in a thread of its own, which a disk that does not answer may keep for ever.

        Only the newest request of a ``group`` reports. It waits for an earlier one unless that is dropped; what comes
        too late is handed to ``discard``.
        """
        if not (self._closed or self._leaving):
            self._loads.start(group, function, on_result, on_error or self.trouble.emit, discard)
            self._timer.start()

    def loading(self, group: str) -> bool:
        """Return whether something of the group is being opened."""
        return group in self._loads

    def drop(self, group: str) -> None:
        """Wait no longer for what is being opened."""
        self._loads.drop(group)

    # -- the window's thread ---------------------------------------------------------------------------
    def hand_over(self, call: Callable[[], None]) -> None:
        """Let the window's thread do something; called by others."""
        self._calls.put(call)

    def _take(self) -> None:
        while True:
            try:
                call = self._calls.get_nowait()
            except queue.Empty:
                break
            call()
        self._look()
        if not self.busy:
            self._timer.stop()

    def _look(self) -> None:
        """Look at what is at work, every `POLL_MS` while something is."""

    def leave(self) -> None:
        """Begin nothing any more, and wait for no file; what is computed still reports."""
        self._leaving = True
        self._computations.end()
        self._loads.close(0.0)

    def close(self, wait_s: float = COMPUTATIONS_S) -> None:
        """Wait for the threads, at most ``wait_s``; nothing reports afterwards."""
        self._closed = True
        self._loads.close(min(wait_s, LOADS_S))
        self._computations.close(min(wait_s, COMPUTATIONS_S))
        self._timer.stop()
        self._collector.close()
