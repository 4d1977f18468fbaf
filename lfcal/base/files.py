"""Atomic writing of files, and safe reading of files of unknown origin."""

from __future__ import annotations

import errno
import glob
import io
import os
import re
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfcal.base.errors import FileFormatError, InputError, StorageError
from lfcal.base.system import OPEN_FLAGS, is_alive, lock, name_refused, replace, sync_file, sync_folder, too_long
from lfcal.base.units import format_bytes

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = [
    "check_other_file",
    "check_regular",
    "check_writable",
    "only_writer",
    "read_text",
    "read_tiff",
    "replace_store",
    "replace_whole",
    "require_space",
    "storage_errors",
    "storage_words",
    "sweep_scratch",
    "system_error",
    "write_png",
    "write_text",
    "write_tiff",
]

STORES = frozenset({".zarr"})
"""Suffixes of folders that are one output, written and replaced as a whole."""

MAX_EXPANSION = 2000
"""Largest size that a dataset may declare per byte of its file; gzip reaches 1030 on constant data."""


_REMEDIES = {
    errno.ENOSPC: "free some space or choose another disk",
    errno.EDQUOT: "delete some of your files or choose another disk",
    errno.EFBIG: "choose a disk that supports files of this size",
    errno.EACCES: "choose a folder you may write to",
    errno.EPERM: "choose a folder you may write to",
    errno.EROFS: "the disk is read-only; choose another one",
    errno.ENOENT: "check the path",
    errno.ENOTDIR: "a part of the path is a file; check the path",
    errno.EEXIST: "a part of the path is a file; check the path",
    errno.EISDIR: "this is a folder; give the path of a file",
    errno.ENAMETOOLONG: "choose a shorter name",
}


@contextmanager
def storage_errors(path: Path) -> Iterator[None]:
    """Return a context in which errors of the operating system become a one-line `StorageError` about ``path``.

    HDF5 reports a failing disk as an OSError or RuntimeError with the system's error number in its message.
    """
    try:
        yield
    except StorageError:
        raise
    except (OSError, RuntimeError) as error:
        if system_error(error) is None and not isinstance(error, OSError):
            raise
        raise StorageError(storage_words(error, path)) from error


def storage_words(error: OSError | RuntimeError, path: object) -> str:
    """Return a one-line message with the path, the system's reason for the error, and a remedy."""
    number = system_error(error)
    known = None if number is None else os.strerror(number)
    reason = known or (error.strerror if isinstance(error, OSError) else None) or " ".join(str(error).split())
    if number is None and re.search(r"\d+ requested and \d+ written", reason):
        # message of numpy, without the system's error number
        number, reason = errno.ENOSPC, "the disk stored only a part of the data"
    remedy = _REMEDIES.get(number or 0, "check the disk and the path")
    if too_long(path):
        remedy = "choose a shorter path, or enable long paths in Windows"
    return f"{path}: {reason}; {remedy}"


def system_error(error: OSError | RuntimeError) -> int | None:
    """Return the system's error number, which HDF5 may state only in its message; None if there is none."""
    if isinstance(error, OSError) and error.errno is not None:
        return error.errno
    found = re.search(r"errno = (\d+)", str(error))
    return int(found[1]) if found else None


def require_space(folder: Path, nbytes: int, *, what: str = "the file") -> None:
    """Raise `StorageError` unless the disk of ``folder`` has ``nbytes`` free, plus 1 % and 1 MiB.

    A chunked HDF5 write to a full disk can crash the process, so the space is checked first. ``what`` names the file in
    the message.
    """
    probe = folder.absolute()
    # the folder may not exist yet: use the disk of its nearest parent
    while not probe.exists() and probe != probe.parent:
        probe = probe.parent
    with storage_errors(probe):
        free = shutil.disk_usage(probe).free
    # HDF5 adds chunk indices and headers to the data
    need = int(nbytes * 1.01) + (1 << 20)
    if free < need:
        raise StorageError.expected(
            f"free disk space for {what} in {folder}",
            f"at least {format_bytes(need)}",
            format_bytes(free),
            "free some space or choose another folder",
        )


def check_writable(path: str | os.PathLike[str]) -> Path:
    """Return ``path`` with links resolved; raise `StorageError` unless that file can be written or replaced.

    Folders, pipes, devices, read-only files, and names in folders without write permission are refused. A path with a
    suffix in `STORES` may be an existing folder that is empty or contains a store.
    """
    # before links are followed: Windows turns such a name into a device path
    if why := name_refused(Path(path)):
        raise StorageError(f"{path}: {why}; choose another name")
    target = Path(os.path.realpath(path))
    with storage_errors(target):
        if target.suffix.lower() in STORES and target.is_dir():
            _check_store(target)
        elif target.exists():
            check_regular(target)
            if not target.stat().st_mode & stat.S_IWUSR:
                raise StorageError(f"{target}: this file is read-only; choose another name, or make the file writable")
        folder = target.parent
        # missing folders are created in the nearest existing one
        while not folder.exists() and folder != folder.parent:
            folder = folder.parent
        if not folder.is_dir():
            raise StorageError(f"{target}: {folder} is a file; check the path")
        if not os.access(folder, os.W_OK):
            raise StorageError(f"{target}: {folder} is not writable; choose another folder")
    return target


