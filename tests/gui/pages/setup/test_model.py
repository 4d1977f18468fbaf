from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from lfcal.camera import PRESETS, Camera, LatticeDistortion, Marks, Microscope, ScanPlan, preset
from lfcal_gui.models.project import ProjectState
from lfcal_gui.pages.setup import model as camera_form


@pytest.mark.parametrize("name", PRESETS)
def test_every_field_of_every_camera_goes_both_ways(name: str) -> None:
    camera = preset(name)
    values = camera_form.values_of(camera)
    for key, value in values.items():
        if key == "lattice.distortion":  # words
            continue
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
    ("lattice.shear_rad", 0.01, lambda c: c.lattice.shear_rad == 0.01),
    ("sensor.saturation", 900.0, lambda c: c.sensor.saturation == 900.0),
    ("sensor.dsnu_e", 1.5, lambda c: c.sensor.dsnu_e == 1.5),
    ("sensor.linearity", None, lambda c: c.sensor.linearity is None),
    ("sensor.cfa", "GRBG", lambda c: c.sensor.cfa == "GRBG"),
    ("camera.wavelength_um", 0.6, lambda c: c.wavelength_um == 0.6),
)


@pytest.mark.parametrize(("key", "value", "holds"), CHANGES)
def test_changes(key: str, value: Any, holds: Any) -> None:
    camera, error = camera_form.apply_change(preset("bench"), key, value)
    assert not error and camera is not None and holds(camera)


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
    assert isinstance(kept, ScanPlan) and kept.camera == noisy and kept.anchor == state.plan.anchor  # type: ignore[union-attr]
    for sensor in (replace(camera.sensor, pixel_um=3.0), replace(camera.sensor, shape=(100, 100))):
        assert camera_form.state_with(state, replace(camera, sensor=sensor))["plan"] is None
    assert camera_form.state_with(state, replace(camera, wavelength_um=0.4))["plan"] is None


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
        ("lattice.focus", (1e40,)),
        ("sensor.rows", 0),
        ("sensor.bit_depth", 99),
        ("sensor.cfa", "XY"),
        ("sensor.saturation", 1e6),
        ("sensor.dsnu_e", -1.0),
        ("camera.wavelength_um", 0.0),
    ],
)
def test_refusals_are_one_line(key: str, value: Any) -> None:
    camera, error = camera_form.apply_change(preset("bench"), key, value)
    assert camera is None and error and "\n" not in error


@pytest.mark.parametrize("name", PRESETS)
def test_a_description_begins_with_assumed_values_that_have_names(name: str) -> None:
    """One value was called by its path."""
    paths = camera_form.all_assumed(preset(name)).marks.paths("assumed")
    assert paths and not any("_" in camera_form.name_at(path) or "." in camera_form.name_at(path) for path in paths)


def test_another_kind_of_optics_is_assumed() -> None:
    camera, _ = camera_form.apply_change(preset("bench"), "optics.kind", "Microscope")
    assert camera is not None and "optics.magnification" in camera.marks.paths("assumed")
    again, _ = camera_form.apply_change(camera, "optics.magnification", 40.0)
    assert again is not None and again.marks["optics.magnification"] == "stated"
    assert camera_form.mark_of(again, "optics.tube_length_um") == "assumed"
    assert camera_form.mark_of(again, "optics.kind") == "stated"
    back, _ = camera_form.apply_change(again, "optics.kind", "MainLens")
    assert back is not None and not any(path == "optics.magnification" for path, _ in back.marks)


def test_values_in_the_wrong_unit_are_questioned() -> None:
    camera, error = camera_form.apply_change(preset("bench"), "sensor.pixel_um", 0.0055)
    assert camera is not None and not error
    assert "did you mean 5.5 µm" in camera_form.facts(camera)
    assert "⚠" not in camera_form.facts(preset("bench"))


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
