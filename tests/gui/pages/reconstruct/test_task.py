"""Reconstruct as a task: the page, its command and its Python give the same volume."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile

from lfcal.base import InputError, drain
from lfcal.psf import PSFMatrix, save
from lfcal.records import rows
from lfcal.tasks import Reconstruct, command_of
from lfcal_gui.models import OpeningSettings, ProjectState
from lfcal_gui.pages.reconstruct.model import BARS, FIELDS, ROWS, ReconstructSettings, bars_task_of, task_of
from lfcal_gui.pages.reconstruct.model_solving import Solving
from lfcal_gui.pages.reconstruct.step import bars_task, step
from tests.cli import conftest
from tests.cli.conftest import Run
from tests.psf.test_mat_import import save_v73
from tests.reconstruct.oracles import lenslet_psf

Lfcal = Callable[..., Run]
lfcal = conftest.lfcal


@pytest.fixture
def frame(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> np.ndarray:
    """Write H and a light field into the current folder."""
    monkeypatch.chdir(tmp_path)
    save(PSFMatrix(lenslet_psf(2, 5, 15).astype(np.float32), anchor=(1.0, 2.0), depths=(-5.0, 5.0)), "H.h5")
    noise = np.random.default_rng(0)
    save(PSFMatrix(lenslet_psf(2, 5, 15).astype(np.float32) * 0.9, anchor=(1.0, 17.0), depths=(-5.0, 5.0)), "other.h5")
    image = noise.poisson(50.0, (30, 31)).astype(np.uint16)
    tifffile.imwrite("frame.tif", image)
    tifffile.imwrite("dark.tif", noise.poisson(9.0, image.shape).astype(np.uint16))
    tifffile.imwrite("white.tif", noise.poisson(900.0, image.shape).astype(np.uint16))
    return image


CHOSEN = {
    "a penalty with dark and white": ReconstructSettings(
        *("rl-tv", 4),
        **{"strength": 0.01, "background": 2.0, "anchor": (3.1234567, 1.5), "margin": 4},
        **{"dark": "dark.tif", "white": "white.tif", "device": "cpu"},
    ),
    "by held-out pixels": ReconstructSettings("osem", stop="left-out", goal="measure", subsets=2, threshold=0.01),
    "until it changes little": ReconstructSettings("rl", 30, tolerance=0.05, memory=1.0),
    "of two regions": ReconstructSettings("rl", 4, regions="other.h5", white="white.tif"),
    "by noise": ReconstructSettings("isra", stop="discrepancy", gain=1.5, saturation=80.0, double=True, margin=0),
}


@pytest.mark.parametrize("case", CHOSEN)
def test_all_routes_give_the_same_volume(lfcal: Lfcal, frame: np.ndarray, case: str) -> None:
    settings = CHOSEN[case]
    solving = Solving("H.h5", frame, settings)
    drain(solving.work())
    shown = np.asarray(solving.placed(settings).volume, np.float32)
    solving.close()
    project = ProjectState(psf="H.h5", light_field="frame.tif")
    copied = step(replace(project, settings=settings.into(project)), "command.npy")
    task = task_of(settings, "H.h5", "frame.tif", "command.npy")
    assert copied.arguments == tuple(shlex.split(command_of(task))[1:])
    assert lfcal(*copied.arguments).code == 0
    exec(copied.script().replace("command.npy", "script.npy"), {})
    for name in ("command", "script"):
        np.testing.assert_array_equal(np.load(f"{name}.npy"), shown, err_msg=name)


HELD = {
    *("psf", "frames", "out", "name", "iterations", "resample", "device", "method", "threshold", "within"),
    *("margin", "voxel", "anchor", "mat_order"),
}
"""Fields that the page shows by entries of its own, and the order that the place H asks for."""


def test_every_field_is_in_the_form_or_has_an_entry_of_its_own() -> None:
    shown = {one.key for one in FIELDS}
    assert {row.name for row in rows(Reconstruct)} - HELD == shown & ROWS.keys() - HELD - {*BARS}
    for key in shown & ROWS.keys() - HELD:
        assert next(one for one in FIELDS if one.key == key).tip.startswith(ROWS[key].tip)


def test_a_mat_file_is_read_in_its_order(lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    noise = np.random.default_rng(5)
    save_v73(tmp_path / "H.mat", H=noise.random((5, 5, 3, 3, 2)))
    image = noise.poisson(50.0, (20, 21)).astype(np.uint16)
    tifffile.imwrite("frame.tif", image)
    settings, volumes = ReconstructSettings("rl", 3, device="cpu"), []
    for order in ("rows-first", "columns-first"):
        solving = Solving("H.mat", image, settings, mat_order=order)
        drain(solving.work())
        volumes.append(solving.volume)
        assert solving.fits("H.mat", settings, order) and not solving.fits("H.mat", settings)
        solving.close()
        project = ProjectState(psf="H.mat", light_field="frame.tif")
        project = replace(project, settings=settings.into(project))
        project = replace(project, settings=OpeningSettings().with_order("H.mat", order).into(project))
        copied = step(project, f"{order}.npy").arguments
        assert f"--mat-order={order}" in copied and lfcal(*copied).code == 0
        np.testing.assert_array_equal(np.load(f"{order}.npy"), solving.volume)
    assert np.abs(volumes[0] - volumes[1]).max() > 0.1


def test_a_task_has_the_fields_that_apply() -> None:
    assert ReconstructSettings(regions="all", as_is=True).other_regions == ("all",)
    with pytest.raises(InputError, match="lattice: expected no file for an H of several regions"):
        ReconstructSettings(regions="all", lattice="lattice.json")
    with pytest.raises(InputError, match="lattice: expected no file, because “As is” is ticked"):
        ReconstructSettings(lattice="lattice.json", as_is=True)
    task = task_of(ReconstructSettings("isra", read_noise=3.0, subsets=2, strength=0.1), "H.h5", "f.tif", "v.tif")
    assert isinstance(task, Reconstruct) and command_of(task) == (
        "lfcal reconstruct H.h5 f.tif --solver=isra --out=v.tif"
    )


def test_error_bars_are_a_task_with_their_settings(frame: np.ndarray) -> None:
    """Settings of the default solver and of the frame reach the task; another solver does not."""
    chosen = ReconstructSettings(
        *("osem", 4), background=2.0, labels="labels.tif", crop=True, fit="fit", replicates=5, margin=3, dark="dark.tif"
    )
    task = bars_task_of(chosen, "H.h5", "frame.tif", "v.tif")
    assert (task.solver.name, task.solver.iterations, task.solver.background) == ("rl-nesterov", 60, 2.0)
    words = " ".join(shlex.split(command_of(task))).replace("=", " ")
    for some in (
        "--bars",
        "--labels labels.tif",
        "--fit fit",
        "--crop",
        "--replicates 5",
        "--margin 3",
        "--dark dark.tif",
    ):
        assert some in words, words
    with pytest.raises(InputError, match="replicates"):
        ReconstructSettings(replicates=2)
    state = chosen.changed("region", (0, 0, 9, 9)).into(ProjectState(psf="H.h5", light_field="frame.tif"))
    with pytest.raises(InputError, match="whole light field"):
        bars_task(replace(ProjectState(psf="H.h5", light_field="frame.tif"), settings=state), "v.tif")
