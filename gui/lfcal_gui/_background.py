"""Background work without a job: quick computations, and opening files. Outdated results are dropped.

Threads never touch Qt. They put functions into a queue, and a timer in the window's thread calls them.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from PySide6.QtCore import QObject, QTimer, Signal

from lfcal.base import WorkAbandoned, abandonable
from lfcal_gui._garbage import Collector
from lfcal_gui.workers import Workers, keep, start_thread, wait_for, words_of


class Computations:
    """Run functions in a few threads. While a function of a group runs, only the newest other one is queued.

    ``hand_over`` queues a function to run in the window's thread.
    """

    def __init__(self, hand_over: Callable[[Callable[[], None]], None]) -> None:
        self._hand_over = hand_over
        self._workers = Workers(2, "lfcal-compute")
        self._generation: dict[str, int] = {}
        self._pending: dict[str, int] = {}
        self._closed = self._ending = False

    def __bool__(self) -> bool:
        """Whether a computation is running, or its result has not been delivered yet."""
        return any(self._pending.values())

    def start(
        self,
        group: str,
        function: Callable[[], Any],
        on_result: Callable[[Any], None],
        on_error: Callable[[str], None],
    ) -> None:
        """Queue ``function``; do nothing after `end`.

        The result is passed to ``on_result``, or the message of an error to ``on_error``.
        """
        if self._ending:
            return
        generation = self._generation[group] = self._generation.get(group, 0) + 1
        self._pending[group] = self._pending.get(group, 0) + 1

        def stale() -> bool:
            return self._closed or self._generation[group] != generation

        def ended(report: Callable[[Any], None], value: Any) -> None:
            self._pending[group] -= 1
            if not stale():
                report(value)

        def compute() -> None:
            if stale() or self._ending:
                self._hand_over(lambda: ended(_nobody, None))
                return
            report: Callable[[Any], None] = on_result
            value: Any
            try:
                with abandonable(lambda: not (stale() or self._ending)):
                    value = function()
            except WorkAbandoned:
                report, value = _nobody, None
            except BaseException as error:
                keep(group, error)
                report, value = on_error, words_of(error)
            self._hand_over(lambda: ended(report, value))

        self._workers.submit(compute)

    def end(self) -> None:
        """Start nothing more. Running computations still report, unless they were cancelled."""
        self._ending = True

    def close(self, timeout_s: float) -> None:
        """Drop queued functions, and wait at most ``timeout_s`` seconds for running ones. Results are discarded."""
        self._closed = True
        self._workers.close(timeout_s)


def _nobody(_: Any) -> None:
    """Discard the result of a cancelled request."""


class Loads:
    """Open files in threads, by group. Only the newest request of a group reports.

    A request waits for an earlier one of its group, unless the earlier one was dropped. A setting changed ten times
    quickly opens its files twice, not ten times. ``hand_over`` queues a function to run in the window's thread.
    """

    def __init__(self, hand_over: Callable[[Callable[[], None]], None]) -> None:
        self._hand_over = hand_over
        self._newest: dict[str, int] = {}
        self._running: dict[str, int] = {}
        self._waiting: dict[str, Callable[[], None]] = {}
        self._last = 0
        self._threads: list[threading.Thread] = []

    def __bool__(self) -> bool:
        """Whether any file is being opened."""
        return bool(self._newest)

    def __contains__(self, group: str) -> bool:
        """Return whether a request of the group is in progress."""
        return group in self._newest

    def start(
        self,
        group: str,
        function: Callable[[], Any],
        on_result: Callable[[Any], None],
        on_error: Callable[[str], None],
        discard: Callable[[Any], None] | None = None,
    ) -> None:
        """Call ``function`` in a thread; a result that arrives too late is passed to ``discard``."""
        self._last += 1
        number = self._newest[group] = self._last

        def work() -> None:
            too_late: Callable[[], None] = _nothing
            try:
                found = function()
            except BaseException as error:
                keep(group, error)
                words = words_of(error)
                report = partial(on_error, words)
            else:
                report = partial(on_result, found)
                too_late = _nothing if discard is None else partial(discard, found)
            if self._running.get(group) == number:
                self._hand_over(lambda: self._end(group, number, report, too_late))
            else:
                too_late()

        if group in self._running:
            self._waiting[group] = lambda: self._launch(group, number, work)
        else:
            self._launch(group, number, work)

    def _launch(self, group: str, number: int, work: Callable[[], None]) -> None:
        self._running[group] = number
        self._threads = [thread for thread in self._threads if thread.is_alive()]
        self._threads.append(start_thread(work, "lfcal-load"))

    def _end(self, group: str, number: int, report: Callable[[], None], too_late: Callable[[], None]) -> None:
        """Deliver the result of a thread, in the window's thread, and start the next request of the group."""
        if self._running.get(group) != number:
            too_late()
            return
        del self._running[group]
        following = self._waiting.pop(group, None)
        if following is not None:
            too_late()
            following()
        else:
            del self._newest[group]
            report()

    def drop(self, group: str) -> None:
        """Drop the requests of a group; their results are discarded."""
        self._newest.pop(group, None)
        self._running.pop(group, None)
        self._waiting.pop(group, None)

    @property
    def alive(self) -> bool:
        """Whether a thread is still running, even one whose request was dropped."""
        return any(thread.is_alive() for thread in self._threads)

    def close(self, timeout_s: float) -> None:
        """Drop all requests, and wait at most ``timeout_s`` seconds for the threads."""
        for group in list(self._newest):
            self.drop(group)
        wait_for(self._threads, timeout_s)


