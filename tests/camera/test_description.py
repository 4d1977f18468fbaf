from __future__ import annotations

import copy
import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfcal.base.errors import FileFormatError, InputError
from lfcal.camera import PRESETS, BrownDistortion, Camera, MainLens, Marks, Microscope, ScanPlan, Sensor, preset
from tests.camera.strategies import cameras

QUICK = settings(derandomize=True, deadline=None, max_examples=20)


@given(cameras)
@QUICK
def test_json_gives_the_camera_back(camera: Camera) -> None:
    assert Camera.from_json(camera.to_json()) == camera


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_presets_are_sound(name: str) -> None:
    camera = preset(name)
    assert camera.name == name and Camera.from_json(camera.to_json()) == camera
    for v in (-4.0, -1.5, 1.5, 4.0) if camera.has_lattice else ():
        assert camera.virtual_depth(camera.depth_of(v)) == pytest.approx(v, rel=1e-9)


def test_preset_cells() -> None:
    assert preset("r29").period_px == pytest.approx((31.7 * math.sqrt(3), 95.1))
    assert tuple(map(round, preset("r29").period_px)) == (55, 95)
    assert preset("lfm_20x05").period_px == pytest.approx((15.0, 15.0))
    assert preset("lfm_60x12").pitch_px == pytest.approx(15.385, abs=1e-3)
    assert tuple(map(round, preset("bench").period_px)) == (19, 33)


def test_the_photographic_preset_is_that_of_the_paper() -> None:
    camera = preset("r29")
    assert isinstance(camera.optics, MainLens)
    assert camera.optics.image_distance_um == pytest.approx(250e3)
    assert camera.optics.magnification == pytest.approx(0.25)
    assert camera.optics.working_f_number == pytest.approx(5.0)
    assert camera.sensor.shape == (4384, 6576)
    assert [t.focus_depth(camera.lattice.gap_um) for t in camera.lattice.types] == pytest.approx([2, 3, 5])


def test_farther_objects_have_images_in_front_of_the_array() -> None:
    for camera in filter(lambda one: one.has_lattice, map(preset, PRESETS)):
        assert camera.image_shift_um(10.0) < 0 < camera.image_shift_um(-10.0)
        assert camera.image_shift_um(0.0) == pytest.approx(0.0, abs=1e-6)


def test_pixels_and_micrometres_are_inverse_and_centred() -> None:
    camera = preset("bench")
    points = np.array([[0.0, 0.0], [55.0, -11.0]])
    pixels = camera.pixels(points)
    assert pixels.tolist() == [[159.5, 159.5], [157.5, 169.5]]
    assert camera.sensor_um(pixels) == pytest.approx(points)


def test_depths_no_lens_can_see_are_refused() -> None:
    camera = preset("r29")
    with pytest.raises(InputError, match="front focal plane"):
        camera.step_um(-900e3)
    with pytest.raises(InputError, match="virtual depth"):
        camera.depth_of(-60.0)


LEAVES = st.one_of(
    st.none(), st.booleans(), st.integers(-5, 5), st.floats(), st.text(max_size=3), st.lists(st.integers(), max_size=2)
)


