"""What pages do, as commands and as Python: each is read by the command line, and the quick ones are run."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot
from typer.main import get_command
from typer.testing import CliRunner

from gui.models.page import PAGES
from gui.models.project import ProjectState
from gui.models.step import Step, step_of
from gui.pages.acquire.model import AcquireSettings
from gui.pages.fit.model import FitSettings
from gui.pages.frames.model import FrameSettings
from gui.pages.multiplex.model import MultiplexSettings
from gui.pages.quality.model import QualitySettings
from gui.pages.reconstruct.model import ReconstructSettings
from gui.pages.simulate.model import SimulateSettings
from gui.palette import Palette
from gui.window import MainWindow
from lfcal.camera import ScanPlan
from lfcal.cli.app import build_app
from lfcal.errors import InputError
from lfcal.psf import PSFMatrix, export, open_psf
from tests.acquire.rigs import small_plan

PLAN = small_plan((3, 4), 2, settle_s=0.0)
SPECS = {spec.key: spec for spec in PAGES}
CHOSEN = {
    "acquire": AcquireSettings(device_options=(("optics", "pattern"),), darks=2, reference_every=0),
    "frames": FrameSettings(use_background=True, interpolation="linear", orientation="as-is"),
    "fit": FitSettings(camera="window", positions=9, auto=False, constant=2.0, slope=0.5),
    "quality": QualitySettings(seconds=0.0),
    "simulate": SimulateSettings(tolerance=0.2, overrides=(("coma", "off"),)),
    "reconstruct": ReconstructSettings(iterations=2, background=1.0, threshold=0.01, anchor=(10.0, 11.5)),
    "multiplex": MultiplexSettings(family="mask", mask="MURA", size=11),
}


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ProjectState:
    """Return a project whose files are where the commands are run."""
    monkeypatch.chdir(tmp_path)
    settings = {key: chosen.to_dict() for key, chosen in CHOSEN.items()}
    made = ProjectState(camera=PLAN.camera, plan=PLAN, settings=settings)
    return replace(made, psf="H.h5", light_field="frame.tif", frames="session", recording="session")


def parsed(arguments: tuple[str, ...]) -> dict[str, Any]:
    """Return the values of options as the command line reads them."""
    command: Any = get_command(build_app())
    words = list(arguments)
    while hasattr(command, "commands"):
        command = command.commands[words.pop(0)]
    context = command.make_context("lfcal", words)
    return dict(context.params)


def run(step: Step) -> str:
    """Write the files of a step and run its command; return what it prints."""
    for name, text in step.files:
        Path(name).write_text(text, encoding="utf-8")
    found = CliRunner().invoke(build_app(), list(step.arguments))
    assert found.exit_code == 0, (found.output, found.stderr, found.exception)
    return found.output


def do(step: Step) -> dict[str, Any]:
    """Run the script of a step; return its names."""
    names: dict[str, Any] = {}
    exec(compile(step.script(), "script", "exec"), names)
    return names


@pytest.mark.parametrize("key", SPECS)
def test_every_page_is_a_command_that_is_understood_and_a_script(key: str, project: ProjectState) -> None:
    step = step_of(SPECS[key], project)
    assert parsed(step.arguments)
    compile(step.script(), key, "exec")
    lines = step.shell().rstrip().splitlines()
    assert tuple(shlex.split(lines[-1])) == ("lfcal", *step.arguments)
    for name, text in step.files:
        assert f"cat > {name} <<'LFCAL_END'" in lines and text in step.shell()


def test_options_of_the_command_are_those_of_the_page(project: ProjectState) -> None:
    def of(key: str) -> dict[str, Any]:
        return parsed(step_of(SPECS[key], project).arguments)

    fit = of("fit")
    assert (fit["positions"], fit["noise"], fit["unknowns"]) == (9, "2.0,0.5", "geometry,focal_lengths,iris")
    frames = of("frames")
    assert (frames["background"], frames["interpolation"], frames["orientation"]) == ("border", "linear", "as-is")
    assert frames["dark"] == "" and not frames["defects"]
    solved = of("reconstruct")
    assert (solved["iterations"], solved["anchor"], solved["threshold"]) == ("2", "10.0,11.5", 0.01)
    assert solved["margin"] == "0", "the page has none"
    acquire = of("acquire")
    assert acquire["option"] == ["optics=pattern"] and acquire["darks"] == 2 and acquire["reference_every"] == 0


@pytest.mark.parametrize("key", ["acquire", "plan", "simulate", "frames", "psf", "quality", "fit", "reconstruct"])
def test_a_page_says_what_its_command_lacks(key: str) -> None:
    with pytest.raises(InputError, match="expected"):
        step_of(SPECS[key], ProjectState())


def test_a_page_without_a_command_says_so() -> None:
    own = replace(SPECS["psf"], title="Mine", package="gui.widgets")
    with pytest.raises(InputError, match="Mine: this page has no command"):
        step_of(own, ProjectState())


def test_camera_plan_and_multiplex_run(project: ProjectState) -> None:
    run(step_of(SPECS["camera"], project))
    assert do(step_of(SPECS["camera"], project))["camera"] == project.camera
    step = step_of(SPECS["plan"], project)
    run(step)
    made = ScanPlan.from_json(Path("plan.json").read_text(encoding="utf-8"))
    assert made.depths_um == PLAN.depths_um and (made.cutout, made.anchor) == (PLAN.cutout, PLAN.anchor)
    assert (made.stage, made.exposures, made.order) == (PLAN.stage, PLAN.exposures, PLAN.order)
    assert do(step)["plan"] == PLAN
    run(step_of(SPECS["multiplex"], project))
    do(step_of(SPECS["multiplex"], project))


def test_a_simulation_by_command_and_by_script_is_the_same(project: ProjectState) -> None:
    step = step_of(SPECS["simulate"], project)
    run(step)
    with open_psf("simulated.h5") as H:
        found = np.asarray(H)
    Path("simulated.h5").unlink()
    np.testing.assert_array_equal(np.asarray(do(step)["H"]), found)


def test_recording_assembly_and_export_run(project: ProjectState) -> None:
    do(step_of(SPECS["acquire"], project))
    # a background is measured on whole frames
    project = replace(project, settings={**project.settings, "frames": FrameSettings(orientation="as-is").to_dict()})
    do(step_of(SPECS["frames"], project))
    with open_psf("H.h5") as H:
        found = np.asarray(H)
    Path("H.h5").unlink()
    run(step_of(SPECS["frames"], project))
    with open_psf("H.h5") as H:
        np.testing.assert_array_equal(np.asarray(H), found)
    do(step_of(SPECS["psf"], project))
    assert Path("H.mat").is_file()


def test_a_reconstruction_runs(project: ProjectState) -> None:
    values = np.random.default_rng(0).random((1, 3, 4, 5, 5), np.float32)
    export(PSFMatrix(values, depths=(0.0,)), "H.h5")
    tifffile.imwrite("frame.tif", np.full((24, 25), 100, np.uint16))
    step = step_of(SPECS["reconstruct"], project)
    run(step)
    found = tifffile.imread("volume.tif")
    Path("volume.tif").unlink()
    do(step)
    np.testing.assert_allclose(tifffile.imread("volume.tif").squeeze(), found, rtol=1e-5)


def test_the_window_copies_what_a_page_does(window: MainWindow) -> None:
    clipboard = QApplication.clipboard()
    window.go("camera")
    window.copy_step()
    assert clipboard.text().endswith("lfcal camera show lfcal-camera.json\n")
    window.copy_step(python=True)
    assert "Camera.from_json" in clipboard.text()
    window.go("quality")
    window.copy_step()
    assert "H: expected one, got none" in window.log_view.toPlainText() and "Camera" in clipboard.text()


def test_the_palette_finds_menus_and_buttons_and_does_them(window: MainWindow, qtbot: QtBot) -> None:
    def opened() -> Palette:
        window.show_palette()
        return next(p for p in window.findChildren(Palette) if p.isVisible())

    window.go("plan")
    palette = opened()
    names = [entry.name for entry in palette.shown]
    assert "Edit: Copy page as command" in names and "Project: Save project" in names
    assert any(name.startswith("Default") or "plan" in name.lower() for name in names[:4])
    qtbot.keyClicks(palette.line, "view qual")
    assert [entry.name for entry in palette.shown] == ["View: Quality"]
    qtbot.keyClick(palette.line, Qt.Key.Key_Return)
    assert window.specs[window.rail.currentRow()].key == "quality"
    palette = opened()
    qtbot.keyClicks(palette.line, "view")
    qtbot.keyClick(palette.line, Qt.Key.Key_Down)
    assert palette.list.currentRow() == 1
    qtbot.keyClicks(palette.line, " no such thing")
    qtbot.keyClick(palette.line, Qt.Key.Key_Return)
    assert palette.isVisible() and palette.list.count() == 0
    palette.reject()