def _nothing() -> None:
    """Do nothing: there is no result to discard."""


POLL_MS = 8

TURN_S = 0.01
"""Processor time after which the remaining calls are left for the next turn of the event loop (s)."""

COMPUTATIONS_S, LOADS_S = 5.0, 1.0
"""Longest wait when closing: for computations, and for threads that open files (s)."""


class BackgroundThreads(QObject):
    """Background threads of the window. Their results are delivered in the window's thread."""

    trouble = Signal(str)
    """Reason why a computation, or opening a file, failed; only if the caller does not handle errors."""

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._calls: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._computations = Computations(self.hand_over)
        self._loads = Loads(self.hand_over)
        self._timer = QTimer(self, interval=POLL_MS)
        self._timer.timeout.connect(self._take)
        self._closed = self._leaving = self._waited = False
        self._left, self._worked_s = 0, 0.0
        self._collector = Collector(self, lambda: self.busy)  # threads must not destroy widgets

    @property
    def busy(self) -> bool:
        """Whether a thread is running, or its result has not been delivered yet."""
        return bool(self._loads) or bool(self._computations) or not self._calls.empty()

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
        """Whether a computation is running, or its result has not been delivered yet."""
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
        """Open something in its own thread. A disk that does not answer may block that thread for ever.

        Only the newest request of a ``group`` reports. It waits for an earlier one unless that one was dropped. A
        result that arrives too late is passed to ``discard``.
        """
        if not (self._closed or self._leaving):
            self._loads.start(group, function, on_result, on_error or self.trouble.emit, discard)
            self._timer.start()

    def loading(self, group: str) -> bool:
        """Return whether a request of the group is in progress."""
        return group in self._loads

    def drop(self, group: str) -> None:
        """Drop the requests of a group; their results are discarded."""
        self._loads.drop(group)

    # -- the window's thread ---------------------------------------------------------------------------
    def hand_over(self, call: Callable[[], None]) -> None:
        """Queue a call for the window's thread; may be called from any thread."""
        self._calls.put(call)

    def later(self, call: Callable[[], None]) -> None:
        """Make a call in a later turn of the event loop, before results that arrive in the meantime are delivered."""

        def left() -> None:
            self._left -= 1
            call()

        if not self._closed:
            self._left += 1
            self.hand_over(left)
            self._timer.start()

    def _take(self) -> None:
        """Deliver results; calls that were left wait for another turn if this one has drawn the window."""
        began = time.thread_time()
        if self._left and not self._waited and began - self._worked_s > TURN_S:
            self._waited = True
            return
        self._waited = False
        while time.thread_time() < began + TURN_S:
            try:
                call = self._calls.get_nowait()
            except queue.Empty:
                break
            call()
        self._look()
        if not self.busy:
            self._timer.stop()
        self._worked_s = time.thread_time()

    def _look(self) -> None:
        """Check running work; called every `POLL_MS` while there is any."""

    def leave(self) -> None:
        """Accept no more requests and drop those that open files; running computations still report."""
        self._leaving = True
        self._computations.end()
        self._loads.close(0.0)

    def close(self, wait_s: float = COMPUTATIONS_S) -> None:
        """Wait at most ``wait_s`` seconds for the threads; later results are discarded."""
        self._closed = True
        self._loads.close(min(wait_s, LOADS_S))
        self._computations.close(min(wait_s, COMPUTATIONS_S))
        self._timer.stop()
        self._collector.close()
