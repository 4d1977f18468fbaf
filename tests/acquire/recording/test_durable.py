"""Bytes that must survive, also where the platform lacks calls; and the lock against a second program."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from lfcal.acquire.recording import durable
from lfcal.acquire.recording.durable import FolderLock, reserve, sync_data, sync_folder, write_at
from lfcal.errors import StorageError


@pytest.mark.parametrize("plain", [False, True])
def test_write_and_reserve_with_and_without_platform_calls(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, plain: bool
) -> None:
    if plain:
        for name in ("pwrite", "posix_fallocate", "fdatasync"):
            monkeypatch.delattr(os, name, raising=False)
        monkeypatch.setattr(durable, "BLOCK", 1000)
    descriptor = os.open(tmp_path / "f", os.O_RDWR | os.O_CREAT)
    try:
        reserve(descriptor, 12345)
        assert os.fstat(descriptor).st_size == 12345
        assert write_at(descriptor, b"hello", 7) == 5
        sync_data(descriptor)
        sync_folder(tmp_path)
    finally:
        os.close(descriptor)
    assert (tmp_path / "f").read_bytes() == bytes(7) + b"hello" + bytes(12345 - 12)


def test_short_writes_are_completed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = os.pwrite
    monkeypatch.setattr(os, "pwrite", lambda fd, data, at: real(fd, memoryview(data)[:3], at))
    descriptor = os.open(tmp_path / "f", os.O_RDWR | os.O_CREAT)
    write_at(descriptor, b"0123456789", 2)
    os.close(descriptor)
    assert (tmp_path / "f").read_bytes() == b"\0\x000123456789"


def test_second_program_is_kept_out_and_a_killed_one_is_not(tmp_path: Path) -> None:
    code = (
        "import sys, time; from pathlib import Path; from lfcal.acquire.recording.durable import FolderLock;"
        "FolderLock(Path(sys.argv[1])); print('locked', flush=True); time.sleep(60)"
    )
    child = subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.PIPE)
    try:
        assert child.stdout is not None
        assert child.stdout.readline() == b"locked\n"
        with pytest.raises(StorageError, match=f"process {child.pid}"):
            FolderLock(tmp_path)
    finally:
        child.kill()
        child.wait()
        child.stdout.close()
    lock = FolderLock(tmp_path)
    with pytest.raises(StorageError):
        FolderLock(tmp_path)
    lock.release()
    lock.release()
    FolderLock(tmp_path).release()
