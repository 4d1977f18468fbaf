"""Descriptions of cameras and plans: files, presets, marks, values that are refused, and drafts."""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings

from lfcal.base import FileFormatError, InputError
from lfcal.camera import (
    PRESETS,
    BrownDistortion,
    Camera,
    Draft,
    MainLens,
    Marks,
    Microscope,
    ScanPlan,
    Sensor,
    StageAxes,
    preset,
)
from lfcal.camera.draft import RANGES
from tests.camera.strategies import cameras

QUICK = settings(derandomize=True, deadline=None, max_examples=20)


@pytest.mark.long
@given(cameras)
@QUICK
def test_json_gives_the_camera_back(camera: Camera) -> None:
    assert Camera.from_json(camera.to_json()) == camera


def test_presets_are_sound() -> None:
    for name in PRESETS:
        camera = preset(name)
        assert camera.name == name and Camera.from_json(camera.to_json()) == camera
        if camera.has_lattice:
            for v in (-4.0, -1.5, 1.5, 4.0):
                assert camera.virtual_depth(camera.depth_of(v)) == pytest.approx(v, rel=1e-9)
            # farther objects have images in front of the array
            assert camera.image_shift_um(10.0) < 0 < camera.image_shift_um(-10.0)
            assert camera.image_shift_um(0.0) == pytest.approx(0.0, abs=1e-6)
        if isinstance(camera.optics, Microscope):
            assert camera.optics.image_distance_um == math.inf
    with pytest.raises(InputError, match="lfm_20x05"):
        preset("r30")


def test_presets_are_the_cameras_of_the_papers() -> None:
    camera = preset("r29")
    assert camera.period_px == pytest.approx((31.7 * math.sqrt(3), 95.1))
    assert isinstance(camera.optics, MainLens)
    assert camera.optics.image_distance_um == pytest.approx(250e3)
    assert camera.optics.magnification == pytest.approx(0.25) and camera.optics.working_f_number == pytest.approx(5.0)
    assert camera.sensor.shape == (4384, 6576)
    assert [t.focus_depth(camera.lattice.gap_um) for t in camera.lattice.types] == pytest.approx([2, 3, 5])
    scope = preset("lfm_20x05")
    assert scope.period_px == pytest.approx((15.0, 15.0)) and scope.lattice_scale == 1.0
    assert scope.magnification == scope.optics.magnification
    assert preset("lfm_60x12").pitch_px == pytest.approx(15.385, abs=1e-3)
    assert tuple(map(round, preset("bench").period_px)) == (19, 33)


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


PLAN = json.loads(ScanPlan.for_camera(preset("bench"), virtual_depths=(3.0, 4.0), cutout=21).to_json())


