"""Functions of the operating system for every platform: syncs, reservations, locks, names, processes, memory.

No other module depends on the operating system, except for features that exist on only one (libraries of the window,
menu entries, drivers).
"""

from __future__ import annotations

import errno
import functools
import math
import os
import struct
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any

from lfcal.base.errors import StorageError

__all__ = [
    "OPEN_FLAGS",
    "free_memory",
    "is_alive",
    "lock",
    "memory_in_use",
    "name_refused",
    "on_network",
    "peak_memory",
    "processors",
    "read_at",
    "replace",
    "reserve",
    "sync_data",
    "sync_file",
    "sync_folder",
    "too_long",
    "total_memory",
    "write_at",
]

BLOCK = 1 << 24
OPEN_FLAGS = getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0)
"""Flags for opening every descriptor: binary, and not inherited by child processes."""

_SEEKING = threading.Lock()
"""Lock that keeps seeking and writing together, on systems whose calls cannot state a position in the file."""


def reserve(descriptor: int, size: int) -> None:
    """Reserve disk space for the first ``size`` bytes of an open file; raise OSError if the disk is full.

    The content of the file is kept. A shorter file is extended with zeros.
    """
    if hasattr(os, "posix_fallocate"):
        try:
            os.posix_fallocate(descriptor, 0, size)
            return
        except OSError as error:
            if error.errno not in (errno.EINVAL, errno.EOPNOTSUPP):
                raise
    elif sys.platform == "darwin" and _preallocate(descriptor, size):
        return
    # written back, because a file may have a length without allocated blocks
    for offset in range(0, size, BLOCK):
        length = min(BLOCK, size - offset)
        write_at(descriptor, read_at(descriptor, length, offset).ljust(length, b"\0"), offset)


def _preallocate(descriptor: int, size: int) -> bool:
    """Return whether macOS has allocated blocks for ``size`` bytes; the file is at least that long then."""
    import fcntl

    command, all_or_nothing, from_physical_end = 42, 4, 3  # F_PREALLOCATE, F_ALLOCATEALL, F_PEOFPOSMODE
    missing = size - os.fstat(descriptor).st_blocks * 512
    if missing > 0:
        request = struct.pack("=Iiqqq", all_or_nothing, from_physical_end, 0, missing, 0)
        try:
            fcntl.fcntl(descriptor, command, request)
        except OSError as error:
            if error.errno == errno.ENOSPC:
                raise
            return False
    found = os.fstat(descriptor)
    if found.st_size < size:
        os.ftruncate(descriptor, size)
    return found.st_blocks * 512 >= size


def write_at(descriptor: int, data: bytes | memoryview, offset: int) -> int:
    """Write all of ``data`` at ``offset`` (bytes) of an open file; return the number of bytes written."""
    view = memoryview(data).cast("B")
    done = 0
    while done < len(view):
        done += _write_some(descriptor, view[done:], offset + done)
    return done


def _write_some(descriptor: int, view: memoryview, offset: int) -> int:
    if hasattr(os, "pwrite"):
        return os.pwrite(descriptor, view, offset)
    with _SEEKING:
        os.lseek(descriptor, offset, os.SEEK_SET)
        return os.write(descriptor, view)


def read_at(descriptor: int, size: int, offset: int) -> bytes:
    """Return ``size`` bytes at ``offset`` (bytes) of an open file; fewer only at the end of the file."""
    parts = []
    while size > 0:
        part = _read_some(descriptor, size, offset)
        if not part:
            break
        parts.append(part)
        size, offset = size - len(part), offset + len(part)
    return parts[0] if len(parts) == 1 else b"".join(parts)


def _read_some(descriptor: int, size: int, offset: int) -> bytes:
    if hasattr(os, "pread"):
        return os.pread(descriptor, size, offset)
    with _SEEKING:
        os.lseek(descriptor, offset, os.SEEK_SET)
        return os.read(descriptor, size)


def sync_data(descriptor: int) -> None:
    """Wait until the data written to an open file are on disk."""
    if sys.platform == "darwin":
        import fcntl

        # there, fsync stops at the drive's cache; network disks support only fsync
        with suppress(OSError):
            fcntl.fcntl(descriptor, fcntl.F_FULLFSYNC)
            return
    if hasattr(os, "fdatasync"):
        os.fdatasync(descriptor)
    else:
        os.fsync(descriptor)


