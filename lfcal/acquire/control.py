"""Requests to a running session, from any thread.

- **pause**: finish the present position, then hold; ``resume`` continues.
- **stop**: finish the present position, then end in order; the session can be resumed.
- **abort**: stop the stage immediately and drop the present frame; the session can be resumed.
"""

from __future__ import annotations

import threading

from lfcal.base import Cancelled
from lfcal.devices import TimeSource

__all__ = ["Aborted", "Control"]

SLICE_S = 0.05


class Aborted(Cancelled):
    """The user asked for an abort."""


class Control:
    """Hand requests from any thread to the thread that records.

    Examples
    --------
    >>> from lfcal.acquire import Control
    >>> control = Control()  # handed to iter_record, and asked by it between frames
    >>> control.stop()
    >>> print(control.stopping, control.aborting)
    True False
    """

    def __init__(self) -> None:
        self._paused = threading.Event()
        self._stop = threading.Event()
        self._abort = threading.Event()
        self._wake = threading.Event()
        self.held = ""
        """Why the session holds still, or empty; set by the recording thread."""

    def pause(self) -> None:
        """Hold after the position under way."""
        self._wake.clear()
        self._paused.set()

    def resume(self) -> None:
        """Continue after a pause."""
        self._paused.clear()
        self._wake.set()

    def stop(self) -> None:
        """End after the position under way."""
        self._stop.set()
        self._wake.set()

    def abort(self) -> None:
        """Stop the stage and end now."""
        # an abort ends a pause and a wait too
        self._abort.set()
        self._stop.set()
        self._wake.set()

    @property
    def pausing(self) -> bool:
        """Whether a pause was asked for."""
        return self._paused.is_set()

    @property
    def stopping(self) -> bool:
        """Whether an end was asked for."""
        return self._stop.is_set()

    @property
    def aborting(self) -> bool:
        """Whether an immediate end was requested."""
        return self._abort.is_set()

    def check(self) -> None:
        """Raise `Aborted` if abort was asked for; called wherever the recording thread waits."""
        if self._abort.is_set():
            raise self.aborted()

    def aborted(self) -> Aborted:
        """Return the error that ends a session immediately."""
        return Aborted("aborted: the stage was stopped; what was acknowledged is safe")

    def wait(self, seconds: float) -> None:
        """Wait in real time, or until a request comes."""
        self._wake.wait(seconds)

    def sleep(self, seconds: float, time: TimeSource) -> None:
        """Let ``seconds`` of the rig's time pass, in slices, with a look for an abort after each."""
        if seconds <= SLICE_S:
            if seconds > 0:
                time.sleep(seconds)
            self.check()
            return
        # in slices, because an abort must reach a thread that settles for minutes
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            time.sleep(min(left, SLICE_S))
            self.check()
