"""H files checked plane by plane: damage is located, and files without checksums say so."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from lfcal.base.errors import FileFormatError, StorageError
from lfcal.frames.source import Position
from lfcal.psf import PSFMatrix, save, save_regions, verify
from lfcal.psf._verify import iter_verify

SHAPE = (2, 3, 4, 9, 11)
VALUES = np.random.default_rng(3).random(SHAPE).astype(np.float32)


def flip(path: Path, offset: int) -> None:
    data = bytearray(path.read_bytes())
    data[offset] ^= 0x08
    path.write_bytes(data)


def offset_of(path: Path, name: str, at: tuple[int, ...] = ()) -> int:
    with h5py.File(path, "r") as file:
        data = file[name].id
        if not at:
            return int(data.get_offset())
        info = data.get_chunk_info_by_coord((*at, 0, 0))
        return int(info.byte_offset) + int(info.size) // 2


@pytest.mark.parametrize("dtype", ["float32", "rounded"])
@pytest.mark.parametrize("compression", ["gzip", "zstd", "none"])
def test_each_damaged_pattern_is_located(tmp_path: Path, dtype: str, compression: str) -> None:
    path = save(PSFMatrix(VALUES), tmp_path / "H.h5", dtype=dtype, compression=compression)
    clean = verify(path)
    assert clean.ok and clean.compared and (clean.planes, clean.missing, clean.damaged) == (2, 0, ())
    for at in ((0, 0, 0), (1, 2, 3), (1, 0, 2)):
        flip(path, offset_of(path, "H", at))
    found = {(d.z, d.what): d.positions for d in verify(path).damaged}
    assert found == {
        (0, "damaged"): (Position(0, 0, 0),),
        (1, "damaged"): (Position(1, 0, 2), Position(1, 2, 3)),
    }


@pytest.mark.parametrize("name", ["gone.npy", "gone.mat", "gone.h5"])
def test_a_file_that_is_not_there_is_said_first(tmp_path: Path, name: str) -> None:
    with pytest.raises(StorageError, match=f"{name}: no such file or folder; check the path"):
        verify(tmp_path / name)


def test_values_written_by_others_are_seen_though_they_decode(tmp_path: Path) -> None:
    path = save(PSFMatrix(VALUES), tmp_path / "H.h5")
    with h5py.File(path, "r+") as file:
        file["H"][1, 1, 1, 4, 4] += 0.5
    assert [(d.z, d.what) for d in verify(path).damaged] == [(1, "changed"), (1, "depth sum changed")]
    with h5py.File(path, "r+") as file:
        file["H"][0, 2, 3, 4, 4] = np.nan
    assert (0, "not finite", (Position(0, 2, 3),)) in {(d.z, d.what, d.positions) for d in verify(path).damaged}


@pytest.mark.parametrize(("name", "what"), [("checksum", "changed"), ("depth_sum", "depth sum changed")])
def test_what_is_kept_beside_the_values_is_compared_too(tmp_path: Path, name: str, what: str) -> None:
    path = save(PSFMatrix(VALUES), tmp_path / "H.h5", dtype="rounded")
    flip(path, offset_of(path, name) + 6 if name == "depth_sum" else offset_of(path, name))
    (found,) = verify(path).damaged
    assert (found.z, found.what) == (0, what)


def test_damaged_uncertainty_is_located(tmp_path: Path) -> None:
    path = save(PSFMatrix(VALUES, uncertainty=0.1 * VALUES), tmp_path / "H.h5")
    assert verify(path).ok
    flip(path, offset_of(path, "uncertainty", (1, 2, 0)))
    (found,) = verify(path).damaged
    assert (found.z, found.what, found.positions) == (1, "uncertainty damaged", (Position(1, 2, 0),))


def test_a_file_without_checksums_says_so(tmp_path: Path) -> None:
    path = save(PSFMatrix(VALUES), tmp_path / "H.h5")
    with h5py.File(path, "r+") as file:
        file.attrs["version"] = 1
        del file["checksum"]
    check = verify(path)
    assert check.ok and not check.compared
    flip(path, offset_of(path, "H", (1, 1, 1)))
    assert [d.positions for d in verify(path).damaged] == [(Position(1, 1, 1),)]


def test_every_region_of_the_field_is_read(tmp_path: Path) -> None:
    path = save_regions({"centre": PSFMatrix(VALUES), "edge": PSFMatrix(VALUES[:1])}, tmp_path / "H.h5")
    assert verify(path).planes == 3
    flip(path, offset_of(path, "regions/edge/H", (0, 1, 2)))
    assert [(d.region, d.positions) for d in verify(path).damaged] == [("edge", (Position(0, 1, 2),))]


def test_missing_positions_are_counted_and_no_fault(tmp_path: Path) -> None:
    recorded = np.ones(SHAPE[:3], np.uint16)
    recorded[0, 1, 2] = recorded[1, 0, 0] = 0
    path = save(PSFMatrix(VALUES, recorded=recorded), tmp_path / "H.h5")
    assert verify(path).missing == 2 and verify(path).ok


def test_what_is_no_h_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StorageError):
        verify(tmp_path / "none.h5")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["data"] = VALUES
    with pytest.raises(FileFormatError, match="expected an H file"):
        verify(tmp_path / "other.h5")
    path = save(PSFMatrix(VALUES), tmp_path / "H.h5")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(FileFormatError, match="expected an intact HDF5 file"):
        verify(path)


def test_progress_counts_planes(tmp_path: Path) -> None:
    path = save(PSFMatrix(VALUES), tmp_path / "H.h5")
    assert [(p.done, p.total, p.stage) for p in iter_verify(path)] == [(k, 2, "check planes") for k in range(3)]
