"""Hold a session while the disk is nearly full."""

from __future__ import annotations

import shutil
import time
from pathlib import Path

from lfcal.errors import StorageError
from lfcal.units import format_bytes

__all__ = ["DiskGuard"]


class DiskGuard:
    """Ask every few seconds how much the disk has free.

    The recording itself is reserved beforehand; this is for disks that promise space they do not have,
    and for what else must be written.

    Parameters
    ----------
    folder
        The session's.
    keep_free
        Bytes that must stay free.
    every_s
        Seconds between two looks.
    """

    def __init__(self, folder: Path, keep_free: int, *, every_s: float = 2.0) -> None:
        self._folder, self._keep, self._every = folder, keep_free, every_s
        self._next = 0.0
        self._why = ""

    def __call__(self) -> str:
        """Return why the session should hold, or an empty string."""
        now = time.monotonic()
        if now >= self._next:
            self._next = now + self._every
            try:
                free = shutil.disk_usage(self._folder).free
            except FileNotFoundError:
                raise StorageError(
                    f"{self._folder}: the session folder is gone; restore it, or start a new session"
                ) from None
            self._why = ""
            if free < self._keep:
                self._why = f"disk low: {format_bytes(free)} free, {format_bytes(self._keep)} wanted; free some space"
        return self._why