@contextmanager
def replace_whole(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a scratch path next to ``path``; move it into place when the block succeeds, else remove it.

    The scratch file is flushed to disk before it is renamed (`lfcal.base.system.replace`). Thus ``path`` is always the
    old file, the complete new file, or absent. Parent folders are created. A link is followed, not replaced. An
    existing file keeps its mode; a read-only one is refused. Where locks are supported, only one program can write a
    file at a time. Scratch files for the same name left by programs that have ended are removed.

    Raises
    ------
    StorageError
        If the file cannot be written, another program is writing it, or the disk fails in the block.
    """
    target = check_writable(path)
    with storage_errors(target):
        mode = stat.S_IMODE(target.stat().st_mode) if target.exists() else None
        target.parent.mkdir(parents=True, exist_ok=True)
        with only_writer(target) as alone:
            _sweep(target, alone=alone)
            part = target.with_name(f".{target.name}.{os.getpid()}.part")
            try:
                # must be new and not a link to elsewhere: other users may write to the folder
                os.close(os.open(part, os.O_CREAT | os.O_EXCL | os.O_WRONLY | getattr(os, "O_NOFOLLOW", 0), 0o666))
                yield part
                sync_file(part)
                if mode is not None:
                    os.chmod(part, mode)
                replace(part, target)
                sync_folder(target.parent)
            finally:
                with suppress(FileNotFoundError):
                    part.unlink()


def _check_store(target: Path) -> None:
    """Raise `StorageError` unless a folder is a store or empty: other files of the user are never replaced."""
    if not any((target / name).is_file() for name in (".zgroup", ".zarray", "zarr.json")) and any(target.iterdir()):
        raise StorageError(f"{target}: this folder contains other files; choose another name")
    if not os.access(target, os.W_OK):
        raise StorageError(f"{target}: this folder is read-only; choose another name, or make the folder writable")


@contextmanager
def replace_store(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield an empty scratch folder next to ``path``; move it into place when the block succeeds, else remove it.

    It works like `replace_whole`, for outputs that are folders (`STORES`). An existing folder is first renamed, then
    the new one is moved into place. If the program is killed in between, the next program that writes the folder
    restores the old one.

    Raises
    ------
    StorageError
        If the folder cannot be written, another program is writing it, or the disk fails in the block.
    """
    target = check_writable(path)
    with storage_errors(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        with only_writer(target) as alone:
            aside = target.with_name(f".{target.name}.before")
            if aside.exists() and alone:
                if target.exists():
                    _remove(aside)
                else:
                    replace(aside, target)
            _sweep(target, alone=alone)
            part = target.with_name(f".{target.name}.{os.getpid()}.part")
            try:
                part.mkdir()
                yield part
                for folder, _, names in os.walk(part):
                    for name in names:
                        sync_file(Path(folder, name))
                    sync_folder(Path(folder))
                try:
                    if target.exists():
                        replace(target, aside)
                    replace(part, target)
                except BaseException:
                    if aside.exists() and not target.exists():
                        replace(aside, target)
                    raise
                sync_folder(target.parent)
                _remove(aside)
            finally:
                _remove(part)


def _remove(path: Path) -> bool:
    """Remove a file, or a folder with its contents; return whether it is gone."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
        return not path.exists()
    return _unlink(path)


@contextmanager
def only_writer(target: Path) -> Iterator[bool]:
    """Return a context in which a lock file excludes other writers of ``target``.

    It yields whether the lock could be taken. This is not the case if the file system does not support locks, or if the
    lock file belongs to another user.

    Raises
    ------
    StorageError
        If another program is writing ``target``.
    """
    path = target.with_name(f".{target.name}.lock")
    descriptor = _locked(path, target)
    try:
        yield descriptor is not None
    finally:
        if descriptor is not None:
            # removed before it is closed, so that no other program can hold it; Windows cannot remove open files
            removed = _unlink(path)
            os.close(descriptor)
            if not removed:
                _unlink(path)


def _locked(path: Path, target: Path) -> int | None:
    """Return a descriptor of the lock file, locked; None if another user made it or locks are not supported."""
    while True:
        try:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | OPEN_FLAGS, 0o666)
        except PermissionError:
            if path.exists():  # left by another user's program
                return None
            raise
        try:
            lock(descriptor)
        except OSError as error:
            os.close(descriptor)
            if error.errno not in (errno.EAGAIN, errno.EACCES, errno.EDEADLK):
                return None
            raise StorageError(
                f"{target}: another program is writing it; wait for it to end, or choose another name"
            ) from error
        if _is_name_of(path, descriptor):
            return descriptor
        os.close(descriptor)  # its owner has removed it meanwhile: the lock has no effect


def _is_name_of(path: Path, descriptor: int) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


def _unlink(path: Path) -> bool:
    """Remove a file; return whether it is gone."""
    with suppress(OSError):
        path.unlink(missing_ok=True)
        return True
    return False


def sweep_scratch(folder: Path) -> None:
    """Remove the scratch files, scratch folders and lock files in ``folder`` that killed programs left behind."""
    left = {path.name[1:].rsplit(".", 2)[0] for path in folder.glob(".*.*.part")}
    left |= {path.name[1:].removesuffix(".lock") for path in folder.glob(".*.lock")}
    for name in left:
        target = folder / name
        with suppress(StorageError), only_writer(target) as alone:
            _sweep(target, alone=alone)


def _sweep(target: Path, *, alone: bool) -> None:
    """Remove scratch files for ``target``: all if no other program can be writing, else those of dead processes."""
    for part in target.parent.glob(f".{glob.escape(target.name)}.*.part"):
        process = part.name.removesuffix(".part").rpartition(".")[2]
        if process.isdigit() and (alone or not is_alive(int(process))):
            _remove(part)


def check_regular(path: Path) -> None:
    """Raise `StorageError` unless ``path`` is a regular file: reading a pipe or device may never end."""
    with storage_errors(path):
        kind = path.stat().st_mode
    if stat.S_ISDIR(kind):
        raise StorageError(f"{path}: this is a folder; give the path of a file")
    if not stat.S_ISREG(kind):
        raise StorageError(f"{path}: this is a pipe or a device; give the path of a file")


def read_text(path: str | os.PathLike[str], *, limit: int = 1 << 26, foreign: bool = False) -> str:
    """Return the content of a text file in UTF-8 of at most ``limit`` bytes (64 MiB by default).

    If ``foreign`` is set, the file may also have an encoding that spreadsheet programs write: UTF-16 with a byte-order
    mark, or Windows code page 1252.

    Raises
    ------
    StorageError
        If the file cannot be read, or is not a file on a disk.
    FileFormatError
        If the file is larger than ``limit``, or is not text.
    """
    source = Path(path)
    check_regular(source)
    with storage_errors(source), source.open("rb") as file:
        data = file.read(limit + 1)  # one byte more shows whether the file is larger
    if len(data) > limit:
        raise FileFormatError.expected(
            str(source), f"text of at most {format_bytes(limit)}", "a larger file", "choose another file"
        )
    encodings: tuple[str, ...] = ("utf-8-sig",)
    if foreign and data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        encodings = ("utf-16",)
    elif foreign and b"\0" not in data:  # code page 1252 would accept binary data as text
        encodings = ("utf-8-sig", "cp1252")
    for encoding in encodings:
        with suppress(UnicodeDecodeError):
            return data.decode(encoding)
    raise FileFormatError.expected(
        str(source), "text in UTF-8", "text in another encoding, or binary data", "save the file as UTF-8"
    )


def check_other_file(source: str | os.PathLike[str], target: str | os.PathLike[str]) -> None:
    """Raise `InputError` if the output ``target`` and the input ``source`` are the same file; links are followed."""
    if not str(source):
        return
    with suppress(OSError):  # a missing file is not the input
        if os.path.samefile(source, target):
            raise InputError.expected("output", "a file other than the input", str(target), "choose another name")


class _Counted(io.BufferedRandom):
    """A file to which arrays are written through Python only.

    numpy writes to a real file through the C library's buffers. It does not check whether the last kilobytes reached
    the disk.
    """

    def fileno(self) -> int:
        raise io.UnsupportedOperation("fileno")


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a text file in UTF-8, atomically."""
    with replace_whole(path) as part:
        part.write_text(text, encoding="utf-8")


def write_png(path: str | os.PathLike[str], image: NDArray[Any]) -> None:
    """Write a uint8 or uint16 image as PNG: ``(rows, columns)``, or ``(rows, columns, 3)`` as (blue, green, red).

    Raises
    ------
    StorageError
        If the file cannot be written; an existing file is kept.
    """
    from lfcal.base.opencv import cv2

    with storage_errors(Path(path)), replace_whole(path) as part:
        part.write_bytes(cv2.imencode(".png", image)[1].tobytes())


def write_tiff(path: str | os.PathLike[str], data: NDArray[Any], **options: Any) -> None:
    """Write an array as a greyscale TIFF; ``options`` are those of `tifffile.imwrite`, without ``photometric``.

    Raises
    ------
    StorageError
        If the file cannot be written; an existing file is kept.
    """
    import tifffile

    with replace_whole(path) as part, _Counted(io.FileIO(part, "w+b")) as file:
        tifffile.imwrite(file, data, photometric="minisblack", **options)


def read_tiff(path: str | os.PathLike[str]) -> NDArray[Any]:
    """Return all pages of the first series of a TIFF file as one array, in the order in which they are stored.

    Raises
    ------
    FileFormatError
        If the file is damaged or is not a TIFF file.
    StorageError
        If the file cannot be read.
    """
    import tifffile

    source = Path(path)
    check_regular(source)
    try:
        with storage_errors(source):
            values: NDArray[Any] = tifffile.imread(source)
            return values
    except StorageError:
        raise
    except Exception as error:  # tifffile raises various errors for damaged data
        reason = " ".join(str(error).split())[:120]
        raise FileFormatError.expected(str(source), "an intact TIFF file", reason, "copy it again") from error
