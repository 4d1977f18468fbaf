"""Units: fingerprints tell results of other inputs and settings apart, and a record is all that travels."""

from __future__ import annotations

import os
import pickle
from dataclasses import replace
from pathlib import Path

import pytest

from lfcal.base.errors import StorageError
from lfcal.camera import PRESETS, preset
from lfcal.work.unit import Job, Unit, file_name
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
