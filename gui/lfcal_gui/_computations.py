"""Quick computations in the background, of which only the newest of a group reports. No Qt."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from lfcal.base import WorkAbandoned, abandonable
from lfcal_gui.workers import Workers, keep, words_of

__all__ = ["Computations"]


class Computations:
    """Functions that a few threads compute; while one of a group is computed, at most one more waits: the newest.

    Parameters
    ----------
    hand_over
        Takes what is to be done in the window's thread.
    """

    def __init__(self, hand_over: Callable[[Callable[[], None]], None]) -> None:
        self._hand_over = hand_over
        self._workers = Workers(2, "lfcal-compute")
        self._generation: dict[str, int] = {}
        self._pending: dict[str, int] = {}
        self._closed = self._ending = False

    def __bool__(self) -> bool:
        """Whether something is computed, or its result waits to be shown."""
        return any(self._pending.values())

    def start(
        self,
        group: str,
        function: Callable[[], Any],
        on_result: Callable[[Any], None],
        on_error: Callable[[str], None],
    ) -> None:
        """Compute, unless all is to end; the words of an error go to ``on_error``."""
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
        """Begin nothing any more; what is under way still reports, unless it hears that nobody waits for it."""
        self._ending = True

    def close(self, timeout_s: float) -> None:
        """Drop what waits, and wait at most ``timeout_s`` seconds for what is under way; nothing reports any more."""
        self._closed = True
        self._workers.close(timeout_s)


def _nobody(_: Any) -> None:
    """Nobody waits for it any more."""
