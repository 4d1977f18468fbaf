"""Pause, stop or abort a running session, from any thread.

- **pause**: finish the current position, then wait; ``resume`` continues.
- **stop**: finish the current position, then end normally; the session can be resumed.
- **abort**: stop the stage immediately and discard the current frame; the session can be resumed.
"""

from __future__ import annotations

import threading

from lfcal.base import Cancelled
from lfcal.devices import TimeSource

__all__ = ["Aborted", "Control"]

SLICE_S = 0.05


class Aborted(Cancelled):
    """The user aborted the work."""


class Control:
    """Channel for requests to pause, stop or abort, from any thread to the recording thread.

    Examples
    --------
    >>> from lfcal.acquire import Control
    >>> control = Control()  # pass it to iter_record, which checks it between frames
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
        """Reason why the session is on hold, set by the recording thread; empty if it is not."""

    def pause(self) -> None:
        """Request a pause after the current position."""
        self._wake.clear()
        self._paused.set()

    def resume(self) -> None:
        """Request that the recording continue after a pause."""
        self._paused.clear()
        self._wake.set()

    def stop(self) -> None:
        """Request a stop after the current position."""
        self._stop.set()
        self._wake.set()

    def abort(self) -> None:
        """Request that the stage be stopped and the session end immediately."""
        # an abort ends a pause and a wait too
        self._abort.set()
        self._stop.set()
        self._wake.set()

    @property
    def pausing(self) -> bool:
        """Whether a pause was requested."""
        return self._paused.is_set()

    @property
    def stopping(self) -> bool:
        """Whether a stop was requested."""
        return self._stop.is_set()

    @property
    def aborting(self) -> bool:
        """Whether an abort was requested."""
        return self._abort.is_set()

    def check(self) -> None:
        """Raise `Aborted` if an abort was requested."""
        if self._abort.is_set():
            raise self.aborted()

    def aborted(self) -> Aborted:
        """Return the error that the recording thread raises after an abort; this method does not raise it."""
        return Aborted("aborted: the stage was stopped; acknowledged frames are safe")

    def wait(self, seconds: float) -> None:
        """Wait until a resume, stop or abort is requested, at most ``seconds`` of real time."""
        self._wake.wait(seconds)

    def sleep(self, seconds: float, time: TimeSource) -> None:
        """Wait for ``seconds`` on the clock ``time``; raise `Aborted` soon after an abort is requested."""
        if seconds <= SLICE_S:
            if seconds > 0:
                time.sleep(seconds)
            self.check()
            return
        # wait in slices, so that an abort is noticed even during a settling time of minutes
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            time.sleep(min(left, SLICE_S))
            self.check()
