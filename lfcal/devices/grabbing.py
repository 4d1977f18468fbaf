"""Waiting for a frame in a thread of its own, so that an abort need not wait for the driver."""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple, Protocol

from lfcal.devices.errors import DeviceLost

__all__ = ["Grabber"]

SLICE_S = 0.05


class _Camera(Protocol):
    """What is asked of a camera here; its frames are handed on as they are."""

    @property
    def name(self) -> str: ...

    def grab(self, timeout_s: float) -> Any: ...


class _Call(NamedTuple):
    """A call of ``grab``, and where its frame or error goes; nobody looks there once the call is abandoned."""

    grab: Callable[[float], Any]
    timeout_s: float
    answer: SimpleQueue[Any]


class Grabber:
    """Calls the ``grab`` of one rig's camera.

    A driver may wait for minutes, or for ever, deaf to everything. Its call is then abandoned: what it returns later is
    dropped, and no other begins before it has returned. The thread does not keep the program from ending.

    A camera that never waits says so with an attribute ``waits = False`` and is called directly.
    """

    def __init__(self) -> None:
        self._calls: SimpleQueue[_Call | None] = SimpleQueue()
        self._abandoned: SimpleQueue[Any] | None = None
        self._thread: threading.Thread | None = None

    @property
    def hangs(self) -> bool:
        """Whether the driver still is in a call that was abandoned."""
        if self._abandoned is not None and not self._abandoned.empty():
            self._abandoned = None
        return self._abandoned is not None

    def grab(self, camera: _Camera, timeout_s: float, cancelled: Callable[[], bool]) -> Any:
        """Return what ``camera.grab(timeout_s)`` returns or raise what it raises; None once ``cancelled`` is true.

        Raises
        ------
        DeviceLost
            If the driver does not come back from a call that was abandoned earlier.
        """
        if not getattr(camera, "waits", True):
            return camera.grab(timeout_s)
        if self.hangs and not self._returned(timeout_s, cancelled):
            if cancelled():
                return None
            raise DeviceLost(f"{camera.name}: still hangs in an earlier frame; switch it off and on")
        call = _Call(camera.grab, timeout_s, SimpleQueue())
        self._running().put(call)
        # until an answer is there: an interrupt may end the wait as well
        self._abandoned = call.answer
        answer = _answer(call, cancelled)
        if answer is None:
            return None
        self._abandoned = None
        if isinstance(answer, BaseException):
            raise answer
        return answer

    def _returned(self, timeout_s: float, cancelled: Callable[[], bool]) -> bool:
        """Wait for an abandoned call, drop what it brings, and return whether it came."""
        assert self._abandoned is not None
        left = timeout_s
        while left > 0 and not cancelled():
            try:
                self._abandoned.get(timeout=min(left, SLICE_S))
            except Empty:
                left -= SLICE_S
                continue
            self._abandoned = None
            return True
        return False

    def _running(self) -> SimpleQueue[_Call | None]:
        """Return the queue of the thread, which begins with the first call and ends with this object."""
        if self._thread is None:
            self._thread = threading.Thread(target=_work, args=(self._calls,), name="camera", daemon=True)
            self._thread.start()
            weakref.finalize(self, self._calls.put, None)
        return self._calls


def _answer(call: _Call, cancelled: Callable[[], bool]) -> Any:
    while True:
        try:
            return call.answer.get(timeout=SLICE_S)
        except Empty:
            if cancelled():
                return None


def _work(calls: SimpleQueue[_Call | None]) -> None:
    while (call := calls.get()) is not None:
        try:
            call.answer.put(call.grab(call.timeout_s))
        except BaseException as error:  # it belongs to the thread that asked
            call.answer.put(error)
