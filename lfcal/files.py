"""Atomic writing of files, and reading of files that may be anything."""

from __future__ import annotations

import errno
import glob
import os
import re
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from lfcal.errors import FileFormatError, InputError, StorageError
from lfcal.system import is_alive, replace, sync_file, sync_folder
from lfcal.units import format_bytes

__all__ = [
    "check_other_file",
    "check_regular",
    "read_text",
    "replace_whole",
    "require_space",
    "storage_errors",
    "system_error",
]

MAX_EXPANSION = 2000
"""Declared bytes a dataset may hold per byte of file; gzip reaches 1030 on constant data."""


_REMEDIES = {
    errno.ENOSPC: "free some space or choose another disk",
    errno.EDQUOT: "free some of your space or choose another disk",
    errno.EFBIG: "choose a disk that takes files of this size",
    errno.EACCES: "choose a folder you may write to",
    errno.EPERM: "choose a folder you may write to",
    errno.EROFS: "the disk is read-only; choose another one",
    errno.ENOENT: "check the path",
    errno.ENOTDIR: "a part of the path is a file; check the path",
    errno.EEXIST: "a part of the path is a file; check the path",
    errno.EISDIR: "the path is a folder; name a file in it",
}


@contextmanager
def storage_errors(path: Path) -> Iterator[None]:
    """Turn what the operating system says about ``path`` into a one-line `StorageError`.

    HDF5 reports a disk that fails as OSError or RuntimeError with the system's number in its text.
    """
    try:
        yield
    except StorageError:
        raise
    except (OSError, RuntimeError) as error:
        number = system_error(error)
        if number is None and not isinstance(error, OSError):
            raise
        known = None if number is None else os.strerror(number)
        reason = known or getattr(error, "strerror", None) or " ".join(str(error).split())
        raise StorageError(f"{path}: {reason}; {_REMEDIES.get(number or 0, 'check the disk and the path')}") from error


def system_error(error: OSError | RuntimeError) -> int | None:
    """Return the system's error number, also where HDF5 only writes it in its message."""
    if isinstance(error, OSError) and error.errno is not None:
        return error.errno
    found = re.search(r"errno = (\d+)", str(error))
    return int(found[1]) if found else None


def require_space(folder: Path, nbytes: int, *, what: str = "the file") -> None:
    """Raise `StorageError` unless the disk that holds ``folder`` has ``nbytes`` and 1 % to spare.

    A chunked HDF5 write onto a full disk can end the process, so this is asked first.
    """
    probe = folder.absolute()
    # the folder may not exist yet; the disk is that of its nearest parent
    while not probe.exists() and probe != probe.parent:
        probe = probe.parent
    with storage_errors(probe):
        free = shutil.disk_usage(probe).free
    # HDF5 adds chunk indices and headers to the data
    need = int(nbytes * 1.01) + (1 << 20)
    if free < need:
        raise StorageError.expected(
            f"disk space for {what} in {folder}",
            format_bytes(need),
            f"{format_bytes(free)} free",
            "free some space or choose another folder",
        )


@contextmanager
def replace_whole(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a scratch path beside ``path``; put it in place when the block ends well, else remove it.

    The scratch file is flushed to disk before it takes the name (`lfcal.system.replace`), so that ``path`` is at
    every moment the old file, the new file whole, or absent. Folders above ``path`` are made. A link is followed, not
    replaced; an existing file keeps its mode, and one that is read-only is refused. Scratch files that dead processes
    left for the same name are removed.
    """
    target = Path(os.path.realpath(path))
    if target.is_dir():
        raise StorageError(f"{target}: is a folder; name a file in it")
    with storage_errors(target):
        mode = stat.S_IMODE(target.stat().st_mode) if target.exists() else None
        if mode is not None and not mode & stat.S_IWUSR:
            raise StorageError(f"{target}: is read-only; choose another name, or make it writable")
        target.parent.mkdir(parents=True, exist_ok=True)
        _sweep(target)
        part = target.with_name(f".{target.name}.{os.getpid()}.part")
        try:
            part.touch(exist_ok=True)
            yield part
            sync_file(part)
            if mode is not None:
                os.chmod(part, mode)
            replace(part, target)
            sync_folder(target.parent)
        finally:
            with suppress(FileNotFoundError):
                part.unlink()


def _sweep(target: Path) -> None:
    """Remove scratch files for ``target`` whose process is gone."""
    for part in target.parent.glob(f".{glob.escape(target.name)}.*.part"):
        process = part.name.removesuffix(".part").rpartition(".")[2]
        if process.isdigit() and int(process) != os.getpid() and not is_alive(int(process)):
            with suppress(OSError):
                part.unlink()


def check_regular(path: Path) -> None:
    """Raise `StorageError` unless ``path`` is a file: pipes and devices may never come to an end."""
    with storage_errors(path):
        kind = path.stat().st_mode
    if stat.S_ISDIR(kind):
        raise StorageError(f"{path}: is a folder; name a file in it")
    if not stat.S_ISREG(kind):
        raise StorageError(f"{path}: is a pipe or a device; name a file on a disk")


def read_text(path: str | os.PathLike[str], *, limit: int = 1 << 26) -> str:
    """Return a text file in UTF-8 of at most ``limit`` bytes (64 MB).

    Raises
    ------
    StorageError
        If it cannot be read, or is no file on a disk.
    FileFormatError
        If it is larger, or not text.
    """
    source = Path(path)
    check_regular(source)
    with storage_errors(source), source.open("rb") as file:
        data = file.read(limit + 1)  # one byte more shows that there is more
    if len(data) > limit:
        raise FileFormatError.expected(
            str(source), f"text of at most {format_bytes(limit)}", "a larger file", "check the path"
        )
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise FileFormatError.expected(str(source), "text in UTF-8", "other bytes", "check the path") from None


def check_other_file(source: str | os.PathLike[str], target: str | os.PathLike[str]) -> None:
    """Raise `InputError` where the output ``target`` would replace the input ``source``, links followed."""
    if not str(source):
        return
    with suppress(OSError):  # what is not there yet is another file
        if os.path.samefile(source, target):
            raise InputError.expected("output", "another file than the input", str(target), "choose another name")
