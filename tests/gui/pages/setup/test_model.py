"""The camera and the scan plan as forms, without a window."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import Any

import pytest

from lfcal.camera import PRESETS, Camera, LatticeDistortion, MainLens, Marks, Microscope, ScanPlan, preset
from lfcal_gui.models import ProjectState
from lfcal_gui.pages.setup import model as camera_form
from lfcal_gui.pages.setup import model_scan as plan_form
from lfcal_gui.pages.setup.model_picture import ScanCosts
from lfcal_gui.pages.setup.model_target import PlanSettings

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
    ("lattice.shear_rad", 0.01, lambda c: c.lattice.shear_rad == 0.01),
    ("sensor.saturation", 900.0, lambda c: c.sensor.saturation == 900.0),
    ("sensor.dsnu_e", 1.5, lambda c: c.sensor.dsnu_e == 1.5),
    ("sensor.linearity", None, lambda c: c.sensor.linearity is None),
    ("sensor.cfa", "GRBG", lambda c: c.sensor.cfa == "GRBG"),
    ("camera.wavelength_um", 0.6, lambda c: c.wavelength_um == 0.6),
)


def test_changes() -> None:
    for key, value, holds in CHANGES:
        assert holds(changed(key, value)), key
    refocused = changed("lattice.gap_um", 300.0)
    assert camera_form.values_of(refocused)["lattice.focus"] == pytest.approx((2, 3, 5)), "what is in focus stays"
    tiny = camera_form.facts(changed("sensor.pixel_um", 0.0055))
    assert "did you mean 5.5 µm" in tiny and "⚠" not in camera_form.facts(preset("bench"))


def test_marks_of_another_kind_of_optics_and_of_a_description() -> None:
    camera = changed("optics.kind", "Microscope")
    assert "optics.magnification" in camera.marks.paths("assumed")
    again = changed("optics.magnification", 40.0, camera)
    assert again.marks["optics.magnification"] == "stated"
    assert camera_form.mark_of(again, "optics.tube_length_um") == "assumed"
    assert camera_form.mark_of(again, "optics.kind") == "stated"
    assert not any(path == "optics.magnification" for path, _ in changed("optics.kind", "MainLens", again).marks)
    for name in PRESETS:
        paths = camera_form.all_assumed(preset(name)).marks.paths("assumed")
        assert paths and not any(set("_.") & set(camera_form.name_at(path)) for path in paths), name


@pytest.mark.parametrize("name", PRESETS)
def test_every_field_of_every_camera_and_plan_goes_both_ways(name: str) -> None:
    camera = preset(name)
    values = camera_form.values_of(camera)
    for key, value in values.items():
        if key == "lattice.distortion":  # words
            continue
        got = camera_form.values_of(changed(key, value, camera))
        for other, expected in values.items():
            close = isinstance(expected, float | tuple)
            assert got[other] == (pytest.approx(expected, rel=1e-7) if close else expected), (key, other)
    plan = plan_form.default_plan(camera)
    for key, value in plan_form.values_of(plan).items():
        if key == "virtual_depths" and not camera.has_lattice:
            assert not value
            continue
        again, error = plan_form.apply_change(plan, key, value)
        assert not error and again is not None and again.shape == plan.shape, (key, error)
    assert "-0.000" not in str(rows_of(plan))


def test_a_bent_lattice_is_told_in_words_and_another_kind_starts_straight() -> None:
    bench = preset("bench")
    bend = LatticeDistortion("radial", (0.0, 0.0), 800.0, ((10.0,),))
    bent = replace(bench, lattice=replace(bench.lattice, shear_rad=0.002, distortion=bend))
    bent = replace(bent, marks=Marks.of({"lattice.distortion": "measured", "lattice.shear_rad": "measured"}))
    assert camera_form.values_of(bench)["lattice.distortion"] == "none"
    words = camera_form.values_of(bent)["lattice.distortion"]
    assert words == f"radial, {10 / bench.sensor.pixel_um:.2f} px"
    assert camera_form.mark_of(bent, "lattice.distortion") == "measured"
    square, error = camera_form.apply_change(bent, "lattice.kind", "square")
    assert not error and square is not None
    assert square.lattice.distortion is None and square.lattice.shear_rad == 0
    assert camera_form.mark_of(square, "lattice.distortion") == "stated"


def test_the_plan_stays_where_images_lie_as_they_did() -> None:
    camera = preset("bench")
    state = ProjectState(camera=camera, plan=ScanPlan.for_camera(camera, virtual_depths=(3.0,)))
    noisy = replace(camera, sensor=replace(camera.sensor, read_noise_e=3.0, bit_depth=10, saturation=900.0))
    kept = camera_form.state_with(state, noisy)["plan"]
    assert isinstance(kept, ScanPlan) and kept.camera == noisy and kept.anchor == state.plan.anchor
    for sensor in (replace(camera.sensor, pixel_um=3.0), replace(camera.sensor, shape=(100, 100))):
        assert camera_form.state_with(state, replace(camera, sensor=sensor))["plan"] is None
    assert camera_form.state_with(state, replace(camera, wavelength_um=0.4))["plan"] is None


REFUSED: dict[str, tuple[Any, ...]] = {
    **{"optics.f_number": (0.0, -1.0), "optics.blades": (2,), "optics.working_distance_um": (1.0,)},
    **{"lattice.pitch_um": (math.nan,), "lattice.focus": ((), (2.0, 3.0), (1.0,), (1e40,)), "sensor.rows": (0,)},
    **{"sensor.bit_depth": (99,), "sensor.cfa": ("XY",), "sensor.saturation": (1e6,), "sensor.dsnu_e": (-1.0,)},
    "camera.wavelength_um": (0.0,),
}


def test_refusals_are_one_line() -> None:
    for key, values in REFUSED.items():
        for value in values:
            camera, error = camera_form.apply_change(preset("bench"), key, value)
            assert camera is None and error and "\n" not in error, (key, value)


def changed(key: str, value: Any, camera: Camera | None = None) -> Camera:
    found, error = camera_form.apply_change(camera or preset("bench"), key, value)
    assert not error and found is not None
    return found


def test_the_plan_of_a_camera_described_otherwise_keeps_what_was_chosen_in_it() -> None:
    camera = preset("bench")
    plan = ScanPlan.for_camera(camera, virtual_depths=(3.0, 4.0), exposure_s=(0.01, 0.02), order="raster")
    state = ProjectState(camera=camera, plan=plan)
    slower = replace(camera, optics=replace(camera.optics, f_number=8.0))  # type: ignore[type-var]
    made = camera_form.state_with(state, slower, same=True)["plan"]
    suggested = ScanPlan.for_camera(slower, depths_um=plan.depths_um)
    assert isinstance(made, ScanPlan) and made.camera == slower
    assert (made.depths_um, made.exposure_s, made.order) == (plan.depths_um, (0.01, 0.02), "raster")
    assert (made.cutout, made.anchor) == (suggested.cutout, suggested.anchor) != (plan.cutout, plan.anchor)
    chosen = replace(plan, cutout=(41, 43), anchor=(100.0, 120.0))
    kept = camera_form.state_with(ProjectState(camera=camera, plan=chosen), slower, same=True)["plan"]
    assert isinstance(kept, ScanPlan) and (kept.cutout, kept.anchor) == ((41, 43), (100.0, 120.0))
    pixels = replace(camera, sensor=replace(camera.sensor, pixel_um=2 * camera.sensor.pixel_um))
    halved = camera_form.state_with(state, pixels, same=True)["plan"]
    assert isinstance(halved, ScanPlan) and halved.period != plan.period
    small = replace(camera, sensor=replace(camera.sensor, shape=(20, 20)))
    assert camera_form.state_with(state, small, same=True)["plan"] is None


def rows_of(plan: ScanPlan, **rates: float) -> list[tuple[str, str]]:
    return ScanCosts.of(plan, PlanSettings(**rates), None, None).rows()  # type: ignore[arg-type]


def test_plan_changes() -> None:
    plan = plan_form.default_plan(preset("bench"))
    deeper, _ = plan_form.apply_change(plan, "virtual_depths", "2, 3")
    assert deeper.virtual_depths == pytest.approx((2, 3))
    turned, _ = plan_form.apply_change(plan, "stage", "-y,+x,+z")
    assert (turned.stage.right, turned.stage.down, turned.stage.away) == ("-y", "+x", "+z")
    for key, value in (("cutout", "10"), ("virtual_depths", ""), ("exposure", "-1"), ("anchor", "1e6,0")):
        nothing, error = plan_form.apply_change(plan, key, value)
        assert nothing is None and "\n" not in error and error
    shown = [str(value) for value in plan_form.values_of(plan_form.default_plan(preset("lfm_20x05"))).values()]
    assert not [text for text in shown if re.search(r"-0(\.0)?([, ]|$)", text)], "no minus before a zero"


def test_scan_path_and_forecast() -> None:
    plan = plan_form.default_plan(preset("bench"))
    path = plan_form.scan_path(plan)
    assert len(path) == 19 * 33 and tuple(path[0]) == plan.anchor
    rows = dict(rows_of(plan))
    assert rows["Positions"] == f"{plan.n_positions:,}" and rows["H, float32"].endswith("B")
    assert "Time without readout" in rows and rows["  whole frames at"].endswith("B/s"), "what is not counted is stated"
    assert "  moving at 1 mm/s" in rows, "what is assumed is stated"
    rows = dict(rows_of(plan, speed=2000.0, frame_rate=10.0))
    assert {"Time", "  reading out", "  moving at 2 mm/s"} <= rows.keys()
    assert isinstance(plan.camera.optics, MainLens)
