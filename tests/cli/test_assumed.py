"""Assumed values are listed at the import; later commands name those on which their results depend."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile

from lfcal.camera import Marks, preset, quantities_of
from tests.cli.conftest import Run

LIGHT = ("sensor.read_noise_e", "sensor.full_well_e", "wavelength_um")


def camera_file(folder: Path, *paths: str) -> Path:
    path = folder / "camera.json"
    path.write_text(replace(preset("bench"), marks=Marks.of(dict.fromkeys(paths, "assumed"))).to_json())
    return path


def commands(folder: Path, camera: Path) -> tuple[tuple[object, ...], ...]:
    """Return commands whose results do not depend on light and noise."""
    plan, image = folder / "plan.json", folder / "white.tif"
    tifffile.imwrite(image, np.zeros(preset("bench").sensor.shape, np.uint16))
    return (
        ("plan", camera, "--virtual-depths", 3, "-o", plan),
        ("acquire", plan, "--out", folder / "session", "--dry-run"),
        ("camera", "check", camera, image),
        ("white", image, "--camera", camera, "-o", folder / "out"),
        ("views", image, "--camera", camera, "-o", folder / "views"),
    )


def test_values_of_light_are_not_repeated_where_the_result_does_not_need_them(
    lfcal: Callable[..., Run], tmp_path: Path
) -> None:
    camera = camera_file(tmp_path, *LIGHT)
    shown = lfcal("camera", "show", camera)
    assert shown.code == 0 and "3 values of light and noise" in shown.out + shown.err
    for words in commands(tmp_path, camera):
        assert "assumed" not in lfcal(*words).err, words


@pytest.mark.parametrize("k", range(5))
def test_values_of_the_geometry_are_repeated_alone(lfcal: Callable[..., Run], tmp_path: Path, k: int) -> None:
    camera = camera_file(tmp_path, "lattice.gap_um", *LIGHT)
    words = commands(tmp_path, camera)
    if k == 1:
        lfcal(*words[0])
    said = lfcal(*words[k]).err
    assert said.count("gap between lenslets and sensor") == 1 and "light and noise" not in said


def test_simulations_name_the_values_of_light(lfcal: Callable[..., Run], tmp_path: Path) -> None:
    said = lfcal("simulate", camera_file(tmp_path, *LIGHT), "--virtual-depths", 3, "--plan-only").err
    assert "3 values of light and noise" in said


def test_centres_of_lenslets_repeat_the_values_they_depend_on(lfcal: Callable[..., Run], tmp_path: Path) -> None:
    camera, image = preset("flfm_20x05"), tmp_path / "white.tif"
    path = tmp_path / "camera.json"
    marks = Marks.of({one.path: "assumed" for one in quantities_of(camera)})
    path.write_text(replace(camera, marks=marks).to_json())
    tifffile.imwrite(image, np.zeros(camera.sensor.shape, np.uint16))
    said = lfcal("white", image, "--camera", path).err
    for label in ("optical axis on the sensor", "pixel pitch"):
        assert said.count(label) == 1
    for label in ("magnification", "focal length", "gap", "centres of the lenslets", "light and noise"):
        assert label not in said
    # the comparison with a lattice is not for this camera: what is advised can be done
    assert "camera check" not in said
    refused = lfcal("camera", "check", path, image)
    assert refused.code == 2 and f"lfcal white {image.name} --camera {path.name}" in refused.err
    assert f"lfcal white WHITE --camera {path.name}" in lfcal("plan", path, "--depths", 0).err
