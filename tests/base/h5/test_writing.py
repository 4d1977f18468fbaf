"""New HDF5 files: whole, or not at all, whatever the disk does."""

from __future__ import annotations

import errno
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from lfcal.base.errors import StorageError
from lfcal.base.h5 import writing
from lfcal.base.h5.writing import new_h5


def fill(file: Any) -> None:
    data = file.create_dataset("H", (50, 64), "u2", chunks=(1, 64), compression="gzip", fletcher32=True)
    for k in range(50):
        data[k] = np.random.default_rng(k).integers(0, 1 << 16, 64)
    file.attrs["about"] = "x" * 500
    file["group/more"] = np.arange(1000)


def test_what_is_written_is_read(tmp_path: Path) -> None:
    header = b"header" + bytes(506)
    with new_h5(tmp_path / "a.h5", header=header, libver=("earliest", "v110")) as file:
        fill(file)
    assert (tmp_path / "a.h5").read_bytes()[:512] == header
    with h5py.File(tmp_path / "a.h5") as file:
        assert file["H"][7].tolist() == np.random.default_rng(7).integers(0, 1 << 16, 64).tolist()
        assert file["group/more"][-1] == 999 and file.attrs["about"] == "x" * 500


class FullDisk(writing._Bytes):
    """A disk that takes so many bytes and no more."""

    room = 0

    def _write(self, view: memoryview) -> None:
        if self._at + len(view) > self.room:
            raise OSError(errno.ENOSPC, "No space left on device")
        super()._write(view)


@pytest.mark.parametrize("room", [0, 600, 2048, 4000, 6000, 9000, 12000, 14000, 15000])
def test_a_disk_that_fills_up_at_any_moment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, room: int) -> None:
    monkeypatch.setattr(writing, "_Bytes", FullDisk)
    monkeypatch.setattr(FullDisk, "room", room)
    path = tmp_path / "a.h5"
    path.write_bytes(b"old")
    with pytest.raises(StorageError, match=r"a\.h5: No space left on device; free some space"):
        with new_h5(path) as file:
            fill(file)
    assert path.read_bytes() == b"old" and list(tmp_path.iterdir()) == [path]


def test_an_error_of_the_writer_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    path.write_bytes(b"old")
    with pytest.raises(ZeroDivisionError), new_h5(path) as file:
        fill(file)
        raise ZeroDivisionError
    assert path.read_bytes() == b"old" and list(tmp_path.iterdir()) == [path]
