"""Units: their fingerprints, and the records by which they are sent and stored."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.base.axes import Position
from lfcal.base.errors import FileFormatError, StorageError, UnsafeFileError
from lfcal.camera import PRESETS, preset
from lfcal.judge.quality.metric import Reading
from lfcal.psf.facts import Origin
from lfcal.work.records import load_record, save_record
from lfcal.work.unit import Job, ProcessCache, Unit, file_name, stamp_of
from tests.work.tasks import unit


def test_a_fingerprint_is_that_of_task_settings_inputs_and_version(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frame = tmp_path / "frame.tif"
    with pytest.raises(StorageError, match=r"frame\.tif"):
        unit("a", inputs=(str(frame),)).fingerprint()
    frame.write_bytes(b"light")
    one = unit("plane 3", inputs=(str(frame),), text="a", depth=3.0)
    found = one.fingerprint()
    assert found == unit("plane 3", inputs=(str(frame),), depth=3.0, text="a").fingerprint()
    assert found == replace(one, name="another").fingerprint()  # the name is for people
    others = [
        replace(one, arguments={"text": "a", "depth": 3.0000000001}),
        replace(one, task="tests.work.tasks:refuse"),
        replace(one, inputs=()),
    ]
    known = {found, *(other.fingerprint() for other in others)}
    assert len(known) == 4
    os.utime(frame, ns=(1, 1))
    assert one.fingerprint() not in known
    frame.write_bytes(b"more light")
    assert one.fingerprint() not in known
    before = one.fingerprint()
    monkeypatch.setattr("lfcal.work.unit.__version__", "99")
    assert one.fingerprint() != before


def test_file_names_are_plain() -> None:
    for name in ("plane 3", "../../etc/passwd", "z=3/ü", "a.b"):
        found = file_name(Unit(name, "a:b", {}), "0123")
        assert Path(found).name == found and found.endswith(".0123.h5") and found.count(".") == 2


def test_units_and_cameras_are_small_when_sent() -> None:
    job = Job(3, unit("plane 3", text="a"), "/somewhere/out")
    for one, size in ((job, 1000), *((preset(name), 10_000) for name in PRESETS)):
        sent = pickle.dumps(one)
        assert len(sent) < size and pickle.loads(sent) == one


class Tool:
    def __init__(self, name: str) -> None:
        self.name = name


def makers() -> tuple[ProcessCache[Tool], list[str], Callable[[str], Tool]]:
    events: list[str] = []

    def make(name: str) -> Tool:
        events.append(f"make {name}")
        return Tool(name)

    return ProcessCache(lambda tool: events.append(f"close {tool.name}")), events, make


def test_a_process_keeps_one_tool_at_a_time_and_does_not_close_a_lent_one() -> None:
    held, events, make = makers()
    first = held.get("a", lambda: make("a"))
    assert held.get("a", lambda: make("a")) is first
    assert held.get("b", lambda: make("b")).name == "b"
    assert events == ["make a", "close a", "make b"]
    held, events, make = makers()
    mine = Tool("mine")
    with held.using("a", mine):
        assert held.get("a", lambda: make("a")) is mine
    assert held.get("a", lambda: make("a")) is not mine
    with held.using("a", mine):
        held.get("b", lambda: make("b"))
    assert held.get("b", lambda: make("b")).name == "b"
    assert events == ["make a", "close a", "make b"]


def test_a_stamp_changes_with_its_files(tmp_path: Path) -> None:
    one, two = tmp_path / "a", tmp_path / "b"
    one.write_text("x")
    two.write_text("y")
    before = stamp_of([str(one), str(two)])
    assert stamp_of([str(one), str(two)]) == before
    assert stamp_of([str(one)]) != before
    two.write_text("yy")
    assert stamp_of([str(one), str(two)]) != before


# -- records of numbers and arrays, in files that run nothing when they are read -------------------------
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
    """A file next to an output may be from anywhere: one once renamed what lfcal makes until the program ended."""
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
