"""Locks of project files: a lock file in the same folder names the process. Locks of ended processes are ignored."""

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
        """Lock the file; return False if another window has it.

        If the folder cannot be written, the file is not locked, and the result is True.
        """
        if self._lock.isLocked() or self._lock.tryLock(0):
            return True
        return self._lock.error() != QLockFile.LockError.LockFailedError

    def take_over(self) -> bool:
        """Take the lock from its owner at the user's request; return whether this succeeded."""
        with suppress(PermissionError):  # Windows removes no file that is open, on another machine too
            self._name.unlink(missing_ok=True)
        return self.take()

    def holder(self) -> tuple[str, bool]:
        """Return a description of the owner of the lock, and whether it is a process on another machine."""
        process, host, _ = self._lock.getLockInfo() or (0, "", "")
        if not process:
            return "another program", False
        away = host != socket.gethostname()
        return (f"process {process} on {host}" if away else f"another window (process {process})"), away

    def release(self) -> None:
        """Release the lock."""
        self._lock.unlock()
