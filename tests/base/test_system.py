"""Calls of the operating system, with and without what single systems lack, and files that appear whole or not."""

from __future__ import annotations

import ctypes
import errno
import mmap
import os
import re
import stat
import struct
import subprocess
import sys
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from lfcal.base import system
from lfcal.base.errors import InputError, StorageError
from lfcal.base.files import check_other_file, check_writable, replace_whole, storage_errors, storage_words
from lfcal.base.system import (
    free_memory,
    is_alive,
    lock,
    memory_in_use,
    name_refused,
    peak_memory,
    processors,
    read_at,
    replace,
    reserve,
    sync_data,
    sync_file,
    sync_folder,
    too_long,
    total_memory,
    write_at,
)

POSIX = pytest.mark.skipif(os.name == "nt", reason="this system has no such call to hide")


@pytest.fixture
def descriptor(tmp_path: Path) -> Iterator[int]:
    found = os.open(tmp_path / "f", os.O_RDWR | os.O_CREAT)
    yield found
    os.close(found)


def hide(monkeypatch: pytest.MonkeyPatch, *names: str) -> None:
    for name in names:
        monkeypatch.delattr(os, name, raising=False)


@pytest.mark.parametrize("plain", [False, True])
def test_write_read_and_reserve(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, plain: bool, descriptor: int) -> None:
    if plain:
        hide(monkeypatch, "pwrite", "pread", "posix_fallocate", "fdatasync", "O_DIRECTORY")
        monkeypatch.setattr(system, "BLOCK", 1000)
    reserve(descriptor, 12345)
    assert os.fstat(descriptor).st_size == 12345
    assert write_at(descriptor, b"hello", 7) == 5
    sync_data(descriptor)
    sync_file(tmp_path / "f")
    sync_folder(tmp_path)
    assert read_at(descriptor, 5, 7) == b"hello" and read_at(descriptor, 10, 12340) == bytes(5)
    reserve(descriptor, 13000)  # what is there stays
    assert (tmp_path / "f").read_bytes() == bytes(7) + b"hello" + bytes(13000 - 12)


def test_a_length_without_blocks_is_reserved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """HDF5 lays a recording out at full length without a byte on the disk behind it."""
    for why in (errno.EOPNOTSUPP, errno.EINVAL, None):
        with (tmp_path / f"{why}").open("w+b") as file:
            os.ftruncate(file.fileno(), 1 << 20)
            if os.fstat(file.fileno()).st_blocks * 512 >= 1 << 20:
                pytest.skip("this file system has no files with holes")

            def refuse(*_: int, why: int | None = why) -> None:
                raise OSError(why, "refused")

            monkeypatch.setattr(os, "posix_fallocate", refuse, raising=False)
            if why is None:
                hide(monkeypatch, "posix_fallocate")
            reserve(file.fileno(), 1 << 20)
            assert os.fstat(file.fileno()).st_blocks * 512 >= 1 << 20


@POSIX
def test_a_disk_that_is_full_is_not_taken_for_one_that_cannot_reserve(
    monkeypatch: pytest.MonkeyPatch, descriptor: int
) -> None:
    def full(*_: int) -> None:
        raise OSError(errno.ENOSPC, "full")

    monkeypatch.setattr(os, "posix_fallocate", full, raising=False)
    with pytest.raises(OSError, match="full"):
        reserve(descriptor, 100)


