"""Pages as commands and as Python, the palette, and the history of a project as a script."""

from __future__ import annotations

import shlex
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from PySide6.QtCore import QEvent, Qt
from PySide6.QtWidgets import QApplication, QPushButton
from pytestqt.qtbot import QtBot
from typer.main import get_command
from typer.testing import CliRunner

from lfcal.base.errors import InputError
from lfcal.base.progress import drain
from lfcal.camera import Camera, preset
from lfcal.cli._app import build_app
from lfcal.frames.corrections.recipe import CorrectionRecipe
from lfcal.lattice import lattice_of
from lfcal.psf import PSFMatrix, export
from lfcal_gui.models.comparison import compare_step
from lfcal_gui.models.history import History, Taken
from lfcal_gui.models.page import PAGES
from lfcal_gui.models.project import ProjectState
from lfcal_gui.models.step import CommandStep, step_of
from lfcal_gui.pages.acquire.model import AcquireSettings
from lfcal_gui.pages.acquire.step import assembled
from lfcal_gui.pages.acquire.step import step as recording_step
from lfcal_gui.pages.frames.model import FrameSettings
from lfcal_gui.pages.h.model_checks import QualitySettings
from lfcal_gui.pages.h.model_fit import FitSettings
from lfcal_gui.pages.multiplex.model import MultiplexSettings
from lfcal_gui.pages.multiplex.model_scene import iter_reconstruct
from lfcal_gui.pages.reconstruct.export_model import ExportSettings
from lfcal_gui.pages.reconstruct.model import ReconstructSettings
from lfcal_gui.pages.simulate.model import SimulateSettings
from lfcal_gui.pages.watch.model import WatchSettings
from lfcal_gui.palette import Palette
from lfcal_gui.window import MainWindow
from tests.acquire.rigs import small_plan
from tests.gui.waiting import idle

