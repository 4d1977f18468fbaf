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


def test_values_of_the_sensor_are_named_alone_if_only_the_noise_counts(
    lfcal: Callable[..., Run], tmp_path: Path
) -> None:
    camera = camera_file(tmp_path, "lattice.gap_um", "optics.f_number", "sensor.prnu", *LIGHT)
    frame, matrix = tmp_path / "frame.tif", tmp_path / "H.npy"
    tifffile.imwrite(frame, np.full((1000, 1000), 100, np.uint16))
    np.save(matrix, np.random.default_rng(0).uniform(size=(1, 3, 3, 9, 9)))
    out = ("-o", tmp_path / "out.tif", "--force")
    commands: tuple[tuple[tuple[object, ...], int], ...] = (
        (("merits", "Bayer", "--camera", camera), 2),
        (("merits", "Bayer", "--camera", camera, "--uncorrected"), 3),
        (("compare", "Bayer", "CYMG", "--camera", camera, "-o", tmp_path / "gain.png", "--force"), 2),
        (("coding", matrix, "--points", 2, "--sensor", camera), 2),
        (("recover", frame, "--modulator", "nd:1,0.25/0.25,0.0625", "--camera", camera, *out), 2),
        (("views", frame, "--camera", "bench", "--sensor", camera, "--modulator", "Bayer", *out), 2),
    )
    for words, count in commands:
        done = lfcal("multiplex", *words)
        assert f"assumed: {count} values of light and noise" in done.err, (words, done.err)
        assert "gap" not in done.err and "f-number" not in done.err
    (tmp_path / "flats").mkdir()
    said = lfcal("camera", "sensor", tmp_path / "flats", tmp_path / "flats", "--camera", camera).err
    assert "assumed" not in said, "the command measures these values"