@POSIX
@pytest.mark.parametrize("answer", ["granted", errno.ENOTSUP, "elsewhere", errno.ENOSPC])
def test_on_a_mac_blocks_are_allocated_and_zeros_written_only_where_that_fails(
    monkeypatch: pytest.MonkeyPatch, descriptor: int, answer: str | int
) -> None:
    size, allocate, requests, written = 1 << 20, os.posix_fallocate, [], []

    def call(fd: int, command: int, request: bytes) -> bytes:
        flags, mode, offset, length, _ = struct.unpack("=Iiqqq", request)
        assert (command, flags, mode, offset, len(request)) == (42, 4, 3, 0, 32)
        requests.append(length)
        if isinstance(answer, int):
            raise OSError(answer, "refused")
        if answer == "granted":
            allocate(fd, 0, length)
        return request

    write = os.pwrite
    monkeypatch.setattr(sys, "platform", "darwin")
    monkeypatch.setitem(sys.modules, "fcntl", types.SimpleNamespace(fcntl=call))  # type: ignore[misc]
    monkeypatch.setattr(os, "pwrite", lambda fd, data, at: written.append(len(data)) or write(fd, data, at))
    hide(monkeypatch, "posix_fallocate")
    if answer == errno.ENOSPC:
        with pytest.raises(OSError, match="refused"):
            reserve(descriptor, size)
        return
    reserve(descriptor, size)
    assert requests == [size] and sum(written) == (0 if answer == "granted" else size)
    assert os.fstat(descriptor).st_size == size and os.fstat(descriptor).st_blocks * 512 >= size
    reserve(descriptor, size)
    assert requests == [size] and sum(written) == (0 if answer == "granted" else size), "nothing is missing now"


@POSIX
def test_short_writes_and_reads_are_completed(monkeypatch: pytest.MonkeyPatch, descriptor: int) -> None:
    write, read = os.pwrite, os.pread
    monkeypatch.setattr(os, "pwrite", lambda fd, data, at: write(fd, memoryview(data)[:3], at))
    monkeypatch.setattr(os, "pread", lambda fd, size, at: read(fd, min(size, 3), at))
    write_at(descriptor, b"0123456789", 2)
    assert read_at(descriptor, 12, 0) == b"\0\x000123456789"


@pytest.mark.parametrize("able", [True, False])
def test_on_a_mac_the_drive_is_flushed_too(monkeypatch: pytest.MonkeyPatch, descriptor: int, able: bool) -> None:
    asked: list[str] = []

    def call(fd: int, command: int) -> None:
        asked.append(f"fcntl {command}")
        if not able:
            raise OSError(errno.ENOTSUP, "a network disk")

    monkeypatch.setattr(sys, "platform", "darwin")
    monkeypatch.setitem(sys.modules, "fcntl", types.SimpleNamespace(fcntl=call, F_FULLFSYNC=51))  # type: ignore[misc]
    hide(monkeypatch, "fdatasync")
    monkeypatch.setattr(os, "fsync", lambda fd: asked.append("fsync"))
    sync_data(descriptor)
    assert asked == ["fcntl 51"] + ([] if able else ["fsync"])


