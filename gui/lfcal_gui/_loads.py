"""Files that are being opened, each in a thread of its own that a disk without an answer may keep for ever. No Qt."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial
from typing import Any

from lfcal_gui.workers import keep, start_thread, wait_for, words_of

__all__ = ["Loads"]


class Loads:
    """What is being opened, by group; only the newest request of a group reports.

    A request waits for an earlier one of its group, unless that was dropped: a setting changed ten times in a hurry
    opens its files twice, not ten times at once.

    Parameters
    ----------
    hand_over
        Takes what is to be done in the window's thread.
    """

    def __init__(self, hand_over: Callable[[Callable[[], None]], None]) -> None:
        self._hand_over = hand_over
        self._newest: dict[str, int] = {}
        self._running: dict[str, int] = {}
        self._waiting: dict[str, Callable[[], None]] = {}
        self._last = 0
        self._threads: list[threading.Thread] = []

    def __bool__(self) -> bool:
        """Whether something is being opened."""
        return bool(self._newest)

    def __contains__(self, group: str) -> bool:
        """Return whether something of the group is being opened."""
        return group in self._newest

    def start(
        self,
        group: str,
        function: Callable[[], Any],
        on_result: Callable[[Any], None],
        on_error: Callable[[str], None],
        discard: Callable[[Any], None] | None = None,
    ) -> None:
        """Open with ``function``; what comes too late is handed to ``discard``."""
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
        """Take what a thread brought, in the window's thread, and let the next begin."""
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
        """Wait no longer for what is being opened."""
        self._newest.pop(group, None)
        self._running.pop(group, None)
        self._waiting.pop(group, None)

    @property
    def alive(self) -> bool:
        """Whether a thread still opens something, wanted or not."""
        return any(thread.is_alive() for thread in self._threads)

    def close(self, timeout_s: float) -> None:
        """Drop everything, and wait at most ``timeout_s`` seconds for the threads."""
        for group in list(self._newest):
            self.drop(group)
        wait_for(self._threads, timeout_s)


def _nothing() -> None:
    """Nothing was opened that would have to be closed."""
