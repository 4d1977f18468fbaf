"""What is stated and what is assumed travels with the camera, and older descriptions are still read."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any

import pytest

from lfcal.base.errors import InputError
from lfcal.camera import Camera, Marks, preset

MARKED = Marks.of({"sensor.pixel_um": "assumed", "lattice.pitch_um": "stated", "lattice.gap_um": "derived"})


def test_marks_survive_json_and_do_not_tell_cameras_apart() -> None:
    plain = preset("bench")
    marked = replace(plain, marks=MARKED)
    back = Camera.from_json(marked.to_json())
    assert back.marks == MARKED
    assert back == plain
    assert hash(back) == hash(plain)
    assert marked.to_dict()["marks"]["lattice.gap_um"] == "derived"


def test_values_without_a_mark_are_stated() -> None:
    assert MARKED["optics.f_number"] == "stated"
    assert MARKED.paths("assumed") == ("sensor.pixel_um",)
    assert MARKED.marked(["sensor.pixel_um"], "measured").paths("assumed") == ()


def test_marks_are_sorted_and_the_last_of_a_path_counts() -> None:
    one = Marks((("b", "stated"), ("a", "stated"), ("a", "assumed")))
    assert one.entries == (("a", "assumed"), ("b", "stated"))
    assert one == Marks.of({"a": "assumed", "b": "stated"}) == Marks.of({"b": "stated", "a": "assumed"})


def test_descriptions_of_version_1_are_read() -> None:
    data: dict[str, Any] = preset("r29").to_dict()
    old = {key: value for key, value in data.items() if key != "marks"} | {"version": 1}
    assert Camera.from_dict(old) == preset("r29")
    assert Camera.from_dict(old).marks == Marks()


@pytest.mark.parametrize("marks", [None, 3, [["a", "stated"]], {"sensor.pixel_um": "guessed"}, {"a": ["stated"]}])
def test_other_marks_are_refused(marks: Any) -> None:
    data = copy.deepcopy(preset("bench").to_dict())
    data["marks"] = marks
    with pytest.raises(InputError, match="mark"):
        Camera.from_dict(data)


def test_paths_of_marks_are_text() -> None:
    with pytest.raises(InputError, match="path of a mark"):
        Marks(((3, "stated"),))  # type: ignore[arg-type]


@pytest.mark.parametrize("version", [0, 3, "1", True, None])
def test_other_versions_are_refused(version: Any) -> None:
    with pytest.raises(InputError, match="version"):
        Camera.from_dict({**preset("bench").to_dict(), "version": version})


def test_version_2_without_its_entries_is_refused() -> None:
    data = preset("bench").to_dict()
    del data["marks"]
    with pytest.raises(InputError, match="marks"):
        Camera.from_dict(data)
