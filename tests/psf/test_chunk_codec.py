"""Chunks coded outside of HDF5 are those HDF5 writes and reads."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from lfcal.base.errors import FileFormatError, InputError
from lfcal.base.h5.chunks import PIPELINE, decode_chunk, encode_chunk
from lfcal.base.h5.reading import H5Data
from lfcal.psf import _chunk_codec as chunk_codec
from lfcal.psf._chunk_codec import chunk_pipeline, parallel_read, parallel_write

DTYPES = ["?", "u1", "i2", ">u2", "<f4", ">f4", "<f8", "<c8", "<c16"]
SHAPES = [(2, 2, 3, 1, 1), (1, 3, 2, 3, 7), (2, 1, 1, 11, 9), (1, 2, 2, 45, 31)]
OPTIONS = {"compression": "gzip", "compression_opts": 1, "shuffle": True, "fletcher32": True}


def sample(shape: tuple[int, ...], dtype: str, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    values = np.floor(rng.random(shape) ** 4 * 250)
    return (values % 2 if dtype == "?" else values).astype(dtype)


def create(path: Path, shape: tuple[int, ...], dtype: str, **options: object) -> h5py.File:
    file = h5py.File(path, "w")
    file.create_dataset("H", shape, dtype, chunks=(1, 1, 1, *shape[3:]), **{**OPTIONS, **options})
    return file


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("shape", SHAPES)
def test_h5py_reads_what_was_written(tmp_path: Path, shape: tuple[int, ...], dtype: str) -> None:
    array = sample(shape, dtype)
    with create(tmp_path / "a.h5", shape, dtype) as file:
        stored = sum(parallel_write(file["H"], z, array[z], workers=2) for z in range(shape[0]))
        assert stored == file["H"].id.get_storage_size()
    with h5py.File(tmp_path / "a.h5") as file:
        assert np.array_equal(file["H"][...], array)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("shape", SHAPES)
def test_what_h5py_wrote_is_read(tmp_path: Path, shape: tuple[int, ...], dtype: str) -> None:
    array = sample(shape, dtype, 1)
    with create(tmp_path / "a.h5", shape, dtype) as file:
        file["H"][...] = array
        file.flush()
        for z in range(shape[0]):
            plane = parallel_read(H5Data(file["H"], holes=True), z, workers=2)
            assert plane.dtype == array.dtype
            assert np.array_equal(plane, array[z])
        mask, raw = file["H"].id.read_direct_chunk((0, 0, 0, 0, 0))
        assert np.array_equal(decode_chunk(raw, dtype, shape[3:], mask), array[0, 0, 0])


@pytest.mark.parametrize(
    "options",
    [
        {"fletcher32": False},
        {"shuffle": False},
        {"compression": None, "compression_opts": None},
        {"shuffle": False, "fletcher32": False, "compression_opts": 9},
        {"shuffle": False, "fletcher32": False, "compression": None, "compression_opts": None},
    ],
)
def test_any_choice_of_the_three_filters(tmp_path: Path, options: dict[str, object]) -> None:
    array = sample((2, 2, 3, 9, 7), "f4")
    with create(tmp_path / "a.h5", array.shape, "f4", **options) as file:
        file["H"][0] = array[0]
        parallel_write(file["H"], 1, array[1])
        assert np.array_equal(file["H"][...], array)
        assert np.array_equal(parallel_read(H5Data(file["H"], holes=True), 1), array[1])


def test_filters_left_out_of_one_chunk(tmp_path: Path) -> None:
    array = sample((1, 1, 1, 9, 7), "f4")
    raw = encode_chunk(array, filters=("shuffle", "fletcher32"))
    with create(tmp_path / "a.h5", array.shape, "f4") as file:
        file["H"].id.write_direct_chunk((0, 0, 0, 0, 0), raw, filter_mask=0b010)
        assert np.array_equal(file["H"][...], array)
        assert np.array_equal(parallel_read(H5Data(file["H"], holes=True), 0), array[0])


def test_chunks_never_written_hold_the_fill_value(tmp_path: Path) -> None:
    array = sample((1, 2, 2, 5, 3), "f4")
    with create(tmp_path / "a.h5", array.shape, "f4", fillvalue=-3.0) as file:
        assert np.all(parallel_read(H5Data(file["H"], holes=True), 0) == -3)
        file["H"][0, 1, 0] = array[0, 1, 0]
        out = np.empty(array.shape[1:], "f4")
        assert parallel_read(H5Data(file["H"], holes=True), 0, out=out) is out
        assert np.array_equal(out, file["H"][0])
        assert np.array_equal(out[1, 0], array[0, 1, 0])


@pytest.mark.parametrize("options", [{"chunks": (1, 1, 1, 3, 3)}, {"compression": "lzf", "compression_opts": None}])
def test_other_storage_goes_through_hdf5(tmp_path: Path, options: dict[str, object]) -> None:
    array = sample((1, 2, 2, 5, 3), "f4")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        settings = {**OPTIONS, "chunks": (1, 1, 1, 5, 3), **options}
        dataset = file.create_dataset("H", array.shape, array.dtype, **settings)
        assert chunk_pipeline(dataset) is None
        assert parallel_write(dataset, 0, array[0]) == dataset.id.get_storage_size()
        assert np.array_equal(parallel_read(H5Data(dataset, holes=True), 0), array[0])


def test_pipeline_of_an_h_dataset(tmp_path: Path) -> None:
    with create(tmp_path / "a.h5", (1, 1, 1, 3, 3), "f4") as file:
        assert chunk_pipeline(file["H"]) == PIPELINE


def test_a_flipped_bit_is_found_and_the_chunk_named(tmp_path: Path) -> None:
    array = sample((1, 2, 2, 15, 13), "f4")
    raw = bytearray(encode_chunk(array[0, 1, 1]))
    raw[len(raw) // 2] ^= 4
    with create(tmp_path / "a.h5", array.shape, "f4") as file:
        parallel_write(file["H"], 0, array[0])
        file["H"].id.write_direct_chunk((0, 1, 1, 0, 0), bytes(raw))
        with pytest.raises(FileFormatError, match=r"a\.h5:/H, chunk \(0, 1, 1, 0, 0\): expected checksum"):
            parallel_read(H5Data(file["H"], holes=True), 0)


def test_planes_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    with create(tmp_path / "a.h5", (1, 2, 2, 5, 3), "u2") as file:
        with pytest.raises(InputError, match=r"plane 0: expected \(2, 2, 5, 3\) uint16"):
            parallel_write(file["H"], 0, np.zeros((2, 2, 3, 5), "u2"))
        with pytest.raises(InputError, match="float64"):
            parallel_write(file["H"], 0, np.zeros((2, 2, 5, 3)))
        with pytest.raises(InputError, match="0 to 0"):
            parallel_read(H5Data(file["H"], holes=True), 1)
        with pytest.raises(InputError, match="0 to 0"):
            parallel_write(file["H"], -1, np.zeros((2, 2, 5, 3), "u2"))
        assert file["H"].id.get_num_chunks() == 0
        parallel_write(file["H"], 0, np.ones((2, 2, 5, 3), "u1").transpose(1, 0, 2, 3))
        assert np.all(file["H"][...] == 1)


def test_memory_stays_bounded_while_threads_run_behind() -> None:
    started, finished = 0, []

    def work(batch: list[int]) -> int:
        finished.append(batch)
        return len(batch)

    def batches():
        nonlocal started
        for k in range(100):
            started += 1
            yield [k]

    ahead = [started - k for k, _ in enumerate(chunk_codec._in_threads(work, batches(), 3))]
    assert len(finished) == 100
    assert max(ahead) <= 8


def test_the_first_failure_ends_the_work() -> None:
    def work(batch: list[int]) -> int:
        return 1 // batch[0]

    with pytest.raises(ZeroDivisionError):
        list(chunk_codec._in_threads(work, iter([[1], [0], *[[1]] * 50]), 2))
