"""`.npy` files and JSON text of unknown origin: the values, or one line."""

from __future__ import annotations

import io
import json
import struct
from itertools import cycle, product
from pathlib import Path

import numpy as np
import pytest

from lfcal.base._plain import MAX_NESTING, parse_json
from lfcal.base.errors import FileFormatError, StorageError, UnsafeFileError
from lfcal.base.npy import map_npy

GOOD = "{'descr': '<u2', 'fortran_order': False, 'shape': (2, 3), }"


def write(path: Path, header: str, data: bytes = bytes(12), *, version: int = 1) -> Path:
    raw = header.encode("latin-1") + b"\n"
    path.write_bytes(
        b"\x93NUMPY" + bytes([version, 0]) + struct.pack("<H" if version == 1 else "<I", len(raw)) + raw + data
    )
    return path


def test_what_numpy_writes_is_read(tmp_path: Path) -> None:
    dtypes = ("u1", ">u2", "<i4", "<f2", "<f4", ">f8", "<c8", "<c16", "?", "<u8")
    shapes, path = ((), (5,), (2, 3), (1, 2, 3, 5, 7)), tmp_path / "a.npy"
    versions = cycle(((1, 0), (2, 0), (3, 0)))
    for (dtype, shape, order), version in zip(product(dtypes, shapes, "CF"), versions, strict=False):
        values = np.arange(np.prod(shape, dtype=int)).reshape(shape).astype(dtype)
        stored, data = np.asarray(values, order=order), io.BytesIO()
        np.lib.format.write_array(data, stored, version=version)
        path.write_bytes(data.getvalue())
        found = map_npy(path)
        assert found.dtype == values.dtype and found.flags.f_contiguous == stored.flags.f_contiguous
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


def test_damaged_headers(tmp_path: Path) -> None:
    for case, (header, words) in BAD.items():
        with pytest.raises(FileFormatError, match=words) as caught:
            map_npy(write(tmp_path / "a.npy", header))
        assert "a.npy" in str(caught.value) and len(str(caught.value)) < 500, case


def test_other_than_numbers_and_objects_are_refused(tmp_path: Path) -> None:
    for values in (np.array([{}], object), np.array(["a"]), np.zeros(2, "f4,i4"), np.zeros(2, "M8[s]")):
        np.save(tmp_path / "a.npy", values, allow_pickle=True)
        pickled = values.dtype == object
        error, words = (UnsafeFileError, "pickled Python objects") if pickled else (FileFormatError, r"a\.npy")
        with pytest.raises(error, match=words):
            map_npy(tmp_path / "a.npy")


def test_files_that_are_not_there_or_cut_in_the_header(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="No such file"):
        map_npy(tmp_path / "a.npy")
    whole = write(tmp_path / "a.npy", GOOD).read_bytes()
    for length in range(0, len(whole), 3):
        (tmp_path / "a.npy").write_bytes(whole[:length])
        with pytest.raises(FileFormatError, match="damaged data"):
            map_npy(tmp_path / "a.npy")


# -- JSON text ---------------------------------------------------------------------------------------------------------


VALUES = [None, True, 1, -2.5, "ä 😀", [1, [2.0, "x"]], {"a": {"b": [1, 2]}}, 2**63 - 1, -(2**63), [], {}]


def test_values_are_read_to_a_depth() -> None:
    for value in VALUES:
        assert parse_json(json.dumps(value), "a.json") == value
        assert parse_json(json.dumps(value, ensure_ascii=False), "a.json") == value
    text = "[" * MAX_NESTING + "]" * MAX_NESTING
    assert parse_json(text, "a.json") == json.loads(text)
    with pytest.raises(FileFormatError):
        parse_json(f"[{text}]", "a.json")


BAD_TEXT = {
    "nothing": ("", "Expecting value"),
    "an open list": ("[1, 2", "Expecting"),
    "more after the end": ("{} x", "Extra data"),
    "NaN": ('{"a": NaN}', "the number NaN"),
    "infinity": ("-Infinity", "the number -Infinity"),
    "a number beyond floats": ("[1e999]", "the number 1e999"),
    "a number beyond 64 bits": ("[9223372036854775808]", "the number 9223372036854775808"),
    "a number of 5000 digits": ("9" * 5000, "the number 999"),
    "an entry twice": ('{"a": 1, "b": 2, "a": 3}', "'a' more than once"),
    "nesting that ends the parser": ("[" * 100_000 + "]" * 100_000, "lists nested too deeply"),
    "nesting that ends what comes after": ("[" * 600 + "]" * 600, f"more than {MAX_NESTING} levels of nested lists"),
    "objects in objects": ('{"a":' * 200 + "1" + "}" * 200, f"more than {MAX_NESTING} levels of nested lists"),
    "half a character": (r'{"name": "\ud800"}', "invalid Unicode"),
    "a control character": ('"a\x01"', "Invalid control character"),
}


def test_what_cannot_be_relied_on_is_one_line() -> None:
    for text, words in BAD_TEXT.values():
        with pytest.raises(FileFormatError, match=words) as caught:
            parse_json(text, "a.json", remedy="take another")
        message = str(caught.value)
        assert message.startswith("a.json: expected JSON text, got ") and message.endswith("; take another")
        assert len(message) < 300
