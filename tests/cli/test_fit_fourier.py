"""``lfcal fit`` of a Fourier light-field microscope: the recorded z stack of a bead, by every route."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.camera import Camera, Microscope, PupilLenslets, ScanPlan, Sensor
from lfcal.psf import open_psf
from lfcal.records import CorrectionRecipe
from lfcal.tasks import FitFrames, command_of
from tests.cli.conftest import Run
from tests.fit.commands import undrawn
from tests.psf.test_joining import contents
from tests.tasks.routes import go_every_route

Lfcal = Callable[..., Run]
CENTRES = ((-210.0, 20.0), (190.0, -60.0))
DEPTHS = (-40.0, 0.0, 40.0)
UNITS = ("--executor", "threads")


def camera_of(centres: tuple[tuple[float, float], ...] = CENTRES) -> Camera:
    lenslets = PupilLenslets(centres, 30e3, 4e3, (4e3,), 200.0)
    return Camera("two", Microscope(20.0, 0.4, 1.0), lenslets, Sensor((131, 151), 5.5, 12, 20e3, 5.0), 0.55)


@pytest.fixture
def place(lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the current folder: the frames of three planes, and a plan whose lenslets are 6 µm off."""
    monkeypatch.chdir(tmp_path)
    undrawn(monkeypatch)
    plan = ScanPlan.for_camera(camera_of(), depths_um=DEPTHS, cutout=(121, 131))
    (tmp_path / "true.json").write_text(plan.to_json())
    run = lfcal("simulate", "true.json", "--frames", "stack", "--tolerance", 0.02)
    assert run.code == 0, run.err
    wrong = ScanPlan.for_camera(camera_of(((-216.0, 24.0), (186.0, -56.0))), depths_um=DEPTHS, cutout=(121, 131))
    (tmp_path / "plan.json").write_text(wrong.to_json())
    return tmp_path


def task_in(place: Path, out: str, unknowns: str, **more: Any) -> FitFrames:
    dark = CorrectionRecipe(dark=str(place / "stack" / "dark"))
    given = {"plan": place / "plan.json", "corrections": dark, "orientation": "as-is", **more}
    return FitFrames(sources=(place / "stack" / "frames",), out=place / out, unknowns=unknowns, **given)


def found(folder: Path) -> dict[str, Any]:
    numbers: dict[str, Any] = json.loads((folder / "fit.json").read_text())
    del numbers["fitted"], numbers["task"]
    return numbers


def test_command_python_and_job_file_find_the_same_lenslets(lfcal: Lfcal, place: Path) -> None:
    first, *others = go_every_route(lfcal, task_in(place, "fit", "lens_centres,travel_tilt"), place / "fit")
    assert len(others) == 3
    with open_psf(first / "H.h5") as H:
        values = np.asarray(H)
        assert H.camera == Camera.from_json((first / "camera.json").read_text())
    for one in others:
        assert found(one) == found(first)
        assert (one / "camera.json").read_bytes() == (first / "camera.json").read_bytes()
        with open_psf(one / "H.h5") as H:
            np.testing.assert_array_equal(np.asarray(H), values)
    true = {f"lenslet_{k}_{axis}_um": c for k, one in enumerate(CENTRES) for axis, c in zip("xy", one, strict=True)}
    true |= {"travel_rows_rad": 0.0, "travel_columns_rad": 0.0}
    parameters = found(first)["parameters"]
    assert {one["name"] for one in parameters} == true.keys()
    for one in parameters:
        assert abs(one["value"] - true[one["name"]]) < 4.5 * one["sigma"], one


@pytest.mark.long
def test_unknowns_are_chosen_and_h_is_computed_in_units(lfcal: Lfcal, place: Path) -> None:
    for task, more in ((task_in(place, "whole", "auto"), ()), (task_in(place, "parts", "auto"), UNITS)):
        run = lfcal(*shlex.split(command_of(task))[1:], *more)
        assert run.code == 0, run.err
    assert found(place / "whole") == found(place / "parts")
    assert contents(place / "whole" / "H.h5") == contents(place / "parts" / "H.h5")
    assert "lens_centres" in found(place / "whole")["groups"]
