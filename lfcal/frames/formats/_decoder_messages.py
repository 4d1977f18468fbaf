"""What decoders in C write to standard error: it is caught, and tells of damage that they do not report otherwise."""

from __future__ import annotations

import os
import re
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import BinaryIO

__all__ = ["caught_messages"]

_COMPLAINTS = re.compile(rb"(Unexpected end of file|data corrupted at|libpng |\[[ A-Z]+:\d+@)")
"""Marks of LibRaw, libpng and OpenCV; lines of others are passed on."""


class _Catch:
    """Standard error in a file while any decoder works; the first to come turns it, the last to go restores it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._users = 0
        self._kept = -1
        self._file: BinaryIO | None = None

    def begin(self) -> int:
        """Turn standard error to the file; return where the messages of this user begin."""
        with self._lock:
            if self._file is None:
                file = tempfile.TemporaryFile(buffering=0)
                _flush()
                self._kept = os.dup(2)
                os.dup2(file.fileno(), 2)
                self._file = file
            self._users += 1
            return os.fstat(self._file.fileno()).st_size

    def end(self, start: int) -> bytes:
        """Return what was written since ``start``, and restore standard error if nobody else needs it turned."""
        with self._lock:
            assert self._file is not None
            _flush()
            size = os.fstat(self._file.fileno()).st_size
            self._file.seek(start)
            captured = self._file.read(size - start)
            self._users -= 1
            if not self._users:
                os.dup2(self._kept, 2)
                os.close(self._kept)
                self._file.seek(0)
                self._pass_on(self._file.read())
                self._file.close()
                self._file = None
            else:
                self._file.seek(0, os.SEEK_END)
            return captured

    @staticmethod
    def _pass_on(captured: bytes) -> None:
        """Write to standard error what came from others in the meantime."""
        others = b"".join(line for line in captured.splitlines(keepends=True) if not _COMPLAINTS.search(line))
        if others:
            os.write(2, others)


def _flush() -> None:
    if sys.stderr is not None:
        sys.stderr.flush()


_CATCH = _Catch()


@contextmanager
def caught_messages(mark: str = "") -> Iterator[Callable[[], str]]:
    """Keep complaints of decoders off standard error; the value returns the first, "" where there was none.

    Threads may decode at the same time; a complaint counts where ``mark`` (such as the file's name) is in it.
    """
    start = _begun()
    if start is None:
        yield lambda: ""
        return
    captured = [b""]

    def complaint() -> str:
        lines = captured[0].splitlines()
        found = (line for line in lines if _COMPLAINTS.search(line) and mark.encode() in line)
        return next(found, b"").decode(errors="replace")

    try:
        yield complaint
    finally:
        captured[0] = _CATCH.end(start)


def _begun() -> int | None:
    """Return where messages begin, None where none can be caught: no standard error, or no room for a file of them."""
    try:
        os.fstat(2)
        return _CATCH.begin()
    except OSError:
        return None
