"""Which window uses a file: a lock file in its folder names the process. Locks of dead processes are ignored."""

from __future__ import annotations

import socket
from contextlib import suppress
from pathlib import Path

from PySide6.QtCore import QLockFile


class FileLock:
    """The lock ``.NAME.window`` in the folder of a file; the program that writes the file uses ``.NAME.lock``.

    A folder without write access has no locks. Its files count as free, since they cannot be overwritten.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._name = path.with_name(f".{path.name}.window")
        self._lock = QLockFile(str(self._name))
        self._lock.setStaleLockTime(0)  # age says nothing: windows stay open for days

    def take(self) -> bool:
        """Return whether the file is this window's now, or cannot be locked at all."""
        if self._lock.isLocked() or self._lock.tryLock(0):
            return True
        return self._lock.error() != QLockFile.LockError.LockFailedError

    def take_over(self) -> bool:
        """Take the lock from its present owner, on request of the user; return whether this window has it now."""
        with suppress(PermissionError):  # Windows removes no file that is open, on another machine too
            self._name.unlink(missing_ok=True)
        return self.take()

    def holder(self) -> tuple[str, bool]:
        """Return who has the lock in words, and whether it is a process of another machine."""
        process, host, _ = self._lock.getLockInfo() or (0, "", "")
        if not process:
            return "another program", False
        away = host != socket.gethostname()
        return (f"process {process} on {host}" if away else f"another window (process {process})"), away

    def release(self) -> None:
        """Let others have the file."""
        self._lock.unlock()
