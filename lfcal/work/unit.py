"""Units of work for any process on any machine, a cache of their input, and numbers of workers."""

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
"""Function that processes a unit, given its arguments, the file to write atomically, and the number of threads."""

PIECE = 1 << 22
"""Bytes of a file that are read at a time."""

DIGITS = 16
"""Digits of a fingerprint; 64 bits distinguish the units of any run."""


@dataclass(frozen=True)
class Unit:
    """Unit of work, described only by paths and plain JSON types, so that any process can do the work.

    Attributes
    ----------
    name
        Name for display and for its file; unique within a run.
    task
        Name of the function of type `Task` that processes the unit, as ``"package.module:function"``.
    arguments
        Arguments of the function by name, as plain JSON types.
    inputs
        Files that the unit reads.
    suffix
        Suffix of the file that the unit writes, with the dot.
    hints
        Further arguments that do not change the result, such as memory limits; they do not affect the fingerprint.
    settled
        Further arguments that change the result only by rounding errors, such as the choice of an algorithm. They may
        depend on the computer, and do not affect the fingerprint. A run that is continued uses the values with which
        the unit was started.
    concurrent_bytes
        Memory that the unit requires with one thread (bytes), if it may run concurrently with other units in one
        process. It is 0 if the unit must run alone.

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
        """Return the fingerprint, a hexadecimal text that depends on task, arguments, inputs and the version of lfcal.

        Of each input, it depends on the absolute path, the size and the modification time.

        Raises
        ------
        StorageError
            If an input does not exist.
        """
        stamps = _stamps(self.inputs)
        return _digest({"lfcal": __version__, "task": self.task, "arguments": plain(self.arguments), "inputs": stamps})

    def function(self) -> Task:
        """Import the function that processes the unit, and return it."""
        module, _, name = self.task.partition(":")
        found: Task = getattr(importlib.import_module(module), name)
        return found


@dataclass(frozen=True)
class Job:
    """A submitted unit: its number in the run, and the file to write.

    Attributes
    ----------
    number
        Number of the unit in the run, from 0.
    unit
        The unit.
    out
        Path of the unit's file, whose name contains the fingerprint; the file exists when the unit is finished.
    """

    number: int
    unit: Unit
    out: str

    def steps(self, workers: int) -> Work[str]:
        """Process the unit with ``workers`` threads; yields progress, and returns the seal of its file (`seal_of`).

        Raises
        ------
        LfcalError
            The error of the unit, or `InputError` if its function does not write the file.
        """
        path = Path(self.out)
        yield from self.unit.function()({**self.unit.arguments, **self.unit.hints, **self.unit.settled}, path, workers)
        if not path.exists():
            raise InputError.expected(f"unit {self.unit.name}", f"the file {path.name}", "none", "correct its task")
        return seal_of(path)


def stamp_of(inputs: Iterable[str]) -> str:
    """Return a fingerprint of files, to use as an argument of units that all read the same large set of files.

    It depends on the absolute path, size and modification time of each file.

    Raises
    ------
    StorageError
        If a file does not exist.
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
    """Return the seal of a file, which shows whether the file has changed: its size in bytes and its CRC-32, as text.

    Raises
    ------
    StorageError
        If the file cannot be read.
    """
    size = check = 0
    with storage_errors(path), path.open("rb") as file:
        while block := file.read(PIECE):
            size, check = size + len(block), zlib.crc32(block, check)
    return f"{size}-{check:08x}"


def file_name(unit: Unit, fingerprint: str) -> str:
    """Return the name of the file that a unit writes: the name of the unit, its ``fingerprint`` and its suffix.

    Characters other than ASCII letters, digits, ``-`` and ``_`` in the name of the unit become ``-``.
    """
    plain_name = "".join(c if c.isascii() and (c.isalnum() or c in "-_") else "-" for c in unit.name)
    return f"{plain_name}.{fingerprint}{unit.suffix}"


T = TypeVar("T")


class ProcessCache(Generic[T]):
    """Cache of the input that units of a run share, which each process keeps until another input is needed.

    Only the last input is kept, because an H, or frames with their corrections, may occupy most of the memory.

    Parameters
    ----------
    close
        Function that releases an input made by `get` before another one replaces it.
    """

    def __init__(self, close: Callable[[T], None]) -> None:
        self._close = close
        self._lock = threading.RLock()
        self._kept: tuple[object, T, bool] | None = None

    def get(self, key: object, make: Callable[[], T]) -> T:
        """Return the input identified by ``key`` from the cache, or else the result of ``make``, which is then kept."""
        with self._lock:
            if self._kept is None or self._kept[0] != key:
                self._drop()
                self._kept = key, make(), True
            return self._kept[1]

    @contextmanager
    def using(self, key: object, value: T) -> Iterator[None]:
        """Return a context in which units of this process use ``value``, opened by their run, as the input ``key``.

        The cache does not release ``value``.
        """
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
    """Return the number of the worker that processes the current unit, from 0; see `numbered` for dask workers.

    It is 0 if there is only one worker.
    """
    return _NUMBER.get()


@contextmanager
def numbered(name: int | str) -> Iterator[None]:
    """Return a context in which `worker_number` returns ``name``; a name that is not a number is converted to one."""
    text = str(name)
    token = _NUMBER.set(int(text) if text.isdecimal() else zlib.crc32(text.encode()))
    try:
        yield
    finally:
        _NUMBER.reset(token)
