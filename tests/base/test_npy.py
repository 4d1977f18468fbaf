"""``.npy`` files: every header that NumPy writes for numbers is read, all else is one line."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import numpy as np
import pytest

from lfcal.base.errors import FileFormatError, StorageError, UnsafeFileError
from lfcal.base.npy import map_npy

GOOD = "{'descr': '<u2', 'fortran_order': False, 'shape': (2, 3), }"


def write(path: Path, header: str, data: bytes = bytes(12), *, version: int = 1) -> Path:
    raw = header.encode("latin-1") + b"\n"
    path.write_bytes(
        b"\x93NUMPY" + bytes([version, 0]) + struct.pack("<H" if version == 1 else "<I", len(raw)) + raw + data
    )
    return path


@pytest.mark.parametrize("dtype", ["u1", ">u2", "<i4", "<f2", "<f4", ">f8", "<c8", "<c16", "?", "<u8"])
@pytest.mark.parametrize("shape", [(), (5,), (2, 3), (1, 2, 3, 5, 7)])
@pytest.mark.parametrize("version", [(1, 0), (2, 0), (3, 0)])
def test_what_numpy_writes_is_read(
    tmp_path: Path, dtype: str, shape: tuple[int, ...], version: tuple[int, int]
) -> None:
    values = np.arange(np.prod(shape, dtype=int)).reshape(shape).astype(dtype)
    for order in "CF":
        data = io.BytesIO()
        np.lib.format.write_array(data, np.asarray(values, order=order), version=version)
        (tmp_path / "a.npy").write_bytes(data.getvalue())
        found = map_npy(tmp_path / "a.npy")
        assert (
            found.dtype == values.dtype
            and found.flags.f_contiguous == np.asarray(values, order=order).flags.f_contiguous
        )
        np.testing.assert_array_equal(found, values)


def test_other_writers_headers_are_read(tmp_path: Path) -> None:
    for header in (
        '{"descr": "<u2", "fortran_order": False, "shape": (2, 3)}',
        "{'shape': (2,3,), 'fortran_order': False, 'descr': '<u2'}",
        "{'descr': '<u2', 'fortran_order': False, 'shape': (2L, 3L), }   ",
    ):
        assert map_npy(write(tmp_path / "a.npy", header)).shape == (2, 3)


BAD = {
    "an open bracket": (GOOD.replace(")", ""), "damaged data"),
    "an open brace": (GOOD.replace("}", ""), "damaged data"),
    "a call": (GOOD.replace("(2, 3)", "__import__('os')"), "damaged data"),
    "a negative side": (GOOD.replace("2, 3", "-2, 3"), "damaged data"),
    "a side that is no number": (GOOD.replace("2, 3", "2.5, 'a'"), "damaged data"),
    "40 axes": (GOOD.replace("2, 3", "1," * 40), "damaged data"),
    "more than the file holds": (GOOD.replace("2, 3", "2, 4"), "where the header says"),
    "more than 64 bits": (GOOD.replace("2, 3", f"{2**40}, {2**40}"), "where the header says"),
    "no shape": ("{'descr': '<u2', 'fortran_order': False, 'fortran_order': False}", "incomplete"),
    "an unknown type": (GOOD.replace("<u2", "<q9"), "damaged data"),
    "nothing": ("", "damaged data"),
    "nesting without end": ("(" * 9000, "damaged data"),
    "digits without end": (GOOD.replace("2, 3", "2" * 9000), "damaged data"),
    "spaces without end": (GOOD.replace("}", " " * 9000 + "!"), "damaged data"),
    "sides without end": (GOOD.replace("2, 3", "1, " * 3000), "3000 axes"),
}


@pytest.mark.parametrize("case", BAD)
def test_damaged_headers(tmp_path: Path, case: str) -> None:
    header, words = BAD[case]
    with pytest.raises(FileFormatError, match=words) as caught:
        map_npy(write(tmp_path / "a.npy", header))
    assert "a.npy" in str(caught.value) and len(str(caught.value)) < 500


@pytest.mark.parametrize(
    "values", [np.array([{}], object), np.array(["a"]), np.zeros(2, "f4,i4"), np.zeros(2, "M8[s]")]
)
def test_other_than_numbers(tmp_path: Path, values: np.ndarray) -> None:
    np.save(tmp_path / "a.npy", values, allow_pickle=True)
    with pytest.raises(FileFormatError):
        map_npy(tmp_path / "a.npy")


def test_objects_are_unsafe(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.array([{}], object), allow_pickle=True)
    with pytest.raises(UnsafeFileError, match="pickled Python objects"):
        map_npy(tmp_path / "a.npy")


def test_files_that_are_not_there_or_cut_in_the_header(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="No such file"):
        map_npy(tmp_path / "a.npy")
    whole = write(tmp_path / "a.npy", GOOD).read_bytes()
    for length in range(0, len(whole), 3):
        (tmp_path / "a.npy").write_bytes(whole[:length])
        with pytest.raises(FileFormatError, match="damaged data"):
            map_npy(tmp_path / "a.npy")
