"""Any part of any chunked dataset is what HDF5 reads, without HDF5."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from lfcal.errors import FileFormatError
from lfcal.h5.file import H5File

SHAPE = (5, 7, 11)
VALUES = np.random.default_rng(3).integers(-30000, 30000, SHAPE).astype(">i2")
CHUNKS = [(1, 7, 11), (2, 3, 4), (5, 7, 11), (8, 8, 16)]
OPTIONS: list[dict[str, object]] = [
    {},
    {"compression": "gzip", "shuffle": True, "fletcher32": True},
    {"compression": "lzf"},
]
PARTS = [
    (),
    3,
    -1,
    (slice(None), 2),
    (4, slice(1, 6, 2), slice(None, None, -3)),
    (slice(1, 1), slice(None), 5),
    (2, 3, 4),
    (slice(-2, None), slice(2, 5), slice(3, 4)),
]


@pytest.mark.parametrize("userblock", [0, 512])
@pytest.mark.parametrize("options", OPTIONS)
@pytest.mark.parametrize("chunks", CHUNKS)
def test_parts_are_those_of_h5py(
    tmp_path: Path, chunks: tuple[int, ...], options: dict[str, object], userblock: int
) -> None:
    with h5py.File(tmp_path / "a.h5", "w", userblock_size=userblock) as file:
        file.create_dataset("a", data=VALUES, chunks=chunks, maxshape=(None, None, None), **options)
    with H5File(tmp_path / "a.h5") as file:
        data = file.dataset("a")
        for part in PARTS:
            found = data.read(part)
            assert found.dtype == VALUES.dtype
            np.testing.assert_array_equal(found, VALUES[part])
        for wrong in (5, (0, 0, 11), (0, 0, 0, 0)):
            with pytest.raises(IndexError):
                data.read(wrong)


@pytest.mark.parametrize("kind", ["latest", "earliest"])
def test_every_kind_of_index(tmp_path: Path, kind: str) -> None:
    """HDF5 keeps chunks in five ways: single, implicit, fixed and extensible arrays, B-trees of two versions."""
    whole = {"single": ((5, 7, 11), None), "fixed": ((2, 3, 4), None), "extensible": ((2, 3, 4), (None, 7, 11))}
    with h5py.File(tmp_path / "a.h5", "w", libver=kind) as file:
        for name, (chunks, limit) in {**whole, "tree": ((2, 3, 4), (None, None, 11))}.items():
            file.create_dataset(name, data=VALUES, chunks=chunks, maxshape=limit, compression="gzip")
    with H5File(tmp_path / "a.h5") as file:
        for name in file.names():
            np.testing.assert_array_equal(file.dataset(name).read(), VALUES)


def test_holes_read_as_the_fill_value(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        made = file.create_dataset("a", (4, 6), "f4", chunks=(1, 6), fillvalue=-2.5)
        made[1] = 7
    with H5File(tmp_path / "a.h5") as file:
        with pytest.raises(FileFormatError, match="expected all chunks written, got 3 missing"):
            file.dataset("a")
        data = file.dataset("a", holes=True)
        assert data.read((slice(None), 0)).tolist() == [-2.5, 7, -2.5, -2.5]


def test_a_file_that_is_still_written(tmp_path: Path) -> None:
    from lfcal.h5.dataset import H5Data

    with h5py.File(tmp_path / "a.h5", "w") as file:
        made = file.create_dataset("a", (4, 6), "f4", chunks=(1, 6), compression="gzip")
        made[...] = 3
        assert (H5Data(made).read() == 3).all()