def test_files_are_flushed_by_a_descriptor_that_may_write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows flushes no other, and opens no folder."""
    modes: list[int] = []
    real = os.open

    def opened(path: Path, flags: int, *more: int) -> int:
        modes.append(flags & (os.O_RDONLY | os.O_WRONLY | os.O_RDWR))
        return real(path, flags, *more)

    (tmp_path / "f").write_bytes(b"1")
    hide(monkeypatch, "O_DIRECTORY")
    monkeypatch.setattr(os, "open", opened)
    sync_file(tmp_path / "f")
    sync_folder(tmp_path)
    assert modes == [os.O_RDWR]


def test_a_target_that_is_open_elsewhere_is_named_on_windows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(os, "replace", refused)
    with pytest.raises(PermissionError):
        replace(tmp_path / "a", tmp_path / "b")
    monkeypatch.setattr(sys, "platform", "win32")
    words = "b: expected a file that can be replaced, got one that is open in another program; close"
    with pytest.raises(StorageError, match=words):
        replace(tmp_path / "a", tmp_path / "b")


def test_a_file_is_written_whole_without_the_calls_of_unix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    hide(monkeypatch, "pwrite", "pread", "posix_fallocate", "fdatasync", "O_DIRECTORY", "sched_getaffinity")
    for text in ("old", "new"):
        with replace_whole(tmp_path / "H.h5") as part:
            part.write_text(text)
    assert (tmp_path / "H.h5").read_text() == "new" and len(list(tmp_path.iterdir())) == 1


@POSIX
def test_a_lock_is_held_until_the_file_is_closed(tmp_path: Path, descriptor: int) -> None:
    lock(descriptor)
    other = os.open(tmp_path / "f", os.O_RDWR)
    try:
        with pytest.raises(OSError, match=r"."):
            lock(other)
    finally:
        os.close(other)


def test_windows_locks_a_byte_far_from_the_data(monkeypatch: pytest.MonkeyPatch, descriptor: int) -> None:
    places: list[tuple[int, int]] = []
    fake = types.SimpleNamespace(
        LK_NBLCK=2, locking=lambda fd, mode, n: places.append((os.lseek(fd, 0, os.SEEK_CUR), n))
    )
    monkeypatch.setitem(sys.modules, "msvcrt", fake)  # type: ignore[misc]
    monkeypatch.setattr(sys, "platform", "win32")
    lock(descriptor)
    assert places == [(1 << 30, 1)]


@POSIX
def test_processes_live_and_die() -> None:
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    assert is_alive(child.pid) and is_alive(os.getpid()) and is_alive(1)
    child.communicate(b"\n")
    assert not is_alive(child.pid)
    assert not is_alive(1 << 80)


def test_windows_is_asked_by_a_handle_and_never_by_a_signal(monkeypatch: pytest.MonkeyPatch) -> None:
    closed: list[int] = []
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setattr(os, "kill", lambda *_: pytest.fail("a signal was sent"))
    for handle, error, code, alive in ((0, 87, 0, False), (0, 5, 0, True), (7, 0, 259, True), (7, 0, 1, False)):

        def exit_code(_: int, place: Any, code: int = code) -> int:
            place._obj.value = code
            return 1

        calls = {"OpenProcess": lambda *_, handle=handle: handle, "GetExitCodeProcess": exit_code}
        kernel = types.SimpleNamespace(**calls, CloseHandle=closed.append)
        monkeypatch.setattr(ctypes, "WinDLL", lambda *_, kernel=kernel, **__: kernel, raising=False)
        monkeypatch.setattr(ctypes, "get_last_error", lambda error=error: error, raising=False)
        assert is_alive(1234) is alive
    assert closed == [7, 7]


Files = dict[str, str]
CPU, V1 = "cpu.max", ("cpu.cfs_quota_us", "cpu.cfs_period_us")


def quota(folder: str, number: str, period: str) -> Files:
    return dict(zip((f"{folder}/{name}" for name in V1), (number, period), strict=True))


def limit(most: str, used: str, folder: str = "") -> Files:
    """Return the files of a group whose memory is limited."""
    return {f"{folder}memory.max": most, f"{folder}memory.current": used}


CPUS: list[tuple[str, Files, int]] = [
    ("0::/", {CPU: "150000 100000"}, 2),
    ("0::/", {CPU: "max 100000"}, 64),
    ("0::/", {}, 64),
    ("0::/a/b", {"a/b/cpu.max": "max 100000", "a/cpu.max": "300000 100000"}, 3),
    ("0::/docker/123", {CPU: "50000 100000"}, 1),
    ("0::/../..", {CPU: "200000 100000"}, 2),
    ("4:cpu,cpuacct:/d", quota("cpu,cpuacct/d", "250000", "1e5"), 64),
    ("4:cpu,cpuacct:/d", quota("cpu", "250000", "100000"), 3),
    ("4:cpu:/d\n0::/", quota("cpu/d", "-1", "100000"), 64),
    ("4:memory:/d", {"memory/d/cpu.max": "100000 100000"}, 64),
    ("nonsense", {CPU: "7 0"}, 64),
    ("0::/", {CPU: "9999999 100000"}, 64),
]
OLD_LIMIT = {"memory/d/memory.limit_in_bytes": "2048000", "memory/d/memory.usage_in_bytes": "0"}
MEMORY: list[tuple[str, Files, int]] = [
    ("0::/", {}, 6_000),
    ("0::/", limit("max", "1024"), 6_000),
    ("0::/", limit("4096000", "1024000"), 3_000),
    ("0::/", limit("1024", "2048"), 0),
    ("0::/", limit("4096000", "3072000") | {"memory.stat": "anon 5\ninactive_file 2048000"}, 3_000),
    ("0::/a/b", limit("2048000", "1024000", "a/"), 1_000),
    ("6:memory:/d", OLD_LIMIT, 2_000),
    ("6:cpu:/d", OLD_LIMIT, 6_000),
]


def grouped(root: Path, groups: str, files: Files) -> Path:
    """Write what the kernel shows of the control groups of a process."""
    for name, text in {"proc/self/cgroup": groups, **{f"sys/fs/cgroup/{name}": t for name, t in files.items()}}.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text + "\n")
    (root / "proc" / "meminfo").write_text("MemTotal: 9000 kB\nMemAvailable:    6000 kB\n")
    return root


def test_the_limits_of_containers_are_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(64)), raising=False)
    for k, (groups, files, expected) in enumerate(CPUS):
        assert processors(grouped(tmp_path / f"c{k}", groups, files)) == expected, (groups, files)
    for k, (groups, files, expected) in enumerate(MEMORY):
        assert free_memory(grouped(tmp_path / f"m{k}", groups, files)) == expected * 1024, (groups, files)
    hide(monkeypatch, "sched_getaffinity")
    for count, expected in ((5, 5), (None, 1)):
        monkeypatch.setattr(os, "cpu_count", lambda count=count: count)
        assert processors(tmp_path) == expected


def test_memory_where_the_system_does_not_report_it(tmp_path: Path) -> None:
    assert free_memory(tmp_path) > 1 << 20
    assert memory_in_use(tmp_path) == 0


def test_memory_in_use_grows_with_what_is_held() -> None:
    before = memory_in_use()
    held = mmap.mmap(-1, 64 << 20)  # new pages: the heap may reuse pages that are in memory already
    held.write(b"x" * len(held))
    assert memory_in_use() == 0 or memory_in_use() > before + len(held) // 2
    assert peak_memory() >= before + len(held) // 2


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="two ways to ask are compared")
def test_other_systems_report_the_same_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Through psutil, which asks this system as it asks theirs."""
    total, used = total_memory(), memory_in_use()
    monkeypatch.setattr(system, "sys", types.SimpleNamespace(platform="darwin"))
    assert total_memory() == total
    assert 0 < free_memory() < total
    assert 0.5 * used < memory_in_use() < 2 * used
    in_bytes = peak_memory()
    monkeypatch.setattr(system, "sys", types.SimpleNamespace(platform="linux"))
    assert peak_memory() == 1024 * in_bytes, "the same number, in kilobytes there"


