from __future__ import annotations

import math
from typing import Any

import pytest

from gui.pages.camera import model as camera_form
from gui.pages.plan import model as plan_form
from lfcal.camera import PRESETS, Camera, MainLens, Microscope, preset


@pytest.mark.parametrize("name", PRESETS)
def test_every_field_of_every_camera_goes_both_ways(name: str) -> None:
    camera = preset(name)
    values = camera_form.values_of(camera)
    for key, value in values.items():
        again, error = camera_form.apply_change(camera, key, value)
        assert not error and isinstance(again, Camera)
        got = camera_form.values_of(again)
        for other, expected in values.items():
            if isinstance(expected, float):
                assert got[other] == pytest.approx(expected, rel=1e-8)
            elif isinstance(expected, tuple):
                assert got[other] == pytest.approx(expected, rel=1e-7)
            else:
                assert got[other] == expected


CHANGES: tuple[tuple[str, Any, Any], ...] = (
    ("optics.f_number", 8.0, lambda c: c.optics.f_number == 8.0),
    ("optics.blades", 5, lambda c: c.optics.blades == 5),
    ("optics.kind", "Microscope", lambda c: isinstance(c.optics, Microscope)),
    ("lattice.pitch_um", 70.0, lambda c: c.lattice.pitch_um == 70.0),
    ("lattice.offset_y", -4.0, lambda c: c.lattice.offset_um == (0.0, -4.0)),
    ("lattice.focus", (3.0,), lambda c: len(c.lattice.types) == 1),
    ("lattice.focus", (math.inf,), lambda c: c.lattice.types[0].focal_length_um == c.lattice.gap_um),
    ("lattice.kind", "square", lambda c: len(c.lattice.types) == 1 and c.lattice.kind == "square"),
    ("sensor.rows", 100, lambda c: c.sensor.shape == (100, 320)),
    ("sensor.cfa", "GRBG", lambda c: c.sensor.cfa == "GRBG"),
    ("camera.wavelength_um", 0.6, lambda c: c.wavelength_um == 0.6),
)


@pytest.mark.parametrize(("key", "value", "holds"), CHANGES)
def test_changes(key: str, value: Any, holds: Any) -> None:
    camera, error = camera_form.apply_change(preset("bench"), key, value)
    assert not error and camera is not None and holds(camera)


def test_types_keep_what_they_have_in_focus_when_the_gap_changes() -> None:
    camera, _ = camera_form.apply_change(preset("bench"), "lattice.gap_um", 300.0)
    assert camera is not None
    assert camera_form.values_of(camera)["lattice.focus"] == pytest.approx((2, 3, 5))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("optics.f_number", 0.0),
        ("optics.f_number", -1.0),
        ("optics.blades", 2),
        ("optics.working_distance_um", 1.0),
        ("lattice.pitch_um", math.nan),
        ("lattice.focus", ()),
        ("lattice.focus", (2.0, 3.0)),
        ("lattice.focus", (1.0,)),
        ("sensor.rows", 0),
        ("sensor.bit_depth", 99),
        ("sensor.cfa", "XY"),
        ("camera.wavelength_um", 0.0),
    ],
)
def test_refusals_are_one_line(key: str, value: Any) -> None:
    camera, error = camera_form.apply_change(preset("bench"), key, value)
    assert camera is None and error and "\n" not in error


@pytest.mark.parametrize("name", PRESETS)
def test_plan_fields_go_both_ways(name: str) -> None:
    plan = plan_form.default_plan(preset(name))
    for key, value in plan_form.values_of(plan).items():
        again, error = plan_form.apply_change(plan, key, value)
        assert not error, (key, error)
        assert again is not None and again.shape == plan.shape


def test_plan_changes() -> None:
    plan = plan_form.default_plan(preset("bench"))
    changed, _ = plan_form.apply_change(plan, "virtual_depths", (2.0, 3.0))
    assert changed is not None and changed.virtual_depths == pytest.approx((2, 3))
    changed, _ = plan_form.apply_change(plan, "right", "-y")
    assert changed is not None
    assert (changed.stage.right, changed.stage.down, changed.stage.away) == ("-y", "+x", "+z")
    for key, value in (("cutout_rows", 10), ("virtual_depths", ()), ("exposure_s", -1.0), ("anchor_row", 1e6)):
        nothing, error = plan_form.apply_change(plan, key, value)
        assert nothing is None and "\n" not in error and error


def test_region_drawing_and_forecast() -> None:
    plan = plan_form.default_plan(preset("bench"))
    drawing = plan_form.region_drawing(plan)
    assert drawing.size == (19, 33) and len(drawing.path) == 19 * 33
    assert tuple(drawing.path[0]) == plan.anchor
    assert set(drawing.types) == {0, 1, 2}
    rows = dict(plan_form.forecast_rows(plan))
    assert rows["Positions"] == str(plan.n_positions) and rows["H, float32"].endswith("B")
    assert isinstance(plan.camera.optics, MainLens)
