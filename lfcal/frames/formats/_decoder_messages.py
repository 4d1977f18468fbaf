"""Capture of messages that decoders in C write to standard error, which may be the only report of damage."""

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
"""Prefixes of messages from LibRaw, libpng and OpenCV; other lines are passed on."""


class _Catch:
    """Redirection of standard error to a file while any decoder works; the first starts it, the last ends it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._users = 0
        self._kept = -1
        self._file: BinaryIO | None = None

    def begin(self) -> int:
        """Redirect standard error to the file; return where the messages of this decoder begin."""
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
        """Return the messages since ``start``, and restore standard error if no other decoder is working."""
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
        """Write messages from other sources to standard error."""
        others = b"".join(line for line in captured.splitlines(keepends=True) if not _COMPLAINTS.search(line))
        if others:
            os.write(2, others)


def _flush() -> None:
    if sys.stderr is not None:
        sys.stderr.flush()


_CATCH = _Catch()


@contextmanager
def caught_messages(mark: str = "") -> Iterator[Callable[[], str]]:
    """Keep messages of decoders off standard error; afterwards, the yielded function returns the first one, or "".

    Threads may decode at the same time; a message counts if it contains ``mark`` (such as the file's name).
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
    """Return where messages begin, None if none can be captured: no standard error, or no space for a file."""
    try:
        os.fstat(2)
        return _CATCH.begin()
    except OSError:
        return None