def test_the_peak_of_memory_on_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    """A field of psutil that is there only."""
    process = types.SimpleNamespace(memory_info=lambda: types.SimpleNamespace(peak_wset=123))
    monkeypatch.setitem(sys.modules, "psutil", types.SimpleNamespace(Process=lambda: process))  # type: ignore[misc]
    monkeypatch.setattr(system, "sys", types.SimpleNamespace(platform="win32"))
    assert peak_memory() == 123 and peak_memory(children=True) == 0


DEVICE, END = "is the name of a device on Windows", "Windows drops a dot or a space at the end of a name"
NOT_ALLOWED = "is not allowed in the name of a file on Windows"
NAMES = {
    **dict.fromkeys(("H.h5", "console.h5", "../x/./H.h5", "comet.tif"), ""),
    **{"NUL": f"NUL {DEVICE}", "out/aux.h5": f"aux.h5 {DEVICE}", "Com1.tar.gz": f"Com1.tar.gz {DEVICE}"},
    **{"lpt9 .csv": f"lpt9 .csv {DEVICE}", "nul/H.h5": f"nul {DEVICE}"},
    **{"H.": f"'H.': {END}", "plane ": f"'plane ': {END}"},
    **{"12:30.h5": f"':' {NOT_ALLOWED}", "what?.h5": f"'?' {NOT_ALLOWED}", "a\tb": f"'\\t' {NOT_ALLOWED}"},
}


