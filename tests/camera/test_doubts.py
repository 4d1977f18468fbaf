"""Values that can hardly be meant are questioned; those of real cameras are not."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from lfcal.base.errors import InputError
from lfcal.camera import PRESETS, Camera, Microscope, derived_of, doubts, preset
from lfcal.camera.distortion import BrownDistortion


@pytest.mark.parametrize("name", PRESETS)
def test_cameras_that_are_meant(name: str) -> None:
    assert doubts(preset(name)) == ()


def changed(part: str, **values: Any) -> Camera:
    camera = preset("bench")
    return replace(camera, **{part: replace(getattr(camera, part), **values)})


@pytest.mark.parametrize(
    ("camera", "said"),
    [
        (changed("sensor", pixel_um=0.0055), "did you mean 5.5 µm (mm for µm)"),
        (changed("sensor", pixel_um=5500.0), "did you mean 5.5 µm (nm for µm)"),
        (changed("optics", focal_length_um=50.0), "did you mean 50000 µm"),
        (changed("optics", focal_length_um=0.05, working_distance_um=0.3), "did you mean 50000 µm (m for µm)"),
        (changed("lattice", gap_um=0.29), "did you mean 290 µm"),
        (changed("optics", f_number=0.1), "unusual"),
        (changed("lattice", pitch_um=11.0, clear_um=None), "too small"),
        (changed("lattice", offset_um=(1000.0, 0.0)), "outside the 320 x 320 px sensor"),
        (changed("lattice", gap_um=1500.0), "overlap"),
        (
            replace(preset("bench"), distortion=BrownDistortion((1e-3,), (3186.0, 2651.0))),
            "centre of the manufacturer's distortion",
        ),
    ],
)
def test_mistakes_are_questioned(camera: Camera, said: str) -> None:
    found = doubts(camera)
    assert any(said in line for line in found), found
    assert all("\n" not in line for line in found)


def test_an_offset_up_to_the_edge_is_on_the_sensor() -> None:
    edge = 160 * 5.5
    assert doubts(changed("lattice", offset_um=(edge, -edge))) == ()
    for beyond in ((1.01 * edge, 0.0), (0.0, -1.01 * edge)):
        assert any("outside the 320 x 320 px sensor" in line for line in doubts(changed("lattice", offset_um=beyond)))


@pytest.mark.parametrize(
    ("part", "value"),
    [
        ("optics", {"focal_length_um": 1e-320}),
        ("optics", {"working_distance_um": 1e308}),
        ("lattice", {"pitch_um": 1.7e308}),
        ("lattice", {"gap_um": 1e16}),
        ("sensor", {"pixel_um": 1e-320}),
    ],
)
def test_lengths_that_no_optics_have_are_refused(part: str, value: dict[str, float]) -> None:
    """Products of such lengths were infinite or zero, and their quotients ended the program."""
    with pytest.raises(InputError, match=r"µm\): expected a number .*≤ 1e\+15, got 1"):
        changed(part, **value)


def test_numbers_beyond_all_are_one_line() -> None:
    camera = replace(preset("lfm_20x05"), optics=Microscope(numerical_aperture=1e-320))
    for question in (doubts, derived_of):
        with pytest.raises(InputError, match="values of a real camera"):
            question(camera)
