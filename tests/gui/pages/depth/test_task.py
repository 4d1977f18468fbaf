"""A depth map as a task: the page, its command and its Python write the same bits."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile

from lfcal.base import InputError, drain
from lfcal.lattice import save_depth, save_points
from lfcal.records import rows
from lfcal.tasks import Depth, command_of
from lfcal_gui.models import ProjectState, check_of
from lfcal_gui.pages.depth.model import FIELDS, HELD, DepthSettings, camera_of, task_of
from lfcal_gui.pages.depth.step import step
from tests.cli import conftest
from tests.cli.conftest import Run
from tests.gui.pages.depth.test_page import OFFSET, SHAPE, make_camera
from tests.lattice.plenoptic_scenes import draw, plane

Lfcal = Callable[..., Run]
lfcal = conftest.lfcal


@pytest.fixture(autouse=True)
def frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Write a frame, and what may be given with it, into the current folder."""
    monkeypatch.chdir(tmp_path)
    drawn = draw(SHAPE, 22.0, plane(3.0), rotation=0.02, noise=0.01, offset=OFFSET)
    frame = np.clip(np.rint(drawn.frame), 0, 65535).astype(np.uint16)
    tifffile.imwrite("frame.tif", frame + np.uint16(50))
    tifffile.imwrite("dark.tif", np.full(SHAPE, 50, np.uint16))
    tifffile.imwrite("white.tif", np.rint(drawn.white + 50).astype(np.uint16))
    mask = np.zeros(SHAPE, bool)
    mask[40:60] = True
    np.save("mask.npy", mask)


CHOSEN = {
    "by the camera": DepthSettings(options=(("dark", "dark.tif"), ("origin", "0,0"), ("slopes", (1.5, 9.0)))),
    "by a white image": DepthSettings(
        use_camera=False,
        options=(("dark", "dark.tif"), ("mask", "mask.npy"), ("method", "micro-images"), ("white", "white.tif")),
    ),
    "of a mosaic": DepthSettings(options=(("cfa", "GRBG"), ("channel", "G"))),
}


def project_of(settings: DepthSettings) -> ProjectState:
    project = ProjectState(light_field="frame.tif", camera=make_camera())
    return replace(project, settings=settings.into(project))


@pytest.mark.parametrize("case", CHOSEN)
def test_all_routes_write_the_same_files(lfcal: Lfcal, case: str) -> None:
    settings = CHOSEN[case]
    assert DepthSettings.from_dict(settings.to_dict()) == settings
    project = project_of(settings)
    task = task_of(settings, project, "frame.tif", "command.ply")
    found = drain(task.iter_measured(camera_of(settings, project))).found
    save_depth(Path("window.tif"), found)
    save_points(Path("window.ply"), found)
    copied = step(project, "command.ply")
    assert copied.arguments == tuple(shlex.split(command_of(task))[1:])
    for name, text in copied.files:
        Path(name).write_text(text, encoding="utf-8")
    assert lfcal(*copied.arguments).code == 0
    exec(copied.script().replace("command.", "script."), {})
    for name in ("command", "script"):
        for suffix in (".tif", ".ply"):
            assert Path(name + suffix).read_bytes() == Path(f"window{suffix}").read_bytes(), name + suffix


def test_every_field_is_in_the_form_and_refused_as_by_the_command() -> None:
    names = {row.name for row in rows(Depth)}
    assert {one.key for one in FIELDS} - {"use_camera", "use_h"} | HELD == names
    assert all(one.label and one.tip for one in FIELDS)
    settings = DepthSettings()
    for key, value in (("slopes", "a"), ("method", "stereo"), ("origin", "1")):
        assert settings.why_not(key, value), key
    assert "MIN,MAX" in check_of(Depth)("slopes", "a,b")
    changed = settings.changed("white", "white.tif").changed("slopes", "1.5,9")
    assert changed.option_values == {"white": Path("white.tif"), "slopes": (1.5, 9.0)}
    assert changed.changed("white", "").option_values == {"slopes": (1.5, 9.0)}


def test_h_and_camera_are_those_of_the_project() -> None:
    project = replace(project_of(DepthSettings()), psf="H.h5")
    assert task_of(DepthSettings(), project, "frame.tif").psf is None
    task = task_of(DepthSettings(use_h=True), project, "frame.tif")
    assert task.psf == Path("H.h5") and task.camera
    alone = task_of(DepthSettings(use_camera=False, use_h=True), project, "frame.tif")
    assert alone.psf == Path("H.h5") and not alone.camera
    with pytest.raises(InputError, match="expected a camera, a white image or a lattice file"):
        task_of(DepthSettings(), ProjectState(), "frame.tif")
