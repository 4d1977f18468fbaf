"""Units: fingerprints tell results of other inputs and settings apart, and a record is all that travels."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from lfcal.base.errors import StorageError
from lfcal.camera import PRESETS, preset
from lfcal.work.unit import Job, ProcessCache, Unit, file_name, stamp_of
from tests.work.tasks import unit


def test_a_fingerprint_is_that_of_task_settings_and_inputs(tmp_path: Path) -> None:
    frame = tmp_path / "frame.tif"
    frame.write_bytes(b"light")
    one = unit("plane 3", inputs=(str(frame),), text="a", depth=3.0)
    found = one.fingerprint()
    assert found == unit("plane 3", inputs=(str(frame),), depth=3.0, text="a").fingerprint()
    # the name is for people
    assert found == replace(one, name="another").fingerprint()
    others = [
        replace(one, arguments={"text": "a", "depth": 3.0000000001}),
        replace(one, task="tests.work.tasks:refuse"),
        replace(one, inputs=()),
    ]
    frame_found = {found, *(other.fingerprint() for other in others)}
    assert len(frame_found) == 4
    os.utime(frame, ns=(1, 1))
    assert one.fingerprint() not in frame_found
    frame.write_bytes(b"more light")
    assert one.fingerprint() not in frame_found


def test_an_input_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match=r"gone\.tif"):
        unit("a", inputs=(str(tmp_path / "gone.tif"),)).fingerprint()


def test_a_new_version_computes_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    one = unit("a")
    before = one.fingerprint()
    monkeypatch.setattr("lfcal.work.unit.__version__", "99")
    assert one.fingerprint() != before


@pytest.mark.parametrize("name", ["plane 3", "../../etc/passwd", "z=3/ü", "a.b"])
def test_file_names_are_plain(name: str) -> None:
    found = file_name(Unit(name, "a:b", {}), "0123")
    assert Path(found).name == found
    assert found.endswith(".0123.h5")
    assert found.count(".") == 2


def test_a_unit_travels_as_a_small_record() -> None:
    job = Job(3, unit("plane 3", text="a"), "/somewhere/out")
    assert len(pickle.dumps(job)) < 1000
    assert pickle.loads(pickle.dumps(job)) == job


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_a_camera_travels_small(name: str) -> None:
    camera = preset(name)
    said = pickle.dumps(camera)
    assert len(said) < 10_000
    assert pickle.loads(said) == camera


class Tool:
    def __init__(self, name: str) -> None:
        self.name = name


def makers() -> tuple[ProcessCache[Tool], list[str], Callable[[str], Tool]]:
    told: list[str] = []

    def make(name: str) -> Tool:
        told.append(f"make {name}")
        return Tool(name)

    return ProcessCache(lambda tool: told.append(f"close {tool.name}")), told, make


def test_one_at_a_time() -> None:
    held, told, make = makers()
    first = held.get("a", lambda: make("a"))
    assert held.get("a", lambda: make("a")) is first
    assert held.get("b", lambda: make("b")).name == "b"
    assert told == ["make a", "close a", "make b"]


def test_what_is_lent_is_not_closed_and_goes_back() -> None:
    held, told, make = makers()
    mine = Tool("mine")
    with held.using("a", mine):
        assert held.get("a", lambda: make("a")) is mine
    assert held.get("a", lambda: make("a")) is not mine
    with held.using("a", mine):
        held.get("b", lambda: make("b"))
    assert held.get("b", lambda: make("b")).name == "b"
    assert told == ["make a", "close a", "make b"]


def test_a_stamp_tells_files_from_what_they_were(tmp_path: Path) -> None:
    one, two = tmp_path / "a", tmp_path / "b"
    one.write_text("x")
    two.write_text("y")
    before = stamp_of([str(one), str(two)])
    assert stamp_of([str(one), str(two)]) == before
    assert stamp_of([str(one)]) != before
    two.write_text("yy")
    assert stamp_of([str(one), str(two)]) != before
