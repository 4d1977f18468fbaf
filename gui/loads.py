"""Files that are being opened, each in a thread of its own that a disk without an answer may keep for ever. No Qt."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from gui.workers import keep, start_thread, wait_for, words_of

__all__ = ["Loads"]


class Loads:
    """What is being opened, by group; only the newest request of a group reports.

    Parameters
    ----------
    hand_over
        Takes what is to be done in the window's thread.
    """

    def __init__(self, hand_over: Callable[[Callable[[], None]], None]) -> None:
        self._hand_over = hand_over
        self._numbers: dict[str, int] = {}
        self._last = 0
        self._threads: list[threading.Thread] = []

    def __bool__(self) -> bool:
        """Whether something is being opened."""
        return bool(self._numbers)

    def __contains__(self, group: str) -> bool:
        """Return whether something of the group is being opened."""
        return group in self._numbers

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
        number = self._numbers[group] = self._last

        def work() -> None:
            try:
                found = function()
            except BaseException as error:
                keep(group, error)
                words = words_of(error)
                self._hand_over(lambda: self._end(group, number, lambda: on_error(words)))
                return
            too_late = None if discard is None else lambda: discard(found)
            if self._numbers.get(group) == number:
                self._hand_over(lambda: self._end(group, number, lambda: on_result(found), too_late))
            elif too_late is not None:
                too_late()

        self._threads = [thread for thread in self._threads if thread.is_alive()]
        self._threads.append(start_thread(work, "lfcal-load"))

    def _end(
        self, group: str, number: int, report: Callable[[], None], too_late: Callable[[], None] | None = None
    ) -> None:
        if self._numbers.get(group) == number:
            del self._numbers[group]
            report()
        elif too_late is not None:
            too_late()

    def drop(self, group: str) -> None:
        """Wait no longer for what is being opened."""
        self._numbers.pop(group, None)

    def close(self, timeout_s: float) -> None:
        """Drop everything, and wait at most ``timeout_s`` seconds for the threads."""
        self._numbers.clear()
        wait_for(self._threads, timeout_s)