def entries(node: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the paths of all entries of nested objects."""
    for key, value in node.items() if isinstance(node, dict) else enumerate(node):
        if isinstance(node, dict):
            yield (*path, key)
        if isinstance(value, dict | list):
            yield from entries(value, (*path, key))


def opened(path: tuple[Any, ...]) -> tuple[dict[str, Any], Any]:
    """Return a copy of the plan's description, and in it the object that contains ``path``."""
    whole = inner = copy.deepcopy(PLAN)
    for key in path[:-1]:
        inner = inner[key]
    return whole, inner


def test_every_entry_must_be_there() -> None:
    """A default that the user did not choose would be another camera."""
    for path in entries(PLAN):
        whole, inner = opened(path)
        del inner[path[-1]]
        with pytest.raises(FileFormatError) as caught:
            ScanPlan.from_dict(whole)
        named = f"{path[-1]!r}, got nothing" in str(caught.value)
        assert named or path[-1] in ("format", "version", "type", "optics", "camera"), path


VALUES = (True, "", "x", [], {}, [[]], [1], 0, -1, 3, 0.5, math.nan, math.inf, -1e300, 1e300, 2**63 - 1, None)


def test_every_entry_is_of_its_type() -> None:
    """A value that is accepted can be used; every other one is an error of one line."""
    for path in entries(PLAN):
        for value in VALUES:
            whole, inner = opened(path)
            inner[path[-1]] = value
            try:
                plan = ScanPlan.from_dict(whole)
            except InputError as error:
                assert len(str(error)) < 500 and "\n" not in str(error), (path, value)
            else:
                assert ScanPlan.from_json(plan.to_json()) == plan, (path, value)


def test_other_text_is_refused() -> None:
    heads = ('{"format": "lfcal-camera"}', '{"format": "lfcal-camera", "version": 2}', '{"format": "lfcal-plan"}')
    for text in ("", "{", "[]", "[1]", "null", "[" * 100_000, *heads):
        for kind in (Camera, ScanPlan):
            with pytest.raises(InputError):
                kind.from_json(text)


def test_unknown_and_missing_entries_are_named() -> None:
    whole = json.loads(preset("r29").to_json())
    sensor = whole.pop("sensor")
    with pytest.raises(InputError, match="sensor"):
        Camera.from_dict(whole)
    # of several the same one each time
    colours = {f"colour {letter}": 1 for letter in "qwertyuiopasdfghjkl"}
    with pytest.raises(InputError, match="colour a"):
        Camera.from_dict(whole | {"sensor": sensor, "lattice": whole["lattice"] | colours})


BAD: list[tuple[Any, dict[str, Any]]] = [
    (MainLens, {"focal_length_um": -1.0}),
    (MainLens, {"working_distance_um": 1e5}),
    *((MainLens, {"blades": blades}) for blades in (2, 9.5)),
    (MainLens, {"blade_curvature": 1.1}),
    (Microscope, {"numerical_aperture": 1.5}),
    (Microscope, {"medium_index": 0.9}),
    *((Sensor, {"shape": shape}) for shape in ((0, 5), (5,), 5, (5.5, 3))),
    (Sensor, {"bit_depth": 17}),
    *((Sensor, {"cfa": cfa}) for cfa in ("GRB", "GRBX")),
    (Sensor, {"black_level": 5000.0}),
    (Sensor, {"saturation": 4096.0}),
    (Sensor, {"saturation": 60.0, "black_level": 64.0}),
    *((Sensor, {name: -0.1}) for name in ("dsnu_e", "linearity")),
    *((BrownDistortion, {"coefficients": k, "centre_px": (0.0, 0.0)}) for k in ((), (math.nan,))),
    (BrownDistortion, {"coefficients": (0.1,), "centre_px": (0.0,)}),
    *((StageAxes, {"right": axis}) for axis in ("x", "+w", 1, "+y")),
    (StageAxes, {"away": "-x"}),
    *((StageAxes, {"origin_um": origin}) for origin in ((0.0, 0.0), (0.0, 0.0, math.nan), "abc")),
]


def test_bad_values_are_refused() -> None:
    for kind, values in BAD:
        with pytest.raises(InputError, match="expected"):
            kind(**values)
    with pytest.raises(InputError, match=r"0\.00052; give it in µm \(--wavelength takes nm\)"):
        replace(preset("lfm_20x05"), wavelength_um=0.00052)


@pytest.mark.hard_case
@pytest.mark.parametrize("huge", [1e300, -1e300, 10**400, float("inf")])
def test_numbers_that_overflow_are_refused(huge: float) -> None:
    """Of a damaged description: a read noise of 1e300 electrons was an infinite sample value."""
    for change in ("read_noise_e", "full_well_e", "dark_current_e_s", "dsnu_e", "linearity"):
        with pytest.raises(InputError, match="expected a number"):
            Sensor((4, 6), 5.5, **{change: huge})
    with pytest.raises(InputError, match="anchor"):
        ScanPlan.for_camera(preset("bench"), virtual_depths=[4.0], anchor=(huge, 10.0))


def test_what_was_measured_is_kept_with_the_camera() -> None:
    camera = preset("bench")
    sensor = replace(camera.sensor, saturation=3900.0, dsnu_e=2.5, linearity=0.004)
    known = replace(camera, sensor=sensor)
    assert Camera.from_json(known.to_json()) == known
    assert (sensor.saturated_from, camera.sensor.saturated_from) == (3900.0, 4095.0)


MARKED = Marks.of({"sensor.pixel_um": "assumed", "lattice.pitch_um": "stated", "lattice.gap_um": "derived"})


def test_marks_survive_json_and_do_not_distinguish_cameras() -> None:
    plain = preset("bench")
    marked = replace(plain, marks=MARKED)
    back = Camera.from_json(marked.to_json())
    assert back.marks == MARKED and back == plain and hash(back) == hash(plain)
    assert marked.to_dict()["marks"]["lattice.gap_um"] == "derived"
    assert MARKED["optics.f_number"] == "stated", "values without a mark"
    assert MARKED.paths("assumed") == ("sensor.pixel_um",)
    assert MARKED.marked(["sensor.pixel_um"], "measured").paths("assumed") == ()
    # they are sorted, and the last one of a path counts
    one = Marks((("b", "stated"), ("a", "stated"), ("a", "assumed")))
    assert one.entries == (("a", "assumed"), ("b", "stated"))
    assert one == Marks.of({"a": "assumed", "b": "stated"}) == Marks.of({"b": "stated", "a": "assumed"})


def test_other_marks_are_refused() -> None:
    for marks in (None, 3, [["a", "stated"]], {"sensor.pixel_um": "guessed"}, {"a": ["stated"]}):
        with pytest.raises(InputError, match="mark"):
            Camera.from_dict(preset("bench").to_dict() | {"marks": marks})
    with pytest.raises(InputError, match="path of a mark"):
        Marks(((3, "stated"),))


def test_descriptions_of_version_1_are_read_and_of_other_versions_refused() -> None:
    data = json.loads(preset("bench").to_json())
    del data["marks"]
    with pytest.raises(InputError, match="marks"):
        Camera.from_dict(data)
    for name in ("saturation", "dsnu_e", "linearity"):
        del data["sensor"][name]
    old = Camera.from_dict(data | {"version": 1})
    assert old == preset("bench") and old.marks == Marks()
    assert old.sensor.saturation is None and old.sensor.dsnu_e is None
    for version in (0, 4, "1", True, None):
        with pytest.raises(InputError, match="version"):
            Camera.from_dict(preset("bench").to_dict() | {"version": version})


def test_axes_of_the_stage_are_mapped_with_their_signs() -> None:
    stage = StageAxes(right="-y", down="+z", away="-x", origin_um=(1.0, 2.0, 3.0))
    points = np.array([[10.0, 20.0, 30.0], [0.0, 0.0, 0.0]])
    moved = stage.to_stage(points)
    assert moved.tolist() == [[1.0 - 30.0, 2.0 - 10.0, 3.0 + 20.0], [1.0, 2.0, 3.0]]
    assert stage.to_object(moved) == pytest.approx(points)


def test_a_draft_assumes_what_is_missing_and_keeps_the_first_value() -> None:
    draft = Draft("MainLens", {"sensor.pixel_um": 3.45})
    draft.put("sensor.pixel_um", 5.5, "derived")
    draft.put("lattice.pitch_um", 100.0, "derived")
    camera = draft.camera("c")
    assert camera.sensor.pixel_um == 3.45 and camera.marks["sensor.pixel_um"] == "stated"
    assert camera.marks["lattice.pitch_um"] == "derived" and camera.marks["optics.f_number"] == "assumed"
    assert camera.optics == MainLens()
    # micro-images just touch
    assert camera.lattice.gap_um == pytest.approx(100.0 * camera.optics.working_f_number)
    draft.put("optics.f_number", 8.0)
    assert draft.camera("c").lattice.gap_um == pytest.approx(2 * camera.lattice.gap_um), "a draft may be continued"
    scope = Draft("Microscope", {"optics.magnification": 40.0}).camera("m")
    assert isinstance(scope.optics, Microscope) and scope.marks["lattice.types"] == "assumed"
    assert math.isinf(scope.lattice.types[0].focus_depth(scope.lattice.gap_um))


def test_types_of_a_draft_keep_their_focus_or_that_of_their_range() -> None:
    kept = Draft.of(preset("bench"), {"lattice.gap_um": 200.0}).camera("c")
    assert [kind.focus_depth(200.0) for kind in kept.lattice.types] == pytest.approx([2, 3, 5])
    draft = Draft("MainLens", {"lattice.kind": "hexagonal"})
    draft.put(RANGES, ((2.0, 4.0), (3.0, 6.0), (4.0, 12.0)), "stated")
    camera = draft.camera("c")
    depths = [kind.focus_depth(camera.lattice.gap_um) for kind in camera.lattice.types]
    assert depths == pytest.approx([8 / 3, 4.0, 6.0]), "both ends are blurred alike"


def test_values_of_other_cameras_are_refused() -> None:
    for kind, path in (("Microscope", "optics.f_number"), ("MainLens", "optics.magnification"), ("MainLens", "a.size")):
        with pytest.raises(InputError, match=path):
            Draft(kind, {path: 1.0})
