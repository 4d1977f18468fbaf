"""Check of a file by a child process: some damaged HDF5 files crash or hang the process that opens them.

A process uses one child, which is started for the first file and restarted after a crash. The start takes a quarter of
a second, and each file a millisecond.
"""

from __future__ import annotations

import atexit
import json
import os
import signal
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import IO

from lfcal.base.errors import FileFormatError

__all__ = ["EXAMINE", "probe", "trust"]

CPU_S = 5
"""Processor time allowed for a small file (s)."""

BYTES_PER_S = 20_000_000
"""Bytes of the file that allow one further second."""

PATIENCE = 20
"""Wall-clock seconds allowed per second of processor time: other programs run too, and network disks are slow."""

EXAMINE = "--examine-hdf5"
"""First argument that makes a bundled application the child; it has no separate Python."""

_SCRIPT = Path(__file__).with_name("_examine.py")

_OUT_OF_TIME = {-int(getattr(signal, name)) for name in ("SIGXCPU", "SIGKILL") if hasattr(signal, name)}
"""Exit codes of a child that the system ended because its processor time was used up."""

_OF_PYTHON = (0, 1)
"""Exit codes of a child that ended normally or by a Python exception, which say nothing about the file."""

Mark = tuple[int, int, int, int]


def probe(path: Path, only: tuple[str, ...] | None = None) -> None:
    """Raise `FileFormatError` if a child process that reads the HDF5 file ``path`` crashes or does not finish in time.

    With ``only``, the child reads data only from these datasets, and of large datasets only the middle chunk.

    A file that was checked before and has not changed since is not checked again. A file is accepted without a check if
    no child process can be started (no memory, no permission, libraries that do not load). The same applies if the
    process ends with a Python exception.
    """
    mark = _mark(path)
    with _CHILD.lock:
        if not _CHILD.known.isdisjoint({(mark, None), (mark, only)}):
            return
        seconds = CPU_S + mark[2] // BYTES_PER_S
        finding = _CHILD.ask(path, seconds, only)
        if not finding:
            _CHILD.known.add((mark, only))
            return
    raise FileFormatError.expected(str(path), "an intact HDF5 file", finding, "copy the file again from its source")


def trust(path: Path) -> None:
    """Mark a file that this process has just written as checked, so that `probe` accepts it."""
    with _CHILD.lock:
        _CHILD.known.add((_mark(path), None))


def _mark(path: Path) -> Mark:
    found = path.stat()
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


class _Child:
    """The child process that reads files before this process does."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.known: set[tuple[Mark, tuple[str, ...] | None]] = set()
        self._process: subprocess.Popen[str] | None = None
        self._owner = 0
        self._ready = False

    def ask(self, path: Path, seconds: int, only: tuple[str, ...] | None = None) -> str:
        """Return a text that describes the fault of a file; empty if there is none."""
        process = self._started()
        if process is None:
            return ""
        assert process.stdin is not None and process.stdout is not None
        # requested only now: the child starts while this process continues
        if not self._ready and not _line(process.stdout, CPU_S * PATIENCE)[0]:
            self.end()
            return ""
        self._ready = True
        question = json.dumps([os.path.abspath(path), seconds, only]) + "\n"
        try:
            process.stdin.write(question)
            process.stdin.flush()
        except OSError:  # the child ended while waiting
            self.end()
            return ""
        answer, in_time = _line(process.stdout, seconds * PATIENCE)
        if answer:
            return str(json.loads(answer))
        if not in_time:
            process.kill()
        status = process.wait()
        self.end()
        if not in_time or status in _OUT_OF_TIME:
            return f"damaged data that cannot be read to their end in {seconds} s"
        if status in _OF_PYTHON:
            return ""
        return f"damaged data that crash the process reading them (status {status})"

    def _started(self) -> subprocess.Popen[str] | None:
        """Return the child process; None if none can be started."""
        # after a fork the child still belongs to the parent
        if self._process is not None and (self._owner != os.getpid() or self._process.poll() is not None):
            if self._owner == os.getpid():
                self.end()
            self._process = None
        if self._process is None:
            with suppress(OSError):
                self._process = subprocess.Popen(
                    _words(),
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.DEVNULL,
                    text=True,
                    encoding="utf-8",
                    start_new_session=True,  # Ctrl-C in the terminal is meant for the parent
                    creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
                )
                self._owner, self._ready = os.getpid(), False
        return self._process

    def end(self) -> None:
        """End the child process."""
        process, self._process = self._process, None
        if process is None or self._owner != os.getpid():
            return
        with suppress(OSError):
            process.kill()
        process.wait()
        for pipe in (process.stdin, process.stdout):
            with suppress(OSError):
                assert pipe is not None
                pipe.close()


def _words() -> list[str]:
    """Return the command that starts the child: Python with a script, or the command line of a bundled application.

    If Python runs within another program (MATLAB, Blender), that program would be started; OSError is raised then.
    """
    if getattr(sys, "frozen", False):
        own = Path(sys.executable)
        return [str(own.with_name(f"lfcal{own.suffix}")), EXAMINE]
    if not Path(sys.executable or "").stem.lower().startswith(("python", "pypy")):
        raise OSError(f"{sys.executable}: not a Python interpreter")
    return [sys.executable, "-P", str(_SCRIPT)]


def _line(pipe: IO[str], seconds: float) -> tuple[str, bool]:
    """Return the next line (empty at the end of the pipe), and whether it arrived within ``seconds``."""
    found: list[str] = []
    # not every system can wait for a pipe with a time limit; a thread can
    reader = threading.Thread(target=lambda: found.append(pipe.readline()), daemon=True)
    reader.start()
    reader.join(seconds)
    return (found[0] if found else ""), not reader.is_alive()


_CHILD = _Child()
atexit.register(_CHILD.end)