PLAN = small_plan((3, 4), 2, settle_s=0.0)
SPECS = {spec.key: spec for spec in PAGES}
CHOSEN = {
    "acquire": AcquireSettings(device_options=(("optics", "pattern"),), darks=2, reference_every=0),
    "frames": FrameSettings(use_background=True, interpolation="linear", orientation="as-is"),
    "fit": FitSettings(camera="window", positions=9, auto=False, noise=(2.0, 0.5)),
    "quality": QualitySettings(seconds=0.0),
    "simulate": SimulateSettings(tolerance=0.2, overrides=(("coma", "off"),)),
    "reconstruct": ReconstructSettings(iterations=2, background=1.0, threshold=0.01, anchor=(10.0, 11.5), device="cpu"),
    "watch": WatchSettings(frames=("frame.tif",), options=(("mean", 3), ("noise", (64.0, 1.0)))),
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


def run(step: CommandStep) -> str:
    """Write the files of a step and run its command; return what it prints."""
    for name, text in step.files:
        Path(name).write_text(text, encoding="utf-8")
    found = CliRunner().invoke(build_app(), list(step.arguments))
    assert found.exit_code == 0, (found.output, found.stderr, found.exception)
    return found.output


def do(step: CommandStep) -> dict[str, Any]:
    """Run the script of a step; return its names."""
    names: dict[str, Any] = {}
    exec(compile(step.script(), "script", "exec"), names)
    return names


def test_every_page_is_a_command_that_is_understood_and_a_script(project: ProjectState) -> None:
    for key in (*SPECS, "h checks", "h fit"):
        page, _, part = key.partition(" ")
        step = step_of(SPECS[page], project, part=part)
        assert parsed(step.arguments), key
        compile(step.script(), key, "exec")
        lines = step.shell().rstrip().splitlines()
        assert tuple(shlex.split(lines[-1])) == ("lfcal", *step.arguments), key
        for name, text in step.files:
            assert f"cat > {name} <<'LFCAL_END'" in lines and text in step.shell()


def test_a_page_says_what_its_command_lacks() -> None:
    for key in ("acquire", "simulate", "frames", "h", "h checks", "h fit", "reconstruct", "depth", "watch"):
        page, _, part = key.partition(" ")
        with pytest.raises(InputError, match="expected"):
            step_of(SPECS[page], ProjectState(), part=part)
    own = replace(SPECS["h"], title="Mine", package="lfcal_gui.widgets")
    with pytest.raises(InputError, match="Mine: only possible with the buttons"):
        step_of(own, ProjectState())


def test_the_window_copies_what_a_page_does(window: MainWindow, project: ProjectState) -> None:
    clipboard = QApplication.clipboard()
    window.go("setup")
    window.scripts.copy_step()
    assert clipboard.text().endswith("lfcal camera show lfcal-camera.json\n")
    window.scripts.copy_step(python=True)
    assert "Camera.from_json" in clipboard.text()
    window.go("h", "checks")
    window.scripts.copy_step()
    assert "H: expected one, got none" in window.log_view.toPlainText() and "Camera" in clipboard.text()
    window.project.start(replace(project, psf="", light_field=""))
    window.context.history.add(window.context.taken("frames", "Assemble mine.h5", "/data/mine.h5"))
    window.go("frames")
    window.scripts.copy_step()
    assert "--out=/data/mine.h5" in clipboard.text(), "the name of the file that was written"


def test_the_palette_finds_and_triggers_menus_and_buttons(window: MainWindow, qtbot: QtBot) -> None:
    def opened() -> Palette:
        window.show_palette()
        return next(p for p in window.findChildren(Palette) if p.isVisible())

    window.go("setup")
    palette = opened()
    names = [entry.name for entry in palette.shown]
    assert "Edit: Copy page as command" in names and "Project: Save project" in names
    # buttons are named with their page, and a button without a text by what it does
    buttons = [name for name in names if name.startswith("Set up: ")]
    assert buttons == names[: len(buttons)] and all(any(c.isalpha() for c in name[8:]) for name in buttons)
    qtbot.keyClicks(palette.line, "record: compute")
    assert [entry.name for entry in palette.shown] == ["View: Record: Compute"]
    qtbot.keyClick(palette.line, Qt.Key.Key_Return)
    assert window.shown.spec.key == "simulate"
    window.go("setup")
    button = QPushButton("Stop the job of a moment ago", window.shown)
    button.show()
    palette = opened()
    qtbot.keyClicks(palette.line, "view")
    qtbot.keyClick(palette.line, Qt.Key.Key_Down)
    assert palette.list.currentRow() == 1
    qtbot.keyClicks(palette.line, " no such thing")
    qtbot.keyClick(palette.line, Qt.Key.Key_Return)
    assert palette.isVisible() and palette.list.count() == 0
    palette.line.clear()
    qtbot.keyClicks(palette.line, "moment ago")
    assert [entry.name for entry in palette.shown] == [f"Set up: {button.text()}"]
    button.deleteLater()
    QApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)
    qtbot.keyClick(palette.line, Qt.Key.Key_Return)
    assert palette.isVisible() and palette.list.count() == 0
    assert palette.windowTitle().endswith("is no longer available")
    palette.line.clear()
    assert palette.list.count() > 5
    palette.reject()


