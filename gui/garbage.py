"""Collect cyclic garbage in the window's thread alone.

Python collects in whichever thread happens to allocate. A widget that is part of a cycle would then be destroyed by a
worker, which ends the program. While a `Collector` lives, collection happens in the event loop only.
"""

from __future__ import annotations

import gc

from PySide6.QtCore import QObject, QTimer

__all__ = ["Collector"]

INTERVAL_MS = 500


class Collector(QObject):
    """Switch automatic collection off until `close`; look every half second whether a generation is due."""

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._was_on = gc.isenabled()
        gc.disable()
        self._timer = QTimer(self)
        self._timer.setInterval(INTERVAL_MS)
        self._timer.timeout.connect(self.collect)
        self._timer.start()

    def collect(self) -> None:
        """Collect the oldest generation whose threshold is passed."""
        due = [
            k for k, (count, limit) in enumerate(zip(gc.get_count(), gc.get_threshold(), strict=True)) if count > limit
        ]
        if due:
            gc.collect(max(due))

    def close(self) -> None:
        """Leave collection to Python again."""
        self._timer.stop()
        if self._was_on:
            gc.enable()
