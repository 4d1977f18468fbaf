"""The few things asked of the operating system for bytes that must survive, on every platform."""

from __future__ import annotations

import json
import os
import shutil
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from lfcal.errors import StorageError
from lfcal.files import storage_errors
from lfcal.units import format_bytes

__all__ = ["DiskGuard", "FolderLock", "reserve", "sync_data", "sync_folder", "write_at"]

BLOCK = 1 << 24
OPEN_FLAGS = getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0)
"""Flags every descriptor here is opened with."""


def reserve(descriptor: int, size: int) -> None:
    """Reserve ``size`` bytes on disk for the file, so that a full disk shows now and not later."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(descriptor, 0, size)
        return
    have = os.fstat(descriptor).st_size
    zeros = bytes(BLOCK)
    while have < size:
        have += write_at(descriptor, zeros[: min(BLOCK, size - have)], have)


def write_at(descriptor: int, data: bytes | memoryview, offset: int) -> int:
    """Write all of ``data`` at ``offset``, however many calls it takes; return the number of bytes."""
    view = memoryview(data).cast("B")
    done = 0
    while done < len(view):
        if hasattr(os, "pwrite"):
            done += os.pwrite(descriptor, view[done:], offset + done)
        else:
            os.lseek(descriptor, offset + done, os.SEEK_SET)
            done += os.write(descriptor, view[done:])
    return done


def sync_data(descriptor: int) -> None:
    """Return when what was written is on the disk itself."""
    if sys.platform == "darwin":  # fsync stops at the drive's cache there
        import fcntl

        fcntl.fcntl(descriptor, fcntl.F_FULLFSYNC)
    elif hasattr(os, "fdatasync"):
        os.fdatasync(descriptor)
    else:
        os.fsync(descriptor)


def sync_folder(folder: Path) -> None:
    """Make the names in ``folder`` durable where the platform can."""
    if not hasattr(os, "O_DIRECTORY"):
        return
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        with suppress(OSError):  # some file systems cannot flush a folder
            os.fsync(descriptor)
    finally:
        os.close(descriptor)


class FolderLock:
    """Keep a second program out of a session folder; gone with the process, however it ends."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "session.lock"
        with storage_errors(self.path):
            self._descriptor: int | None = os.open(self.path, os.O_RDWR | os.O_CREAT | OPEN_FLAGS, 0o644)
        try:
            _lock(self._descriptor)
        except OSError as error:
            holder = self._holder()
            self.release()
            raise StorageError.expected(
                str(folder),
                "a session that no other program records into",
                f"open in {holder}",
                "end the other program, or choose another folder",
            ) from error
        os.ftruncate(self._descriptor, 0)
        write_at(self._descriptor, json.dumps({"pid": os.getpid()}).encode(), 0)

    def _holder(self) -> str:
        try:
            note: Any = json.loads(self.path.read_text() or "{}")
            return f"another program (process {int(note['pid'])})"
        except (OSError, ValueError, KeyError, TypeError):
            return "another program"

    def release(self) -> None:
        """Let others in; may be called twice."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None


def _lock(descriptor: int) -> None:
    if sys.platform == "win32":
        import msvcrt

        os.lseek(descriptor, 1 << 30, os.SEEK_SET)  # locked bytes cannot be read by others; lock one far away
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
    else:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


class DiskGuard:
    """Ask every few seconds how much the disk has free.

    The recording itself is reserved beforehand; this is for file systems that do not keep a reservation
    (compressing, copy-on-write, network), and for what else must be written.

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
