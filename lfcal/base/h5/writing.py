"""New HDF5 files, written so that a failing disk raises an ordinary error.

A write that fails while HDF5 flushes or closes a file can crash the process (SIGSEGV, SIGBUS). Here HDF5 writes through
an object that records the first failure and keeps everything after it in memory. The file is then closed normally, and
the failure is raised.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from lfcal.base.files import replace_whole, storage_errors
from lfcal.base.h5.probe import trust
from lfcal.base.system import write_at

__all__ = ["new_h5"]


@contextmanager
def new_h5(
    path: str | os.PathLike[str], *, header: bytes = b"", libver: tuple[str, str] | None = None
) -> Iterator[Any]:
    """Yield an open h5py file to write to; it replaces ``path`` if the block succeeds, and is removed otherwise.

    Parameters
    ----------
    path
        Path of the file; an existing one is replaced.
    header
        Content of the user block before the HDF5 data; its length must be 0, 512, 1024, 2048 … bytes.
    libver
        Oldest and newest version of the format that HDF5 may use. None: HDF5 chooses.

    Raises
    ------
    StorageError
        If the file cannot be written; an existing file of that name is kept.
    """
    import h5py

    target = Path(path)
    with storage_errors(target), replace_whole(target) as part:
        with _Bytes(part) as raw:
            file = h5py.File(raw, "w", userblock_size=len(header), libver=libver)
            try:
                yield file
            finally:
                raw.closing = True  # a flush that reports a failure leaves a file that cannot be closed
                file.close()
            raw.check()
            # HDF5 does not touch these bytes, but only after it has finished
            raw.seek(0)
            raw.write(header)
            raw.check()
    with storage_errors(target):
        trust(target)


class _Bytes:
    """File-like object that HDF5 writes to (h5py's ``fileobj`` driver)."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("w+b", buffering=0)
        self._at = 0
        self._failure: OSError | None = None
        self._kept: list[tuple[int, bytes]] = []
        self.closing = False
        """Set before the file is closed: failures must not be reported to HDF5 then."""

    def __enter__(self) -> _Bytes:
        return self

    def __exit__(self, *error: object) -> None:
        self._file.close()

    def check(self) -> None:
        """Raise the failure that occurred while the file was closed."""
        if self._failure is not None:
            raise self._failure

    # -- methods that HDF5 calls ---------------------------------------------------------------------------------
    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Seek to a byte."""
        if whence == os.SEEK_END:
            end = max((start + len(data) for start, data in self._kept), default=0)
            offset += max(end, self._file.seek(0, os.SEEK_END))
        elif whence == os.SEEK_CUR:
            offset += self._at
        self._at = offset
        return offset

    def tell(self) -> int:
        """Return the position."""
        return self._at

    def write(self, data: Any) -> int:
        """Write all of ``data``; after a failure, keep it in memory."""
        view = memoryview(data)
        if self._failure is None:
            try:
                self._write(view)
            except OSError as error:
                self._fail(error)
                self._kept.append((self._at, bytes(view)))
        else:
            self._kept.append((self._at, bytes(view)))
        self._at += len(view)
        return len(view)

    def _write(self, view: memoryview) -> None:
        write_at(self._file.fileno(), view, self._at)

    def _fail(self, error: OSError) -> None:
        self._failure = error
        if not self.closing:
            raise error

    def read(self, size: int = -1) -> bytes:
        """Return the next bytes; h5py recognises a file-like object by this method, HDF5 calls `readinto`."""
        buffer = bytearray(size)
        self.readinto(memoryview(buffer))
        return bytes(buffer)

    def readinto(self, buffer: Any) -> int:
        """Fill ``buffer`` from the current position; bytes beyond the end of the file are zeros."""
        view = memoryview(buffer)
        self._file.seek(self._at)
        done = 0
        while done < len(view) and (count := self._file.readinto(view[done:])):
            done += count
        view[done:] = bytes(len(view) - done)
        for start, data in self._kept:
            first, last = max(start, self._at), min(start + len(data), self._at + len(view))
            if first < last:
                view[first - self._at : last - self._at] = data[first - start : last - start]
        self._at += len(view)
        return len(view)

    def truncate(self, size: int | None = None) -> int:
        """Truncate or extend the file."""
        size = self._at if size is None else size
        if self._failure is None:
            try:
                self._file.truncate(size)
            except OSError as error:
                self._fail(error)
        return size

    def flush(self) -> None:
        """Do nothing: writes are not buffered."""
