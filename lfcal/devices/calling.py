"""Calls of drivers with a time limit, so that a hanging driver is reported and never blocks the program."""

from __future__ import annotations

import threading
import time
import weakref
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple

from lfcal.devices.errors import DeviceLost, driver_errors
from lfcal.devices.protocols import Waiting

__all__ = ["ANSWER_S", "CANCELLED", "Caller"]

SLICE_S = 0.05

ANSWER_S = 5.0
"""Waiting time for a driver in addition to the time that a call may take (s)."""

CANCELLED = object()
"""Result of a cancelled call."""


def never() -> bool:
    """Return False: the default for ``cancelled`` in `Caller.call`, which never cancels the call."""
    return False


class _Call(NamedTuple):
    """A call, and the queue that receives its result or error. The result of an abandoned call is discarded."""

    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    answer: SimpleQueue[Any]


class Caller:
    """Caller of one device's driver; all calls are made in the same separate thread.

    A driver may hang in any call. A call that exceeds its time limit, or is cancelled, is abandoned: its later result
    is discarded, and no other call begins before it returns. The thread does not keep the program from ending.

    Parameters
    ----------
    device
        The device; if it states that it never waits (`Waiting`), it is called directly, without a thread.
    name
        Name of the device, for messages.
    """

    def __init__(self, device: object, name: str) -> None:
        self._direct, self._watched = isinstance(device, Waiting) and not device.waits, driver_errors(name)
        self.name = name
        self._calls: SimpleQueue[_Call | None] = SimpleQueue()
        self._abandoned: SimpleQueue[Any] | None = None
        self._hanging = ""
        self._thread: threading.Thread | None = None

    @property
    def hangs(self) -> bool:
        """Whether the driver still hangs in an abandoned call."""
        if self._abandoned is not None and not self._abandoned.empty():
            self._abandoned = None
        return self._abandoned is not None

    def call(
        self,
        what: str,
        function: Callable[..., Any],
        *arguments: Any,
        seconds: float = 0.0,
        cancelled: Callable[[], bool] = never,
    ) -> Any:
        """Return the result of ``function(*arguments)``; `CANCELLED` as soon as ``cancelled`` returns True.

        Parameters
        ----------
        what
            Name of the call, for messages.
        function, arguments
            Function of the driver, and its arguments.
        seconds
            Time that the call may take (s); the wait ends `ANSWER_S` later.
        cancelled
            Function that is called repeatedly while waiting; not called for a device that never waits.

        Raises
        ------
        DeviceLost
            If the driver does not return in time, or still hangs in an earlier call.
        DeviceError
            If the driver raises an error of another library, or a `StorageError` (see `driver_errors`). Other errors of
            lfcal are passed on unchanged.
        """
        if self._direct:
            try:  # about ten calls per frame: a context manager for each would take longer than the checks
                return function(*arguments)
            except BaseException:
                with self._watched:
                    raise
        limit = seconds + ANSWER_S
        if self.hangs and not self._returned(limit, cancelled):
            if cancelled():
                return CANCELLED
            raise DeviceLost(
                f"{self.name}: an earlier call of {self._hanging} has not returned; switch the device off and on"
            )
        call = _Call(function, arguments, SimpleQueue())
        self._running().put(call)
        # repeat until there is an answer, because an interrupt may also end the wait
        self._abandoned, self._hanging = call.answer, what
        answer = _taken(call.answer, limit, cancelled)
        if answer is CANCELLED:
            return CANCELLED
        if answer is None:
            raise DeviceLost(
                f"{self.name}: no answer to {what} within {limit:g} s; check cable and power, then switch it off and on"
            )
        self._abandoned = None
        found, error = answer
        if isinstance(error, KeyboardInterrupt):  # not from the user, whose interrupt reaches only the main thread
            error = RuntimeError("KeyboardInterrupt")
        if error is not None:
            with self._watched:
                raise error
        return found

    def _returned(self, seconds: float, cancelled: Callable[[], bool]) -> bool:
        """Wait for an abandoned call, discard its result, and return whether the call has ended."""
        assert self._abandoned is not None
        if _taken(self._abandoned, seconds, cancelled) in (None, CANCELLED):
            return False
        self._abandoned = None
        return True

    def _running(self) -> SimpleQueue[_Call | None]:
        """Return the queue of the thread, which starts with the first call and ends with this object."""
        if self._thread is None:
            self._thread = threading.Thread(target=_work, args=(self._calls,), name=self.name, daemon=True)
            self._thread.start()
            weakref.finalize(self, self._calls.put, None)
        return self._calls


def _taken(answer: SimpleQueue[Any], seconds: float, cancelled: Callable[[], bool]) -> Any:
    """Return the result; None after ``seconds``, `CANCELLED` if the wait was cancelled."""
    end = time.monotonic() + seconds
    while True:
        try:
            return answer.get(timeout=SLICE_S)
        except Empty:
            if cancelled():
                return CANCELLED
            if time.monotonic() > end:
                return None


def _work(calls: SimpleQueue[_Call | None]) -> None:
    while (call := calls.get()) is not None:
        try:
            call.answer.put((call.function(*call.arguments), None))
        except BaseException as error:  # raise it in the calling thread
            call.answer.put((None, error))
