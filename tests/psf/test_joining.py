"""Planes of files of their own, joined: the file that one writer would have written, byte for byte where it counts."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from lfcal.base.errors import FileFormatError, InputError, StorageError
from lfcal.psf import open_psf
from lfcal.psf._joining import adopt
from lfcal.psf.facts import Facts
from lfcal.psf.store import PSFWriter

SHAPE = (3, 2, 4, 5, 7)
DEPTHS = [100.0, 250.0, 300.0]


def facts_of(z: int) -> Facts:
    """Return facts that differ from plane to plane: the last one knows least."""
    if z == 2:
        return Facts.of(SHAPE[1:3], SHAPE[3:])
    known: dict[str, Any] = {"saturated": np.full((2, 4), z), "error": 0.01 * (z + 1)}
    if z == 1:
        known |= {"noise": np.ones((2, 4, 2)), "valid": np.full((2, 4, 5), 254), "origin": np.ones((2, 4))}
    return Facts.of(SHAPE[1:3], SHAPE[3:], **known)


def write(path: Path, planes: list[int], values: np.ndarray, uncertain: int | None, **how: Any) -> Path:
    with PSFWriter(path, (len(planes), *SHAPE[1:]), depths=[DEPTHS[z] for z in planes], **how) as writer:
        for k, z in enumerate(planes):
            stated = np.abs(values[z]) / 50 if z == uncertain else None
            writer.write_plane(k, values[z], facts=facts_of(z), uncertainty=stated)
    return path


def join(parts: list[Path], writer: PSFWriter) -> None:
    with writer:
        for z, part in enumerate(parts):
            adopt(writer, z, part)


def contents(path: Path) -> dict[str, Any]:
    """Return every dataset as stored, chunk by chunk, and every attribute of an HDF5 file.

    Seconds in the provenance are left out: they differ from run to run.
    """
    found: dict[str, Any] = {}

    def look(name: str, entry: Any) -> None:
        found.update({f"{name}@{key}": np.asarray(value).tolist() for key, value in entry.attrs.items()})
        if f"{name}@provenance" in found:
            found[f"{name}@provenance"] = re.sub(r'seconds": [0-9.e-]+', 'seconds": 0', found[f"{name}@provenance"])
        if isinstance(entry, h5py.Dataset):
            found[name] = np.asarray(entry[()]).tobytes()
            if entry.chunks:
                chunks: list[Any] = []
                entry.id.chunk_iter(lambda c: chunks.append(c.chunk_offset))
                found[f"{name} stored"] = {at: entry.id.read_direct_chunk(at) for at in chunks}

    with h5py.File(path) as file:
        look("", file)
        file.visititems(look)
    return found


@pytest.mark.parametrize("dtype", ["float32", "rounded"])
@pytest.mark.parametrize("compression", ["gzip", "zstd", "none"])
@pytest.mark.parametrize("uncertain", [None, 1])
@pytest.mark.few(6)
def test_the_file_that_one_writer_would_have_written(
    tmp_path: Path, dtype: str, compression: str, uncertain: int | None
) -> None:
    values = np.random.default_rng(1).random(SHAPE).astype(np.float32)
    values[:, :, :, 0] = 0  # a window of the cutout is in use
    how: dict[str, Any] = {"dtype": dtype, "compression": compression}
    common = how | {"anchor": (3.0, 4.0), "provenance": {"from": "a test"}, "region": "corner"}
    whole = write(tmp_path / "whole.h5", [0, 1, 2], values, uncertain, **common)
    parts = [write(tmp_path / f"{z}.h5", [z], values, uncertain, **how) for z in range(3)]
    joined = tmp_path / "joined.h5"
    join(parts, PSFWriter(joined, SHAPE, depths=DEPTHS, **common))
    assert contents(joined) == contents(whole)
    with open_psf(joined, check=True) as found, open_psf(whole) as wanted:
        np.testing.assert_array_equal(found[:], wanted[:])
        assert found.depths.tolist() == DEPTHS


def test_parts_that_do_not_fit(tmp_path: Path) -> None:
    values = np.ones(SHAPE, np.float32)
    parts = [write(tmp_path / f"{z}.h5", [z], values, None, compression="none") for z in range(3)]
    joined = tmp_path / "joined.h5"
    with pytest.raises(InputError, match="stored like the other planes"):
        join(parts, PSFWriter(joined, SHAPE))
    with pytest.raises(InputError, match="plane 0"):
        join(parts, PSFWriter(joined, (3, 2, 4, 5, 9), compression="none"))
    two = write(tmp_path / "two.h5", [0, 1], values, None, compression="none")
    with pytest.raises(FileFormatError, match="one plane"):
        join([two], PSFWriter(joined, (1, *SHAPE[1:]), compression="none"))
    with pytest.raises(StorageError, match="no such file"):
        join([tmp_path / "gone.h5"], PSFWriter(joined, (1, *SHAPE[1:])))
    with pytest.raises(InputError, match="without planes \\[2\\]"):
        join(parts[:2], PSFWriter(joined, SHAPE, compression="none"))
    assert not joined.exists() and not list(tmp_path.glob(".joined*"))
