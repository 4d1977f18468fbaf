"""Any part of any chunked dataset is what HDF5 reads, without HDF5."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable
from itertools import cycle, product
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import h5py
import numpy as np
import pytest

from lfcal.base.errors import FileFormatError
from lfcal.base.h5.chunks import ChunkTable, decode_chunk, encode_chunk, fletcher32
from lfcal.base.h5.reading import H5Data, H5File

SHAPE = (5, 7, 11)
VALUES = np.random.default_rng(3).integers(-30000, 30000, SHAPE).astype(">i2")
CHUNKS = [(1, 7, 11), (2, 3, 4), (5, 7, 11), (8, 8, 16)]
OPTIONS: list[dict[str, object]] = [
    *({}, {"compression": "gzip", "shuffle": True, "fletcher32": True}, {"compression": "lzf"}),
]
PARTS = [
    *((), 3, -1, (slice(None), 2), (4, slice(1, 6, 2), slice(None, None, -3)), (slice(1, 1), slice(None), 5)),
    *((2, 3, 4), (slice(-2, None), slice(2, 5), slice(3, 4))),
]


@pytest.mark.parametrize("userblock", [0, 512])
def test_parts_are_those_of_h5py(tmp_path: Path, userblock: int) -> None:
    for chunks, options in product(CHUNKS, OPTIONS):
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


def test_every_kind_of_index(tmp_path: Path) -> None:
    """HDF5 keeps chunks in five ways: single, implicit, fixed and extensible arrays, B-trees of two versions."""
    whole = {"single": ((5, 7, 11), None), "fixed": ((2, 3, 4), None), "extensible": ((2, 3, 4), (None, 7, 11))}
    for kind in ("latest", "earliest"):
        with h5py.File(tmp_path / "a.h5", "w", libver=kind) as file:
            for name, (chunks, limit) in {**whole, "tree": ((2, 3, 4), (None, None, 11))}.items():
                file.create_dataset(name, data=VALUES, chunks=chunks, maxshape=limit, compression="gzip")
        with H5File(tmp_path / "a.h5") as file:
            for name in file.names():
                np.testing.assert_array_equal(file.dataset(name).read(), VALUES, err_msg=f"{kind} {name}")


def test_holes_read_as_the_fill_value_also_of_a_file_that_is_still_written(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        made = file.create_dataset("a", (4, 6), "f4", chunks=(1, 6), fillvalue=-2.5)
        made[1] = 7
        assert H5Data(made, holes=True).read((slice(None), 0)).tolist() == [-2.5, 7, -2.5, -2.5]
    with H5File(tmp_path / "a.h5") as file:
        with pytest.raises(FileFormatError, match="expected all chunks written, got 3 missing"):
            file.dataset("a")
        data = file.dataset("a", holes=True)
        assert data.read((slice(None), 0)).tolist() == [-2.5, 7, -2.5, -2.5]


@pytest.mark.parametrize("ahead", [1, 100, 1 << 20])
def test_chunks_that_are_read_together_are_those_that_are_read_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ahead: int
) -> None:
    """In any order, whatever lies between them, and whichever are missing."""
    monkeypatch.setattr("lfcal.base.h5.chunks.READ_AHEAD", ahead)
    random = np.random.default_rng(5)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        made = file.create_dataset("a", (40, 30), "i4", chunks=(1, 30), compression="gzip")
        other = file.create_dataset("b", (40, 30), "i4", chunks=(1, 30))
        for k in random.permutation(40)[:33]:
            made[k], other[k] = random.integers(0, 9 + k, 30), k
    with H5File(tmp_path / "a.h5") as file:
        table = file.dataset("a", holes=True).table
        assert table is not None
        for order in (range(40), random.permutation(40).tolist()):
            starts = [(k, 0) for k in order]
            found = {start: (left_out, bytes(raw)) for start, left_out, raw in table.each_stored(starts)}
            assert found == {start: stored for start in starts if (stored := table.stored(start)) is not None}
            assert len(found) == 33 and list(found) == [start for start in starts if start in found]


class Entry(NamedTuple):
    """An entry of an index, as h5py has it."""

    chunk_offset: tuple[int, ...]
    filter_mask: int
    byte_offset: int
    size: int


def going_through(entries: Iterable[Entry]) -> Callable[[Callable[[Entry], object]], None]:
    """Return what calls a function with each entry, as HDF5 does."""

    def chunk_iter(look: Callable[[Entry], object]) -> None:
        for entry in entries:
            look(entry)

    return chunk_iter


WRONG_ENTRIES: list[tuple[dict[str, Any], str]] = [
    ({"byte_offset": 0}, "8 bytes at 0"),
    ({"byte_offset": 2**64 - 1}, f"8 bytes at {2**64 - 1}"),
    ({"byte_offset": 10**6}, "8 bytes at 1000000"),
    ({"size": 4}, "of 4 bytes"),
    ({"size": 2**63 + 5}, f"of {2**63 + 5} bytes"),
    ({"chunk_offset": (5, 0)}, r"chunk \(5, 0\)"),
    ({"chunk_offset": (2**64 - 2, 0)}, f"chunk .{2**64 - 2}, 0"),
    ({"chunk_offset": (0, 0)}, r"chunk \(0, 0\)"),
]


@pytest.mark.parametrize("at_once", [1, 2, 1 << 14])
def test_an_index_that_is_damaged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at_once: int) -> None:
    """The first entry that cannot be is named; an index that leads round and round comes to an end."""
    monkeypatch.setattr("lfcal.base.h5.chunks.BLOCK_ENTRIES", at_once)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("a", data=np.zeros((4, 6), "f4"), chunks=(1, 6), compression="gzip")
    with h5py.File(tmp_path / "a.h5") as file:
        real = file["a"]
        known = {name: getattr(real, name) for name in ("shape", "chunks", "dtype", "fillvalue", "file")}
        for (wrong, words), endless in product(WRONG_ENTRIES, (False, True)):
            good = [Entry((k, 0), 0, 100, 8) for k in range(3)]
            entries = [*good, Entry((3, 0), 0, 100, 8)._replace(**wrong)]
            chunk_iter = going_through(cycle(entries) if endless else entries)
            index = SimpleNamespace(chunk_iter=chunk_iter, get_create_plist=real.id.get_create_plist)
            with pytest.raises(FileFormatError, match=words):
                ChunkTable(SimpleNamespace(id=index, **known), tmp_path / "a.h5", "a")


def sample(shape: tuple[int, ...]) -> np.ndarray:
    return np.floor(np.random.default_rng(0).random(shape) ** 4 * 250).astype("f4")


def plain_fletcher32(data: bytes) -> int:
    """Return the closed form: sums modulo 65535 of big-endian words, where a non-zero sum is never 0."""
    padded = data + b"\0" * (len(data) % 2)
    words = [int.from_bytes(padded[k : k + 2], "big") for k in range(0, len(padded), 2)]
    first = sum(words)
    second = sum((len(words) - k) * word for k, word in enumerate(words))
    one, two = (v % 65535 or (65535 if v else 0) for v in (first, second))
    return two << 16 | one


def test_fletcher32_equals_its_closed_form() -> None:
    for length in (0, 1, 2, 3, 7, 719, 720, 721, 722, 5001, 100_003):
        data = np.random.default_rng(length).integers(0, 256, length, dtype=np.uint8).tobytes()
        assert fletcher32(data) == plain_fletcher32(data)
        assert fletcher32(b"\xff" * length) == plain_fletcher32(b"\xff" * length)


def test_every_byte_counts_and_swapped_checksums_of_old_files_are_read() -> None:
    array = sample((9, 7))
    raw = encode_chunk(array)
    for position in (0, 7, -1):
        wrong = bytearray(raw)
        wrong[position] ^= 1
        with pytest.raises(FileFormatError):
            decode_chunk(bytes(wrong), "f4", (9, 7))
    a, b, c, d = raw[-4:]
    assert np.array_equal(decode_chunk(raw[:-4] + bytes((b, a, d, c)), "f4", (9, 7)), array)
    with pytest.raises(FileFormatError):
        decode_chunk(raw[:-4] + bytes((d, c, b, a)), "f4", (9, 7))


def test_damage_without_a_checksum_is_found() -> None:
    both = ("shuffle", "deflate")
    raw = encode_chunk(sample((9, 7)), filters=both)
    for data, filters, words in (
        (raw[:-20], both, "expected 252 bytes"),
        (b"\0" + raw, both, "damaged bytes"),
        (zlib.compress(bytes(10_000_000)), both, "expected 252 bytes, got 253"),
        (b"ab", ("fletcher32",), "checksum"),
    ):
        with pytest.raises(FileFormatError, match=words):
            decode_chunk(data, "f4", (9, 7), filters=filters)
