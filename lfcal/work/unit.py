"""A unit of work that any process of any machine can do, what its process keeps for it, and its worker's number."""

from __future__ import annotations

import hashlib
import importlib
import json
import os
import threading
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

from lfcal import __version__
from lfcal.base import InputError, Work, plain, storage_errors

__all__ = ["Job", "ProcessCache", "Task", "Unit", "file_name", "numbered", "seal_of", "stamp_of", "worker_number"]

Task = Callable[[Mapping[str, Any], Path, int], Work[None]]
"""Does a unit: its arguments, the file to write whole or not at all, and how many threads it may use."""

PIECE = 1 << 22
"""Bytes of a file that are read at a time."""

DIGITS = 16
"""Of a fingerprint; 64 bits tell the units of any run apart."""


@dataclass(frozen=True)
class Unit:
    """What is to be done, in paths and plain values, never arrays or open files.

    Attributes
    ----------
    name
        For people, and of its file: unique within a run.
    task
        The function that does it, a `Task`: ``"package.module:function"``.
    arguments
        What it is given, plain JSON types.
    inputs
        Files that it reads.
    suffix
        Ending of the file that it writes.
    hints
        Further arguments that do not change the result, and are not in the fingerprint: memory to use.
    settled
        Further arguments that do not change the result but for rounding, and are not in the fingerprint, as they depend
        on the machine: how to compute it. A run that goes on takes those that it was begun with.
    concurrent_bytes
        Bytes of memory that it takes with one thread, where units like it may run at the same time in one process; 0
        where it is done alone.

    Examples
    --------
    >>> from lfcal.work import Unit
    >>> plane = ("plane 0", "mine.tasks:simulate")
    >>> coarse, fine = (Unit(*plane, {"z": 0, "tolerance": t}, inputs=("session/plan.json",)) for t in (0.02, 0.01))
    >>> print(len({unit.fingerprint() for unit in (coarse, fine)}), "different results")
    2 different results
    """

    name: str
    task: str
    arguments: Mapping[str, Any]
    inputs: tuple[str, ...] = ()
    suffix: str = ".h5"
    hints: Mapping[str, Any] = field(default_factory=dict)
    settled: Mapping[str, Any] = field(default_factory=dict)
    concurrent_bytes: int = 0

    def fingerprint(self) -> str:
        """Return what tells this unit's result from that of other inputs, settings, or another lfcal.

        Raises
        ------
        StorageError
            If an input is not there.
        """
        stamps = _stamps(self.inputs)
        return _digest({"lfcal": __version__, "task": self.task, "arguments": plain(self.arguments), "inputs": stamps})

    def function(self) -> Task:
        """Return the function that does it."""
        module, _, name = self.task.partition(":")
        found: Task = getattr(importlib.import_module(module), name)
        return found


@dataclass(frozen=True)
class Job:
    """A unit on its way: its number in the run, and the file it has to write.

    Attributes
    ----------
    number
        Counted from 0.
    unit
        What is to be done.
    out
        Its file, whose name holds the fingerprint: it is there when the unit is done.
    """

    number: int
    unit: Unit
    out: str

    def steps(self, workers: int) -> Work[str]:
        """Do it with so many threads; yields progress, returns the `seal_of` its file, and closing it stops."""
        path = Path(self.out)
        yield from self.unit.function()({**self.unit.arguments, **self.unit.hints, **self.unit.settled}, path, workers)
        if not path.exists():
            raise InputError.expected(f"unit {self.unit.name}", f"the file {path.name}", "none", "mend its task")
        return seal_of(path)


def stamp_of(inputs: Iterable[str]) -> str:
    """Return what tells files from what they were before: an argument of units that all read the same many files.

    Raises
    ------
    StorageError
        If one is not there.
    """
    return _digest(_stamps(inputs))


def _stamps(inputs: Iterable[str]) -> list[list[Any]]:
    """Return name, size and time of each file."""
    stamps: list[list[Any]] = []
    for name in inputs:
        path = Path(name)
        with storage_errors(path):
            found = path.stat()
        stamps.append([os.fspath(path.absolute()), found.st_size, found.st_mtime_ns])
    return stamps


def _digest(data: Any) -> str:
    text = json.dumps(data, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:DIGITS]


def seal_of(path: Path) -> str:
    """Return size and checksum (CRC-32) of a file, by which it is known again.

    Raises
    ------
    StorageError
        If it cannot be read.
    """
    size = check = 0
    with storage_errors(path), path.open("rb") as file:
        while block := file.read(PIECE):
            size, check = size + len(block), zlib.crc32(block, check)
    return f"{size}-{check:08x}"


def file_name(unit: Unit, fingerprint: str) -> str:
    """Return the name of a unit's file."""
    plain_name = "".join(c if c.isascii() and (c.isalnum() or c in "-_") else "-" for c in unit.name)
    return f"{plain_name}.{fingerprint}{unit.suffix}"


T = TypeVar("T")


class ProcessCache(Generic[T]):
    """The input that units of a run share, kept in each process until another run needs its own.

    Only the last is kept: an H, or frames with their corrections, may take most of the memory.

    Parameters
    ----------
    close
        Releases what is kept, before that of another run replaces it.
    """

    def __init__(self, close: Callable[[T], None]) -> None:
        self._close = close
        self._lock = threading.RLock()
        self._kept: tuple[object, T, bool] | None = None

    def get(self, key: object, make: Callable[[], T]) -> T:
        """Return the input that ``key`` identifies: the one that is kept, or what ``make`` returns."""
        with self._lock:
            if self._kept is None or self._kept[0] != key:
                self._drop()
                self._kept = key, make(), True
            return self._kept[1]

    @contextmanager
    def using(self, key: object, value: T) -> Iterator[None]:
        """Let the units of this process use ``value``, which their run has made, until the end of the block."""
        with self._lock:
            self._drop()
            self._kept = key, value, False
        try:
            yield
        finally:
            with self._lock:
                if self._kept is not None and self._kept[1] is value:
                    self._kept = None

    def _drop(self) -> None:
        kept, self._kept = self._kept, None
        if kept is not None and kept[2]:
            self._close(kept[1])


_NUMBER: ContextVar[int] = ContextVar("worker", default=0)


def worker_number() -> int:
    """Return the number of the worker that does the present unit, from 0; 0 where there is one alone."""
    return _NUMBER.get()


@contextmanager
def numbered(name: int | str) -> Iterator[None]:
    """Give the units inside this block a worker's number, or one that follows from its name."""
    text = str(name)
    token = _NUMBER.set(int(text) if text.isdecimal() else zlib.crc32(text.encode()))
    try:
        yield
    finally:
        _NUMBER.reset(token)
