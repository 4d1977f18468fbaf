"""Records of numbers and arrays in files that run nothing when they are read."""

from __future__ import annotations

import os
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.base.axes import Position
from lfcal.base.errors import FileFormatError, StorageError, UnsafeFileError
from lfcal.judge.quality.metric import Reading
from lfcal.psf.facts import Origin
from lfcal.work.records import load_record, save_record


def test_what_was_written_is_read(tmp_path: Path) -> None:
    path, mine = tmp_path / "a.record", object()
    values: dict[str, Any] = {
        "reading": Reading(0.5, np.arange(6.0).reshape(2, 3), np.array([[True, False]]), "words"),
        "place": Position(1, 2, 3),
        "origin": Origin.MODEL,
        "number": np.float64(0.1),
        "none": (None, [1, 2.5, "x"]),
        "mine": mine,
    }
    save_record(path, values, {"mine": mine})
    found = load_record(path, {"mine": "another"})
    reading, given = found.pop("reading"), values.pop("reading")
    np.testing.assert_array_equal(reading.map, given.map)
    np.testing.assert_array_equal(reading.positions, given.positions)
    assert (reading.value, reading.detail) == (0.5, "words")
    assert found.pop("mine") == "another" and values.pop("mine") is mine
    assert found == values and isinstance(found["place"], Position)


class Call:
    """What pickles as a call."""

    def __init__(self, function: Any, *arguments: Any) -> None:
        self.made = function, arguments

    def __reduce__(self) -> Any:
        return self.made


@pytest.mark.parametrize("function", [os.mkdir, print, eval, "remove_tree"], ids=str)
def test_a_record_runs_nothing(tmp_path: Path, function: Any) -> None:
    path, made = tmp_path / "a.record", tmp_path / "made"
    if function == "remove_tree":
        from lfcal.work.runs import discard as function
    path.write_bytes(pickle.dumps(Call(function, str(made))))
    with pytest.raises(UnsafeFileError, match="expected records of lfcal, got a pickle that requests"):
        load_record(path)
    assert not made.exists()


def test_damaged_and_missing_records_are_one_line(tmp_path: Path) -> None:
    path = tmp_path / "a.record"
    save_record(path, Reading(1.0))
    whole = path.read_bytes()
    for cut in (0, 1, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:cut])
        with pytest.raises((FileFormatError, UnsafeFileError), match="remove it and start again"):
            load_record(path)
    with pytest.raises(StorageError):
        load_record(tmp_path / "none")
    save_record(path, path, {"it": path})
    with pytest.raises(UnsafeFileError, match="the object 'it'"):
        load_record(path)


def test_a_record_changes_no_class_and_runs_no_constructor(tmp_path: Path) -> None:
    """Files beside an output may be anybody's: such a one once renamed what lfcal makes until the program ended."""
    from lfcal.work import Unit

    path, before = tmp_path / "a.record", dict(vars(Unit))
    unit, suffix = b"clfcal.work\nUnit\n", b"}S'suffix'\nS'.evil'\ns"
    crafted = {
        "values for Unit": unit + suffix + b"b.",
        "a call of Unit": unit + b"(S'n'\nS'm:f'\n}tR.",
        "an object built by an operation that lfcal never uses": b"(" + unit[1:] + b"o.",
        "numpy.testing": b"cnumpy.testing\nassert_equal\n.",
        "fields that Reading does not have": b"clfcal.judge.quality.metric\nReading\n)\x81" + suffix + b"b.",
    }
    for words, data in crafted.items():
        path.write_bytes(data)
        with pytest.raises((UnsafeFileError, FileFormatError)) as caught:
            load_record(path)
        assert words in str(caught.value) or words.startswith("an object"), str(caught.value)
    assert dict(vars(Unit)) == before