def sync_file(path: Path) -> None:
    """Flush a file to disk; it is opened for writing, because some systems do not flush it otherwise."""
    descriptor = os.open(path, os.O_RDWR | OPEN_FLAGS)
    try:
        sync_data(descriptor)
    finally:
        os.close(descriptor)


def sync_folder(folder: Path) -> None:
    """Flush the names of the files in ``folder`` to disk, if the system supports it."""
    if not hasattr(os, "O_DIRECTORY"):  # folders cannot be opened on this system
        return
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | OPEN_FLAGS)
    try:
        with suppress(OSError):  # some file systems cannot flush a folder
            os.fsync(descriptor)
    finally:
        os.close(descriptor)


def replace(source: Path, target: Path) -> None:
    """Rename ``source`` to ``target`` in one step, replacing an existing file.

    Raises
    ------
    StorageError
        If another program has the file open and the system refuses (Windows).
    """
    try:
        os.replace(source, target)
    except PermissionError as error:
        if sys.platform != "win32":
            raise
        raise StorageError.expected(
            str(target),
            "a file that can be replaced",
            "one that is open in another program",
            "close it there and try again",
        ) from error


_DEVICES = {"CON", "PRN", "AUX", "NUL", "CONIN$", "CONOUT$"} | {
    f"{a}{b}" for a in ("COM", "LPT") for b in "123456789¹²³"
}
_NOT_IN_NAMES = frozenset('<>:"|?*')


def name_refused(path: Path) -> str:
    """Return why Windows refuses or changes a name in ``path``, or treats it as a device.

    The text is empty if the path is accepted, and always on other systems.
    """
    if sys.platform != "win32":
        return ""
    for part in path.parts[1:] if path.anchor else path.parts:
        if part in (".", ".."):
            continue
        # with any suffix: aux.h5 is the device as well
        if part.partition(".")[0].rstrip(" ").upper() in _DEVICES:
            return f"{part} is the name of a device on Windows"
        if part[-1:] in (".", " "):
            return f"{part!r}: Windows drops a dot or a space at the end of a name"
        if bad := [c for c in part if c in _NOT_IN_NAMES or ord(c) < 32]:
            return f"{bad[0]!r} is not allowed in the name of a file on Windows"
    return ""


def on_network(path: str) -> bool:
    """Return whether Windows would access another computer to open a path, such as ``//server/share/x``."""
    start = path.replace("/", "\\")
    local = start[:4] in ("\\\\?\\", "\\\\.\\", "\\??\\") and start[5:6] == ":"
    return start.startswith(("\\\\", "\\??\\")) and not local


def too_long(path: object) -> bool:
    """Return whether a path may be too long for Windows, which then reports a missing file; False on other systems."""
    # 259 characters, some of which are needed for the names of scratch files
    return sys.platform == "win32" and len(str(path)) > 235 and not str(path).startswith("\\\\?\\")


def lock(descriptor: int) -> None:
    """Lock an open file until it is closed or the process ends; raise OSError if it is locked or cannot be locked."""
    if sys.platform == "win32":
        import msvcrt

        os.lseek(
            descriptor, 1 << 30, os.SEEK_SET
        )  # other programs cannot read locked bytes, so lock one far beyond the end
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
    else:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


def is_alive(process: int) -> bool:
    """Return whether a process with the ID ``process`` exists."""
    if sys.platform == "win32":
        return _is_alive_on_windows(process)
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:  # it belongs to another user
        return True
    return True


def _is_alive_on_windows(process: int) -> bool:
    """Check by a process handle: on Windows, ``os.kill`` ends the process for any signal."""
    import ctypes

    query_limited, denied, still_active = 0x1000, 5, 259
    kernel = ctypes.WinDLL("kernel32", use_last_error=True)  # type: ignore[attr-defined,unused-ignore]
    handle = kernel.OpenProcess(query_limited, False, process)
    if not handle:
        return bool(ctypes.get_last_error() == denied)  # type: ignore[attr-defined,unused-ignore]
    try:
        code = ctypes.c_ulong()
        return not kernel.GetExitCodeProcess(handle, ctypes.byref(code)) or code.value == still_active
    finally:
        kernel.CloseHandle(handle)


def processors(root: Path = Path("/")) -> int:
    """Return the number of processors that this process may use, given its affinity and the limit of a container.

    ``root`` contains ``proc`` and ``sys``, from which the limit is read. A fractional limit is rounded up.
    """
    # with taskset and in some containers, a process may use fewer processors than the machine has
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, math.ceil(min(count, _quota(root))))


