"""What HDF5 says of damaged data, in one line."""

from __future__ import annotations

import errno
from pathlib import Path

from lfcal.base.errors import FileFormatError, LfcalError
from lfcal.base.files import storage_errors, system_error

__all__ = ["damage"]

_OF_THE_DISK = {errno.EIO, errno.EACCES, errno.EPERM, errno.ESTALE, errno.ENODEV, errno.ENOENT}
"""Errors that speak of the disk and not of what lies on it."""


class damage:
    """Context that turns whatever h5py raises on damaged data into a `FileFormatError` naming ``where``.

    h5py raises KeyError, RuntimeError, OSError, TypeError, ValueError, OverflowError and UnicodeError alike.
    """

    # a class: entered for every pattern that is read, where a generator would cost as much as the read
    __slots__ = ("_path", "_where")

    def __init__(self, path: Path, where: str = "") -> None:
        self._path, self._where = path, where

    def __enter__(self) -> None:
        """Begin to watch."""

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """Raise `FileFormatError` or `StorageError` in place of h5py's error."""
        if not isinstance(error, Exception) or isinstance(error, LfcalError):
            return
        if isinstance(error, OSError | RuntimeError) and system_error(error) in _OF_THE_DISK:
            with storage_errors(self._path):
                raise error
        said = " ".join(str(error).split())[:120] or type(error).__name__
        where = f"{self._path}:/{self._where}" if self._where else str(self._path)
        raise FileFormatError.expected(
            where, "intact data", f"damaged data ({said})", "copy the file again from its source"
        ) from error
