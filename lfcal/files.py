"""Atomic writing of files, and safe opening of HDF5 files from unknown sources."""

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
from typing import TYPE_CHECKING, Any

from lfcal.errors import FileFormatError, InputError, StorageError, UnsafeFileError
from lfcal.system import is_alive, replace, sync_file, sync_folder
from lfcal.units import format_bytes

if TYPE_CHECKING:
    import h5py
    import numpy as np

__all__ = [
    "check_dataset",
    "check_other_file",
    "check_regular",
    "open_h5",
    "replace_whole",
    "require_space",
    "storage_errors",
]

MAX_BYTES = 1 << 44
"""A dataset with a declared size above this (17.6 TB) is refused."""

MAX_EXPANSION = 2000
"""Declared bytes a dataset may hold per byte of file; gzip reaches 1030 on constant data."""

KNOWN_FILTERS = {1, 2, 3, 32000, 32001, 32004, 32008, 32015}
"""HDF5 filters that are read: deflate, shuffle, fletcher32, lzf, blosc, lz4, bitshuffle, zstd."""


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
        number = _system_error(error)
        if number is None and not isinstance(error, OSError):
            raise
        known = None if number is None else os.strerror(number)
        reason = known or getattr(error, "strerror", None) or " ".join(str(error).split())
        raise StorageError(f"{path}: {reason}; {_REMEDIES.get(number or 0, 'check the disk and the path')}") from error


def _system_error(error: OSError | RuntimeError) -> int | None:
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


@contextmanager
def open_h5(path: str | os.PathLike[str]) -> Iterator[h5py.File]:
    """Open an HDF5 file for reading with one-line errors; use `check_dataset` before reading from it."""
    file = open_h5_file(path)
    try:
        yield file
    finally:
        file.close()


def open_h5_file(path: str | os.PathLike[str]) -> h5py.File:
    """Open an HDF5 file for reading and return it; the caller closes it."""
    import h5py
    import hdf5plugin  # noqa: F401  registers zstd, blosc and lz4 with HDF5

    source = Path(path)
    if not source.exists():
        raise StorageError(f"{source}: no such file; check the path")
    check_regular(source)
    with storage_errors(source):
        # a plain open first: h5py's own error does not tell a missing permission from damaged data
        source.open("rb").close()
    try:
        # without HDF5's lock a file can be read while a session writes it, and on network disks
        return h5py.File(source, "r", locking=False)
    except OSError as error:
        raise FileFormatError.expected(
            str(source), "an intact HDF5 file", "a damaged or other file", "record or copy it again"
        ) from error


def check_dataset(file: h5py.File, name: str, *, max_bytes: int = MAX_BYTES, dtype: np.dtype[Any] | None = None) -> Any:
    """Return dataset ``name`` of ``file`` after checking that it may be read.

    Soft and external links, external storage, virtual datasets, unknown filters, dtypes other than
    plain numbers (or exactly the compound ``dtype``), declared sizes beyond ``max_bytes`` or far beyond
    the file's size, and chunks that were never written are refused with `UnsafeFileError` or
    `FileFormatError`.
    """
    import h5py

    where = f"{file.filename}:/{name}"
    group: Any = file
    parts = [p for p in name.split("/") if p]
    for part in parts:
        link = group.get(part, getlink=True) if part in group.keys() else None
        if link is None:
            names = ", ".join(sorted(group.keys())[:8]) or "nothing"
            raise FileFormatError.expected(where, "a dataset of this name", f"only {names}", "check the file")
        # a link may lead to any file of this machine
        if not isinstance(link, h5py.HardLink):
            raise UnsafeFileError.expected(
                where, "data stored in the file itself", type(link).__name__, "copy the data in"
            )
        group = group[part]
    data = group
    if not isinstance(data, h5py.Dataset):
        raise FileFormatError.expected(where, "a dataset", type(data).__name__, "check the file")
    _check_storage(data, where, max_bytes, dtype)
    return data


def _check_storage(data: Any, where: str, max_bytes: int, dtype: np.dtype[Any] | None) -> None:
    import h5py

    plist = data.id.get_create_plist()
    # so may external storage and virtual datasets
    if plist.get_external_count():
        raise UnsafeFileError.expected(where, "data stored in the file itself", "external storage", "copy it in")
    if plist.get_layout() == h5py.h5d.VIRTUAL:
        raise UnsafeFileError.expected(where, "stored data", "a virtual dataset", "copy the data in")
    if data.dtype.kind not in "iufb" and (dtype is None or data.dtype != dtype):
        raise UnsafeFileError.expected(where, "plain numbers", f"dtype {data.dtype}", "store it as numbers")
    filters = {plist.get_filter(k)[0] for k in range(plist.get_nfilters())}
    if filters - KNOWN_FILTERS:
        raise UnsafeFileError.expected(
            where, "gzip, lzf, zstd, blosc or lz4", f"HDF5 filter {sorted(filters)}", "repack the file"
        )
    nbytes = int(data.size or 0) * data.dtype.itemsize
    stored = os.path.getsize(data.file.filename)
    if nbytes > max_bytes:
        raise UnsafeFileError.expected(
            where, f"at most {format_bytes(max_bytes)}", format_bytes(nbytes), "check the file"
        )
    if nbytes > MAX_EXPANSION * stored + (1 << 20):
        raise UnsafeFileError.expected(
            where,
            "a size the file can hold",
            f"{format_bytes(nbytes)} declared in a file of {format_bytes(stored)}",
            "the header is wrong; take it from its source again",
        )
    if data.chunks is not None and nbytes:
        want = 1
        for n, c in zip(data.shape, data.chunks, strict=True):
            want *= -(-n // c)
        have = data.id.get_num_chunks()
        if have < want:
            raise FileFormatError.expected(
                where, f"{want} written chunks", f"{have}", "the file is unfinished; write it again"
            )
    elif data.chunks is None and nbytes and data.id.get_storage_size() < nbytes:
        raise FileFormatError.expected(
            where,
            f"{format_bytes(nbytes)} of data",
            format_bytes(data.id.get_storage_size()),
            "the file is unfinished; write it again",
        )
