"""The lock of a session folder against a second program."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from lfcal.acquire.recording.durable import FolderLock
from lfcal.base.errors import StorageError


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