@functools.cache
def _quota(root: Path) -> float:
    """Return the processors that the control groups of this process allow; infinite without a limit.

    Version 2 states it in ``cpu.max``, version 1 in ``cpu.cfs_quota_us``.
    """
    return min(map(_limit, _groups(root, "cpu")), default=math.inf)


def _groups(root: Path, controller: str) -> list[Path]:
    """Return the folders of this process's control groups and their parents, which may have lower limits."""
    found: list[Path] = []
    for line in _read(root / "proc" / "self" / "cgroup").splitlines():
        number, _, rest = line.partition(":")
        controllers, _, place = rest.partition(":")
        if number == "0":
            bases = [root / "sys" / "fs" / "cgroup"]
        elif controller in controllers.split(","):
            bases = [root / "sys" / "fs" / "cgroup" / name for name in (controllers, controller)]
        else:
            continue
        for base in bases:
            group = base / place.strip("/")
            # inside a container the path may be that of the machine: then use the group at the base
            found += [g for g in (group, *group.parents) if g == base or base in g.parents]
    return found


def _limit(group: Path) -> float:
    quota, _, period = _read(group / "cpu.max").partition(" ")
    if not quota:
        quota, period = _read(group / "cpu.cfs_quota_us"), _read(group / "cpu.cfs_period_us")
    try:
        share = int(quota) / int(period)
    except (ValueError, ZeroDivisionError):  # "max", or no such file
        return math.inf
    return share if share > 0 else math.inf  # -1: none


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii").strip()
    except (OSError, ValueError):
        return ""


def free_memory(root: Path = Path("/")) -> int:
    """Return the memory that is available to programs now (bytes), on the machine and within a container's limit.

    ``root`` contains ``proc`` and ``sys`` on Linux; other systems are queried through psutil.
    """
    if not sys.platform.startswith("linux"):
        return int(_psutil().virtual_memory().available)
    free = [_kilobytes(root / "proc" / "meminfo", "MemAvailable") or total_memory() // 2]
    for group in _groups(root, "memory"):
        for limit, used in (("memory.max", "memory.current"), ("memory.limit_in_bytes", "memory.usage_in_bytes")):
            with suppress(ValueError):  # "max", or no such file
                # the file cache of a group is released on demand
                given_back = _words(group / "memory.stat").get("inactive_file", 0)
                free.append(int(_read(group / limit)) - int(_read(group / used)) + given_back)
    return max(0, min(free))


def total_memory() -> int:
    """Return the memory of this machine (bytes), regardless of the limit of a container."""
    if not sys.platform.startswith("linux"):
        return int(_psutil().virtual_memory().total)
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def memory_in_use(root: Path = Path("/")) -> int:
    """Return the resident memory of this process (bytes); 0 if the system does not report it.

    ``root`` contains ``proc`` on Linux; other systems are queried through psutil.
    """
    if not sys.platform.startswith("linux"):
        return int(_psutil().Process().memory_info().rss)
    return _kilobytes(root / "proc" / "self" / "status", "VmRSS")


def peak_memory(*, children: bool = False) -> int:
    """Return the peak resident memory of this process (bytes).

    With ``children``, it is the peak of the largest of its child processes that have ended; 0 on Windows.
    """
    if sys.platform == "win32":
        return 0 if children else int(_psutil().Process().memory_info().peak_wset)
    import resource

    used = resource.getrusage(resource.RUSAGE_CHILDREN if children else resource.RUSAGE_SELF).ru_maxrss
    return used * (1 if sys.platform == "darwin" else 1024)  # bytes there, kilobytes elsewhere


def _psutil() -> Any:
    """Return psutil, which is installed on systems without ``/proc``."""
    import psutil

    return psutil


def _kilobytes(path: Path, name: str) -> int:
    """Return the bytes stated as ``name: 123 kB`` in a file; 0 if there is none."""
    return 1024 * _words(path).get(f"{name}:", 0)


def _words(path: Path) -> dict[str, int]:
    """Return the lines of a file that consist of a name and a number, by name."""
    lines = (line.split() for line in _read(path).splitlines())
    return {words[0]: int(words[1]) for words in lines if len(words) > 1 and words[1].isdigit()}
