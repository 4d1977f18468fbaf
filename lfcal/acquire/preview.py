"""A bounded queue of frames for a window; only here may frames be discarded, the oldest first."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from lfcal.devices import Roi
from lfcal.frames import Position

__all__ = ["LiveFrame", "Preview"]


@dataclass(frozen=True, slots=True)
class LiveFrame:
    """A frame from the camera for display.

    Attributes
    ----------
    data
        Samples of the region of interest, ``(rows, columns)``; a read-only array.
    roi
        Region of the sensor that ``data`` shows (px).
    cutout
        Part of `roi` that is stored, in sensor coordinates (px); None in the live view.
    position
        Position (z, y, x) in the plan; None if the frame has none.
    saturated
        Number of saturated pixels in ``data``.
    what
        Kind of the frame: ``"position"``, ``"dark"``, ``"reference"``, ``"control"`` or ``"live"``.
    """

    data: NDArray[Any]
    roi: Roi
    cutout: Roi | None
    position: Position | None
    saturated: int
    what: str


class Preview:
    """Queue of at most ``size`` frames from the recording thread to one reader; neither of them ever blocks.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from pathlib import Path
    >>> from lfcal.acquire import LiveFrame, Preview, iter_record
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.devices import simulated_rig
    >>> from lfcal.base import drain
    >>> plan = replace(ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0], cutout=21), period=(1, 2))
    >>> preview = Preview()  # another thread may look while it records
    >>> _ = drain(iter_record(Path("watched"), plan, simulated_rig(plan), preview=preview))
    >>> frame: LiveFrame | None = preview.latest()
    >>> print("the last one:", frame.what, "frame of", frame.data.shape, "pixels;", preview.latest() or "none since")
    the last one: reference frame of (21, 22) pixels; none since
    """

    def __init__(self, size: int = 2) -> None:
        self._items: deque[LiveFrame] = deque(maxlen=max(1, size))
        self._lock = threading.Lock()
        self.dropped = 0

    def put(self, frame: LiveFrame) -> None:
        """Add a frame; if the queue is full, its oldest frame is discarded."""
        with self._lock:
            self.dropped += len(self._items) == self._items.maxlen
            self._items.append(frame)

    def latest(self) -> LiveFrame | None:
        """Return the newest frame and discard all others; None if there is none."""
        with self._lock:
            if not self._items:
                return None
            frame = self._items[-1]
            self.dropped += len(self._items) - 1
            self._items.clear()
            return frame
