"""A camera in the making: what comes first wins, what is missing is assumed and said to be."""

from __future__ import annotations

import math

import pytest

from lfcal.base.errors import InputError
from lfcal.camera import Draft, MainLens, Microscope, preset
from lfcal.camera.draft import RANGES


def test_the_first_value_wins_and_the_rest_is_assumed() -> None:
    draft = Draft("MainLens", {"sensor.pixel_um": 3.45})
    draft.put("sensor.pixel_um", 5.5, "derived")
    draft.put("lattice.pitch_um", 100.0, "derived")
    camera = draft.camera("c")
    assert camera.sensor.pixel_um == 3.45 and camera.marks["sensor.pixel_um"] == "stated"
    assert camera.marks["lattice.pitch_um"] == "derived" and camera.marks["optics.f_number"] == "assumed"
    assert camera.optics == MainLens()
    # micro-images just touch
    assert camera.lattice.gap_um == pytest.approx(100.0 * camera.optics.working_f_number)


def test_a_draft_can_go_on_after_a_camera_was_made_of_it() -> None:
    draft = Draft("MainLens")
    before = draft.camera("c").lattice.gap_um
    draft.put("optics.f_number", 8.0)
    assert draft.camera("c").lattice.gap_um == pytest.approx(2 * before)


def test_types_keep_their_focus_while_the_gap_is_assumed() -> None:
    draft = Draft.of(preset("bench"), {"lattice.gap_um": 200.0})
    camera = draft.camera("c")
    assert [kind.focus_depth(200.0) for kind in camera.lattice.types] == pytest.approx([2, 3, 5])


def test_a_microscope_is_assumed_focused_at_infinity() -> None:
    camera = Draft("Microscope", {"optics.magnification": 40.0}).camera("m")
    assert isinstance(camera.optics, Microscope) and math.isinf(
        camera.lattice.types[0].focus_depth(camera.lattice.gap_um)
    )
    assert camera.marks["lattice.types"] == "assumed"


@pytest.mark.parametrize(
    ("kind", "path"),
    [("Microscope", "optics.f_number"), ("MainLens", "optics.magnification"), ("MainLens", "sensor.size")],
)
def test_values_of_other_cameras_are_refused(kind: str, path: str) -> None:
    with pytest.raises(InputError, match=path):
        Draft(kind, {path: 1.0})


def test_a_range_of_depths_is_focused_where_both_ends_blur_alike() -> None:
    draft = Draft("MainLens", {"lattice.kind": "hexagonal"})
    draft.put(RANGES, ((2.0, 4.0), (3.0, 6.0), (4.0, 12.0)), "stated")
    camera = draft.camera("c")
    depths = [kind.focus_depth(camera.lattice.gap_um) for kind in camera.lattice.types]
    assert depths == pytest.approx([8 / 3, 4.0, 6.0])