def entries(node: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the paths of all entries of nested JSON."""
    found = [path] if path else []
    items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, value in items:
        found += entries(value, (*path, key))
    return found


WHOLE: Any = json.loads(preset("r29").to_json())


@given(st.sampled_from(entries(WHOLE)), LEAVES)
@settings(derandomize=True, deadline=None, max_examples=300)
def test_a_spoilt_entry_is_one_clear_error_or_a_sound_camera(path: tuple[Any, ...], leaf: Any) -> None:
    data = copy.deepcopy(WHOLE)
    node = data
    for key in path[:-1]:
        node = node[key]
    node[path[-1]] = leaf
    try:
        camera = Camera.from_dict(data)
    except InputError as error:
        assert "\n" not in str(error)
    else:
        assert Camera.from_json(camera.to_json()) == camera


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", "null", '{"format": "lfcal-camera"}', '{"format": "lfcal-camera", "version": 2}', "[" * 100_000],
)
def test_other_text_is_refused(text: str) -> None:
    with pytest.raises(InputError):
        Camera.from_json(text)


def test_unknown_and_missing_entries_are_named() -> None:
    data = copy.deepcopy(WHOLE)
    data["lattice"]["colour"] = 1
    with pytest.raises(InputError, match="colour"):
        Camera.from_dict(data)
    data = copy.deepcopy(WHOLE)
    del data["sensor"]
    with pytest.raises(InputError, match="sensor"):
        Camera.from_dict(data)
    # of several the same one each time
    data["lattice"] |= {f"colour {letter}": 1 for letter in "qwertyuiopasdfghjkl"}
    data["sensor"] = WHOLE["sensor"]
    with pytest.raises(InputError, match="colour a"):
        Camera.from_dict(data)


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        (MainLens, {"focal_length_um": -1.0}),
        (MainLens, {"working_distance_um": 1e5}),
        (MainLens, {"blades": 2}),
        (MainLens, {"blades": 9.5}),
        (MainLens, {"blade_curvature": 1.1}),
        (Microscope, {"numerical_aperture": 1.5}),
        (Microscope, {"medium_index": 0.9}),
        (Sensor, {"shape": (0, 5)}),
        (Sensor, {"shape": (5,)}),
        (Sensor, {"shape": 5}),
        (Sensor, {"shape": (5.5, 3)}),
        (Sensor, {"bit_depth": 17}),
        (Sensor, {"cfa": "GRB"}),
        (Sensor, {"cfa": "GRBX"}),
        (Sensor, {"black_level": 5000.0}),
        (BrownDistortion, {"coefficients": (), "centre_px": (0.0, 0.0)}),
        (BrownDistortion, {"coefficients": (math.nan,), "centre_px": (0.0, 0.0)}),
        (BrownDistortion, {"coefficients": (0.1,), "centre_px": (0.0,)}),
    ],
)
def test_bad_values_are_refused(kind: Any, values: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="expected"):
        kind(**values)


def test_an_unknown_preset_names_the_known() -> None:
    with pytest.raises(InputError, match="lfm_20x05"):
        preset("r30")


def _entries(data: dict[str, Any], where: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the path of every entry of a description."""
    found: list[tuple[Any, ...]] = []
    for key, value in data.items() if isinstance(data, dict) else enumerate(data):
        if isinstance(data, dict):
            found.append((*where, key))
        if isinstance(value, dict | list):
            found += _entries(value, (*where, key))
    return found


PLAN = ScanPlan.for_camera(preset("bench"), virtual_depths=(3.0, 4.0), cutout=21).to_dict()
PLAN = json.loads(json.dumps(PLAN))


def _at(path: tuple[Any, ...]) -> tuple[dict[str, Any], Any]:
    """Return a copy of the plan's description, and in it the object that holds ``path``."""
    whole = json.loads(json.dumps(PLAN))
    inner = whole
    for key in path[:-1]:
        inner = inner[key]
    return whole, inner


@pytest.mark.parametrize("path", _entries(PLAN), ids=lambda p: ".".join(map(str, p)))
def test_every_entry_must_be_there(path: tuple[Any, ...]) -> None:
    """A default that nobody chose would make another camera."""
    whole, inner = _at(path)
    del inner[path[-1]]
    with pytest.raises(FileFormatError) as caught:
        ScanPlan.from_dict(whole)
    assert path[-1] in ("format", "version", "type", "optics", "camera") or f"{path[-1]!r}, got nothing" in str(
        caught.value
    )


@pytest.mark.parametrize("path", _entries(PLAN), ids=lambda p: ".".join(map(str, p)))
def test_every_entry_is_of_its_type(path: tuple[Any, ...]) -> None:
    """What is accepted can be used; all else is one line."""
    for value in (True, "x", [], {}, [[]], -1e300, 1e300, 2**63 - 1, -1, None):
        whole, inner = _at(path)
        inner[path[-1]] = value
        try:
            plan = ScanPlan.from_dict(whole)
        except InputError as error:
            assert len(str(error)) < 500, value
        else:
            assert ScanPlan.from_json(plan.to_json()) == plan, value


def test_a_microscope_is_seen_from_infinity() -> None:
    camera = next(camera for camera in map(preset, PRESETS) if isinstance(camera.optics, Microscope))
    assert camera.optics.image_distance_um == math.inf
    assert camera.lattice_scale == 1.0 and camera.magnification == camera.optics.magnification


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


@pytest.mark.parametrize("version", [0, 4, "1", True, None])
def test_other_versions_are_refused(version: Any) -> None:
    with pytest.raises(InputError, match="version"):
        Camera.from_dict({**preset("bench").to_dict(), "version": version})


def test_version_2_without_its_entries_is_refused() -> None:
    data = preset("bench").to_dict()
    del data["marks"]
    with pytest.raises(InputError, match="marks"):
        Camera.from_dict(data)