def test_names_that_windows_does_not_give_to_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert {name_refused(Path(name)) for name in NAMES} == {""}
    monkeypatch.setattr(system, "sys", types.SimpleNamespace(platform="win32"))
    assert {name: name_refused(Path(name)) for name in NAMES} == NAMES
    assert name_refused(tmp_path / "H.h5") == "", "the anchor of a path is none of its names"
    for name, why in NAMES.items():
        if why:
            with pytest.raises(StorageError, match=re.escape(f"{why}; choose another name")):
                check_writable(tmp_path / name)


def test_a_path_that_is_too_long_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    long = Path("C:/", *["folder"] * 40)
    missing = FileNotFoundError(errno.ENOENT, "No such file or directory")
    assert not too_long(long) and storage_words(missing, long).endswith("check the path")
    monkeypatch.setattr(system, "sys", types.SimpleNamespace(platform="win32"))
    assert too_long(long) and not too_long("C:/H.h5") and not too_long(f"\\\\?\\{long}")
    assert storage_words(missing, long).endswith("choose a shorter path, or enable long paths in Windows")
    with pytest.raises(StorageError, match="choose a shorter name"), storage_errors(tmp_path):
        raise OSError(errno.ENAMETOOLONG, "File name too long")


# -- files that appear whole -------------------------------------------------------------------------------------------


def write(path: Path, text: str) -> None:
    with replace_whole(path) as part:
        part.write_text(text)


def test_a_link_is_followed_not_replaced(tmp_path: Path) -> None:
    target, link = tmp_path / "data" / "H.h5", tmp_path / "H.h5"
    target.parent.mkdir()
    target.write_text("old")
    link.symlink_to(target)
    write(link, "new")
    assert link.is_symlink() and target.read_text() == "new"
    assert [p.name for p in target.parent.iterdir()] == ["H.h5"]


def test_an_existing_file_keeps_its_mode_and_is_kept_where_it_is_read_only(tmp_path: Path) -> None:
    path = tmp_path / "H.h5"
    write(path, "old")
    path.chmod(0o640)
    write(path, "new")
    assert stat.S_IMODE(path.stat().st_mode) == 0o640 and path.read_text() == "new"
    path.chmod(0o400)
    words = r"H\.h5: this file is read-only; choose another name, or make the file writable"
    with pytest.raises(StorageError, match=words):
        write(path, "other")
    path.chmod(0o640)
    with pytest.raises(RuntimeError), replace_whole(path) as part:
        part.write_text("half")
        raise RuntimeError
    assert path.read_text() == "new" and len(list(tmp_path.iterdir())) == 1


def test_scratch_files_left_behind_are_swept_and_only_those(tmp_path: Path) -> None:
    """While the lock of a file is held, other scratch files of it are left over, whichever process has their number."""
    left = [f".H.h5.{os.getppid()}.part", ".H.h5.99999999.part", ".other.h5.7.part", ".H.h5.x.part"]
    for name in left:
        (tmp_path / name).write_text("left")
    write(tmp_path / "H.h5", "new")
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([*left[2:], "H.h5"])


def test_the_input_is_never_the_output(tmp_path: Path) -> None:
    path = tmp_path / "H.h5"
    path.write_text("H")
    (tmp_path / "hard.h5").hardlink_to(path)
    for other in (path, tmp_path / "." / "H.h5", tmp_path / "hard.h5"):
        with pytest.raises(InputError, match="output: expected a file other than the input"):
            check_other_file(path, other)
    check_other_file(path, tmp_path / "new.h5")
    check_other_file("", path)
