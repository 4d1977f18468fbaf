"""What follows from a camera: derived values, what rests on assumed ones, doubtful values, and how values are shown."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace
from typing import Any

import pytest

from lfcal.base import InputError
from lfcal.camera import (
    PRESETS,
    QUANTITIES,
    BrownDistortion,
    Camera,
    Derived,
    Marks,
    Microscope,
    derived_of,
    doubts,
    preset,
    quantities_of,
    value_at,
)


def table(name: str, **marks: str) -> dict[str, Derived]:
    camera = replace(preset(name), marks=Marks.of({k.replace("__", "."): v for k, v in marks.items()}))
    return {item.label.strip(): item for item in derived_of(camera)}


def test_figures_of_a_lens() -> None:
    found = table("r29")
    assert found["period (x × y)"].value == pytest.approx((54.906, 95.1), abs=1e-3)
    assert found["magnification |M|"].value == pytest.approx(0.25 * (1 + 871.75 / 250e3))
    assert found["step for one pixel"].value == pytest.approx(5.5e6 / (250e3 + 871.75))
    assert found["lens to lenslets"].text == "250 mm"
    optics, lattice = preset("r29").optics, preset("r29").lattice
    lenslets = lattice.gap_um / lattice.pitch_um
    assert found["working f-number"].value == pytest.approx(optics.working_f_number)
    assert found["f-number of the lenslets"].value == pytest.approx(lenslets)
    assert found["micro-image diameter / lenslet pitch"].value == pytest.approx(lenslets / optics.working_f_number)
    assert found["type 1: in focus at v"].value == pytest.approx(3)
    assert not any(item.assumed for item in found.values())


def test_figures_of_a_microscope_and_what_rests_on_assumed_values() -> None:
    found = table("lfm_20x05", lattice__gap_um="assumed")
    assert found["step for one pixel"].value == pytest.approx(125 / 15 / 20)
    assert found["depth of field of the objective"].value == pytest.approx(0.525 / 0.25)
    assert found["step for one pixel"].assumed == (), "a telecentric image does not move with the gap"
    found = table("r29", sensor__pixel_um="assumed", sensor__shape="assumed", lattice__pitch_um="derived")
    assert found["step for one pixel"].assumed == ("sensor.pixel_um",)
    assert found["field of view (x × y)"].assumed == ("sensor.pixel_um", "sensor.shape")
    assert found["micro-image pitch"].assumed == (), "pitch over pixel is what the maker's file states"


def changed(camera: Camera, path: str) -> Camera | None:
    """Return the camera with the value at ``path`` changed by 0.1 %; None if it is no such number."""
    group, _, name = path.rpartition(".")
    part = getattr(camera, group) if group else camera
    value = getattr(part, name)
    if not isinstance(value, float) or not math.isfinite(value) or value == 0:
        return None
    for factor in (0.999, 1.001):
        with suppress(InputError):  # at a bound, only one direction is allowed
            other = replace(part, **{name: value * factor})
            return replace(camera, **{group: other}) if group else other
    return None


@pytest.mark.parametrize("name", ["r29", "lfm_20x05", "bench"])
def test_no_derived_value_is_better_known_than_its_inputs(name: str) -> None:
    camera, seen = preset(name), 0
    for path in (one.path for one in quantities_of(camera)):
        other = changed(camera, path)
        if other is None:
            continue
        marked = derived_of(replace(camera, marks=Marks.of({path: "assumed"})))
        for before, after, row in zip(derived_of(camera), derived_of(other), marked, strict=True):
            # the ratio of pitch to pixel is stated, so lengths in pixels do not depend on the pixel's size
            if before.value != after.value and (path, before.unit) != ("sensor.pixel_um", "px"):
                assert row.assumed == (path,), (before.label, path)
                seen += 1
    assert seen > 10


def bench_with(part: str, **values: Any) -> Camera:
    camera = preset("bench")
    return replace(camera, **{part: replace(getattr(camera, part), **values)})


DOUBTFUL = [
    ({"sensor": {"pixel_um": 0.0055}}, "did you mean 5.5 µm (mm for µm)"),
    ({"sensor": {"pixel_um": 5500.0}}, "did you mean 5.5 µm (nm for µm)"),
    ({"optics": {"focal_length_um": 50.0}}, "did you mean 50000 µm"),
    ({"optics": {"focal_length_um": 0.05, "working_distance_um": 0.3}}, "did you mean 50000 µm (m for µm)"),
    ({"lattice": {"gap_um": 0.29}}, "did you mean 290 µm"),
    ({"optics": {"f_number": 0.1}}, "unusual"),
    ({"lattice": {"pitch_um": 11.0, "clear_um": None}}, "too small"),
    ({"lattice": {"gap_um": 1500.0}}, "overlap"),
    *(({"lattice": {"offset_um": at}}, "outside the 320 x 320 px sensor") for at in ((888.8, 0.0), (0.0, -888.8))),
]


def test_doubtful_values_are_questioned_and_those_of_real_cameras_are_not() -> None:
    for change, expected in DOUBTFUL:
        ((part, values),) = change.items()
        found = doubts(bench_with(part, **values))
        assert any(expected in line for line in found) and all("\n" not in line for line in found), (change, found)
    far = replace(preset("bench"), distortion=BrownDistortion((1e-3,), (3186.0, 2651.0)))
    assert any("centre of the manufacturer's distortion" in line for line in doubts(far))
    edge = 160 * 5.5
    for camera in (*map(preset, PRESETS), bench_with("lattice", offset_um=(edge, -edge))):
        assert doubts(camera) == ()


def test_lengths_that_no_optics_have_are_refused() -> None:
    """Products of such lengths were infinite or zero, and their quotients ended the program."""
    for part, name, value in (
        ("optics", "focal_length_um", 1e-320),
        ("optics", "working_distance_um", 1e308),
        ("lattice", "pitch_um", 1.7e308),
        ("lattice", "gap_um", 1e16),
        ("sensor", "pixel_um", 1e-320),
    ):
        with pytest.raises(InputError, match=r"µm\): expected a number .*≤ 1e\+15, got 1"):
            bench_with(part, **{name: value})
    camera = replace(preset("lfm_20x05"), optics=Microscope(numerical_aperture=1e-320))
    for question in (doubts, derived_of):
        with pytest.raises(InputError, match="values of a real camera"):
            question(camera)


CLEAR = [
    ("square", None, "squares without gaps"),
    ("square", 150.0, "150 µm, round"),
    ("square", 180.0, "180 µm, round, cut off where the next lenslet begins"),
    ("square", 212.1, "212.1 µm, without gaps"),
    ("hexagonal", None, "round, as wide as the pitch"),
    ("hexagonal", 150.0, "150 µm, round"),
    ("hexagonal", 173.2, "173.2 µm, without gaps"),
]


def test_a_clear_diameter_is_shown_with_what_it_means() -> None:
    camera = preset("lfm_20x05")
    for kind, clear, words in CLEAR:
        lattice = replace(camera.lattice, kind=kind, pitch_um=150.0, row_pitch_um=None, clear_um=clear)
        other = replace(camera, lattice=lattice)
        quantity = next(one for one in quantities_of(other) if one.path == "lattice.clear_um")
        assert quantity.text(value_at(other, "lattice.clear_um")) == words
    quantity = next(one for one in QUANTITIES if one.path == "lattice.clear_um")
    assert "on the sensor" in quantity.label
    assert quantity.text(None) == "square: squares without gaps; hexagonal: round, as wide as the pitch"