# -- history -----------------------------------------------------------------------------------------------
def test_the_history_of_a_project_is_a_script_that_runs(
    window: MainWindow, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Simulate, export and save through the window; its script makes the same files."""
    monkeypatch.chdir(tmp_path)
    window.scripts.save_history(str(tmp_path / "early.sh"))
    assert not (tmp_path / "early.sh").exists() and "nothing saved" in window.log_view.toPlainText()
    plan = replace(PLAN, period=(3, 4), resample=False)
    settings = {"simulate": SimulateSettings(tolerance=0.2, overrides=(("coma", "off"),)).to_dict()}
    window.project.start(ProjectState(camera=plan.camera, plan=plan, settings=settings))
    pages: dict[str, Any] = {key: window.page(key) for key in ("simulate", "reconstruct", "setup")}
    pages["setup"].save_plan(str(tmp_path / "my plan.json"))
    idle(window.jobs, qtbot)
    pages["simulate"].simulate("sim.h5")
    idle(window.jobs, qtbot)
    pages["reconstruct"].exporting.start("H.npy")
    pages["reconstruct"].exporting.start("T.mat", ExportSettings(no_ht=True, uncompressed=True))
    idle(window.jobs, qtbot)
    window.project.update("other", plan=None)  # the history keeps the plan of each step
    titles = [one.title for one in window.context.history.taken]
    assert titles == ["Save plan my plan.json", "Simulate sim.h5", "Export H.npy", "Export T.mat"]
    window.go("simulate")
    window.scripts.copy_history()
    shell = QApplication.clipboard().text()
    assert "lfcal export sim.h5 --out=T.mat --no-ht --uncompressed" in shell
    assert "set -e" in shell and "--out=sim.h5" in shell
    window.scripts.save_history(str(tmp_path / "again.py"))
    made = [tmp_path / name for name in ("sim.h5", "H.npy", "T.mat", "my plan.json")]
    before = np.load("H.npy")
    window.shut_down()
    for path in made:
        path.unlink()
    for step in (one.step for one in window.context.history.taken):
        assert step is not None
        run(step)
    assert all(path.is_file() for path in made)
    np.testing.assert_array_equal(np.load("H.npy"), before)
    for path in made:
        path.unlink()
    exec(compile((tmp_path / "again.py").read_text(), "again", "exec"), {})
    assert all(path.is_file() for path in made)
    np.testing.assert_array_equal(np.load("H.npy"), before)


def test_the_script_of_a_history_is_read_by_a_shell(project: ProjectState) -> None:
    history = History()
    history.add(Taken("setup", "Save\ncamera", step_of(SPECS["setup"], project)))
    history.add(Taken("fit", "Fit H.h5", step_of(SPECS["h"], project, part="fit"), draft=True))
    history.add(Taken("fit", "Fit H.h5", step_of(SPECS["h"], project, "my fit", "fit"), "my fit"))
    history.add(Taken("simulate", "Frames", None, why="it has none"))
    assert history.latest("fit") == "my fit" and len(history.taken) == 3
    found = subprocess.run(["sh", "-n"], input=history.shell(), capture_output=True, text=True)
    assert found.returncode == 0, found.stderr
    assert "# Save camera\n" in history.shell() and "# Frames (no command: it has none)\n" in history.shell()
    compile(history.python(), "history", "exec")


def test_resumed_recordings_and_comparisons_are_commands(project: ProjectState) -> None:
    again = recording_step(project, "s", redo=[(0, 1, 2)])
    read = parsed(again.arguments)
    assert (read["redo"], read["out"]) == ("lfcal-redo.json", "s") and len(again.files) == 2
    assert parsed(recording_step(project, "s", resume=True).arguments)["resume"]
    white = assembled("s", "H.h5", None, CorrectionRecipe(white=Path("s/white"), dark=Path("s/dark")))
    assert parsed(white.arguments)["white"] == "s/white"
    assert parsed(compare_step("a.h5", "b.h5", "report", by_number=True).arguments)["by_number"]
    for step in (again, white, compare_step("a.h5", "b.h5", "r")):
        compile(step.script(), "step", "exec")


def white_of(camera: Camera) -> np.ndarray:
    """Return an even light through the lattice of a camera, shifted by 0.3 px against its description."""
    y, x = np.indices(camera.sensor.shape)
    index = lattice_of(camera).lenslet_at(y - 0.3, x)
    away = index - np.rint(index)
    return np.rint(100 + 2000 * np.exp(-12 * (away**2).sum(-1))).astype(np.uint16)


@pytest.mark.few(4)
@pytest.mark.parametrize("route", ["cells", "general", "transmissions", "lattice", "white"])
@pytest.mark.parametrize("weighted", ["", "dead", "weighted"])
def test_a_frame_recovered_by_page_command_and_script_is_the_same(
    project: ProjectState, route: str, weighted: str
) -> None:
    rng, sensor = np.random.default_rng(2), project.camera.sensor
    frame = rng.integers(100, sensor.max_value - 100, sensor.shape).astype(np.float32)
    dead = rng.random(sensor.shape) < 0.01
    tifffile.imwrite("frame.tif", frame)
    tifffile.imwrite("dead.tif", dead.astype(np.uint8))
    settings = MultiplexSettings(family="mask", mask="pinhole", size=3, scene="image", image="frame.tif")
    settings = replace(settings, weighted=weighted == "weighted", dead="dead.tif" if weighted else "", filter="cubic")
    if route in ("lattice", "white"):
        settings = replace(settings, route="lattice")
    elif route != "cells":
        settings = replace(settings, route="general", spacing=4.0)
    if route == "white":
        tifffile.imwrite("white.tif", white_of(project.camera))
        settings = replace(settings, white="white.tif")
    if route == "transmissions":
        np.save("shares.npy", rng.random((2, *sensor.shape)))
        settings = replace(settings, transmissions="shares.npy", spacing=None)
    step = step_of(SPECS["multiplex"], replace(project, settings=settings.into(project)), "found.tif")
    run(step)
    names = ["found.tif"] if settings.route == "general" else ["found.tif", "found_fourier.tif"]
    by_command = [tifffile.imread(name) for name in names]
    for name in names:
        Path(name).unlink()
    do(step)
    made = drain(iter_reconstruct(settings, sensor, camera=project.camera))
    by_page = [route.samples for route in (made.spatial, made.fourier) if route is not None]
    for name, command, page in zip(names, by_command, by_page, strict=True):
        np.testing.assert_allclose(tifffile.imread(name), command, rtol=1e-4, atol=1e-3)
        np.testing.assert_allclose(page, command, rtol=1e-3, atol=1e-2)


@pytest.mark.long
def test_the_page_recovers_the_middle_of_a_large_frame_and_the_command_all(project: ProjectState) -> None:
    """Super-pixels begin at the frame's first pixel for both, whatever their size."""
    tifffile.imwrite("frame.tif", np.random.default_rng(3).random((1650, 1700), np.float32))
    settings = MultiplexSettings(family="mask", mask="MURA", size=11, scene="image", image="frame.tif")
    step = step_of(SPECS["multiplex"], replace(project, settings=settings.into(project)), "found.tif")
    run(step)
    whole = tifffile.imread("found.tif")
    made = drain(iter_reconstruct(settings, project.camera.sensor))
    assert "the middle 1536 × 1536 px of 1700 × 1650 px" in made.words and whole.shape == (121, 150, 155)
    inner = np.s_[:, 3:-3, 3:-3]
    # the page's part begins 66 px down, 88 px to the right: whole super-pixels
    part = whole[:, 6:145, 8:147]
    np.testing.assert_allclose(made.spatial.samples[:, :139, :139][inner], part[inner], rtol=1e-4, atol=1e-5)


def test_patterns_of_multiplexing_run_by_command_and_by_script(project: ProjectState) -> None:
    step = step_of(SPECS["multiplex"], project)
    run(step)
    do(step)
    written = MultiplexSettings(family="written").into(project)
    step = step_of(SPECS["multiplex"], replace(project, settings=written))
    assert "polarisers:0,45/135,90" in step.arguments
    run(step)
    do(step)


def test_a_volume_with_voxels_of_one_size_is_the_same_by_command_and_by_script(project: ProjectState) -> None:
    values = np.random.default_rng(0).random((2, 3, 4, 5, 5), np.float32)
    export(PSFMatrix(values, depths=(-26_000.0, -20_000.0), camera=preset("bench")), "H.h5")
    tifffile.imwrite("frame.tif", np.random.default_rng(1).poisson(100, (24, 25)).astype(np.uint16))
    for voxel in ("auto", "40"):
        chosen = replace(ReconstructSettings.of(project), voxel=voxel)
        step = step_of(SPECS["reconstruct"], replace(project, settings=chosen.into(project)))
        assert f"--voxel={voxel}" in step.arguments
        run(step)
        found = tifffile.imread("volume.tif").squeeze()
        Path("volume.tif").unlink()
        assert found.shape[0] == 2 and found.shape[1:] != (24, 25)
        do(step)
        np.testing.assert_allclose(tifffile.imread("volume.tif").squeeze(), found, rtol=1e-5)
        Path("volume.tif").unlink()
