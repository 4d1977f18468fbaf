"""Protection of a session on disk: a lock that excludes other programs, and a check of the free space."""

from __future__ import annotations

import json
import os
import shutil
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from lfcal.base import OPEN_FLAGS, StorageError, format_bytes, lock, parse_json, read_text, storage_errors, write_at

__all__ = ["DiskGuard", "FolderLock", "Holder", "holder_of"]

LOCK = "session.lock"

NOTE_BYTES, LONGEST = 2000, 400
"""Size of the note in a lock (bytes), and the largest number of characters of its reason."""


class FolderLock:
    """Lock of a session folder that excludes other programs; the system releases it when the process ends.

    Raises `StorageError` if another program holds the lock, or the folder cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / LOCK
        with storage_errors(self.path):
            self._descriptor: int | None = os.open(self.path, os.O_RDWR | os.O_CREAT | OPEN_FLAGS, 0o644)
        try:
            lock(self._descriptor)
        except OSError as error:
            holder = self._holder()
            self.release()
            raise StorageError.expected(
                str(folder),
                "a session that no other program records into",
                f"one open in {holder}",
                "end the other program, or choose another folder",
            ) from error
        self.note("")

    def note(self, held: str) -> None:
        """Write the process ID of this program and the reason for a pause into the lock file.

        ``held`` is the reason; empty: not paused. Only its first `LONGEST` characters are written.

        Disk errors are ignored, because the note is only for display, and a full disk is the most frequent reason for a
        pause.
        """
        assert self._descriptor is not None
        text = json.dumps({"pid": os.getpid(), "held": held[:LONGEST]}, ensure_ascii=False)
        with suppress(OSError):
            # always of the same length, so that no more disk space is needed
            write_at(self._descriptor, text.encode("utf-8", "replace").ljust(NOTE_BYTES), 0)

    def _holder(self) -> str:
        found = _read_lock(self.path)
        return "another program" + (f" (process {found.process})" if found.process else "")

    def release(self) -> None:
        """Release the lock; may be called twice."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None


class Holder(NamedTuple):
    """The program that records into a session folder.

    Attributes
    ----------
    process
        Process ID of the program; 0 if unknown.
    held
        Reason why the recording is paused; empty if it is not paused or the reason is unknown.
    """

    process: int
    held: str


def holder_of(folder: Path) -> Holder | None:
    """Return the program that is recording into ``folder``; None if there is none or the lock file cannot be opened."""
    path = folder / LOCK
    try:
        descriptor = os.open(path, os.O_RDWR | OPEN_FLAGS)
    except OSError:
        return None
    try:
        lock(descriptor)
    except OSError:
        return _read_lock(path)
    finally:
        os.close(descriptor)
    return None


def _read_lock(path: Path) -> Holder:
    try:
        note: Any = parse_json(read_text(path, limit=4000) or "{}", str(path))
        return Holder(int(note["pid"]), str(note.get("held", "")))
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return Holder(0, "")


class DiskGuard:
    """Guard that checks the free disk space when it is called, at most once in ``every_s``.

    The recording itself reserves its space beforehand. This check is for file systems that do not keep a reservation
    (compressing, copy-on-write, network), and for other files that fill the disk.

    Parameters
    ----------
    folder
        Folder of the session.
    keep_free
        Disk space that must stay free (bytes).
    every_s
        Shortest time between two checks (s); calls in between return the previous result.
    """

    def __init__(self, folder: Path, keep_free: int, *, every_s: float = 2.0) -> None:
        self._folder, self._keep, self._every = folder, keep_free, every_s
        self._next = 0.0
        self._why = ""

    def __call__(self) -> str:
        """Return the reason why the session should pause; empty if there is none.

        Raises `StorageError` if the folder no longer exists.
        """
        now = time.monotonic()
        if now >= self._next:
            self._next = now + self._every
            try:
                free = shutil.disk_usage(self._folder).free
            except (FileNotFoundError, NotADirectoryError):
                raise StorageError(
                    f"{self._folder}: the session folder is missing; restore it from a copy, or start a new session"
                ) from None
            self._why = ""
            if free < self._keep:
                self._why = f"disk low: {format_bytes(free)} free, {format_bytes(self._keep)} required; free some space"
        return self._why
