"""Another project takes nothing of the one before: no file that was still opening, no result, no chart."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pytestqt.qtbot import QtBot

import lfcal.psf
from lfcal.camera import ScanPlan, preset
from lfcal.psf import PSFMatrix, save
from lfcal_gui.models.project import ProjectState
from lfcal_gui.window import MainWindow
from tests.acquire.rigs import small_plan
from tests.gui.waiting import GUARD_MS, idle


@pytest.fixture
def good(tmp_path: Path) -> Path:
    values = np.random.default_rng(0).random((2, 3, 4, 5, 5)).astype(np.float32)
    save(PSFMatrix(values, depths=[0, 10]), tmp_path / "good.h5")
    return tmp_path / "good.h5"


class Held:
    """A function that answers when it is let go."""

    def __init__(self, really: Callable[..., Any]) -> None:
        self.really, self.begun, self.go = really, threading.Event(), threading.Event()

    def __call__(self, *args: Any, **options: Any) -> Any:
        self.begun.set()
        self.go.wait(GUARD_MS / 1e3)
        return self.really(*args, **options)

    def after(self, window: MainWindow, qtbot: QtBot) -> ProjectState:
        """Begin another project meanwhile, and return it when all has come to rest."""
        assert self.begun.wait(GUARD_MS / 1e3)
        window.project.start(ProjectState(name="another"))
        self.go.set()
        idle(window.jobs, qtbot)
        return window.project.state


def test_a_file_of_h_that_is_still_opening(
    window: MainWindow, good: Path, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    window.go("h")
    page: Any = window.page("h")
    for choose in (page.open_file, page.comparing.choose):
        held = Held(lfcal.psf.open_psf)
        monkeypatch.setattr(lfcal.psf, "open_psf", held)
        choose(str(good))
        assert held.after(window, qtbot) == ProjectState(name="another")
        assert window.context.matrix(str(good)) is None and not page.notice.isVisible()
        monkeypatch.setattr(lfcal.psf, "open_psf", held.really)


def test_a_second_h_that_is_still_opening(
    window: MainWindow, good: Path, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    window.project.update("open", psf=str(good))
    window.go("h")
    idle(window.jobs, qtbot)
    page: Any = window.page("h")
    held = Held(lfcal.psf.open_psf)
    monkeypatch.setattr(lfcal.psf, "open_psf", held)
    page.comparing.choose(str(good))
    assert held.after(window, qtbot).reference == ""
    assert "Opening" not in page.comparing.view.message.text() and page.comparing.found is None


def test_a_camera_that_is_still_read(
    window: MainWindow, tmp_path: Path, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    import lfcal_gui.pages.setup.page as module

    held = Held(module.import_camera)
    monkeypatch.setattr(module, "import_camera", held)
    (tmp_path / "r29.json").write_text(preset("r29").to_json())
    window.go("setup")
    window.page("setup").import_file(str(tmp_path / "r29.json"))  # type: ignore[attr-defined]
    assert held.after(window, qtbot).camera == preset("bench")


def test_a_session_folder_that_is_still_looked_into(
    window: MainWindow, tmp_path: Path, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    import lfcal_gui.pages.acquire._choices as module

    held = Held(module.folder_state)
    page: Any = window.page("acquire")
    monkeypatch.setattr(module, "folder_state", held)
    page.record.folder_choice.take(str(tmp_path))
    assert held.after(window, qtbot).recording == ""


def test_a_volume_of_another_project(window: MainWindow, good: Path, tmp_path: Path, qtbot: QtBot) -> None:
    """It was shown beside the new project's H, and Save would have written it."""
    window.project.update("open", psf=str(good))
    window.go("reconstruct")
    page: Any = window.page("reconstruct")
    idle(window.jobs, qtbot)
    page.make_light_field("points", str(tmp_path / "p.tif"), shape=(32, 32))
    idle(window.jobs, qtbot)
    page.start()
    idle(window.jobs, qtbot)
    solved = page.solving
    page.save(str(tmp_path / "volume.npy"))
    idle(window.jobs, qtbot)
    values = np.ones((3, 3, 4, 5, 5), np.float32)
    save(PSFMatrix(values, depths=[0, 10, 20]), tmp_path / "other.h5")
    window.project.update("other H", psf=str(tmp_path / "other.h5"))
    idle(window.jobs, qtbot)
    page._show_volume()
    assert "by good.h5" in page.panel.view._title, "of the H before, whose volume it still is"
    window.project.start(ProjectState(psf=str(tmp_path / "other.h5")))
    idle(window.jobs, qtbot)
    assert page.solving is None and page.synthetic is None and not solved._matrices
    view = page.panel.view
    assert view.volume is None and view.prepared is None and view.strip.count() == 0
    assert not page.panel.save.isEnabled() and view.stack.currentWidget() is view.empty
    assert page.panel.status.text() == page.panel.took.text() == ""
    window.project.start(ProjectState(psf=str(good), volume=str(tmp_path / "volume.npy")))
    idle(window.jobs, qtbot)
    assert view._title == "volume.npy" and view.prepared is not None, (
        "the volume of a project is shown when it is opened"
    )
    window.project.update("no volume", volume="")
    assert page.saved is None and view.volume is None
    window.project.start(ProjectState())
    assert page.hint.text() == page.spec.hint, "the H before was named over an empty page"


def test_a_reconstruction_under_way(
    window: MainWindow, good: Path, tmp_path: Path, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    import lfcal_gui.pages.reconstruct.model_solving as module

    window.project.update("open", psf=str(good))
    window.go("reconstruct")
    page: Any = window.page("reconstruct")
    idle(window.jobs, qtbot)
    page.make_light_field("points", str(tmp_path / "p.tif"), shape=(32, 32))
    idle(window.jobs, qtbot)
    held = Held(module.projector_for)
    monkeypatch.setattr(module, "projector_for", held)
    page.start()
    solving = page.solving
    held.after(window, qtbot)
    qtbot.waitUntil(lambda: not solving._matrices or solving.state is None, timeout=GUARD_MS)
    assert page.solving is None and page._job == 0 and page.panel.status.text() == ""


def simulated(window: MainWindow, qtbot: QtBot) -> tuple[ScanPlan, Any]:
    """Return a small plan, and the view Compute with it."""
    plan = small_plan((3, 4), 2)
    window.project.update("plan", plan=plan, camera=plan.camera)
    window.go("simulate")
    idle(window.jobs, qtbot)
    return plan, window.page("simulate")


@pytest.mark.long
def test_a_frame_of_other_choices_or_another_plan(window: MainWindow, qtbot: QtBot) -> None:
    """It stayed without a word."""
    plan, page = simulated(window, qtbot)
    frame = page.panel.frame
    one = replace(plan, depths_um=plan.depths_um[:1], exposure_s=0.02)
    for change in (lambda: page._set("tolerance", 0.3), lambda: window.project.update("planes", plan=one)):
        page.make_frame()
        idle(window.jobs, qtbot)
        assert frame.view.values is not None
        change()
        idle(window.jobs, qtbot)
        assert frame.view.values is None and "changed since" in frame.words.text()
        assert not frame.save_button.isEnabled() and frame.make_button.isEnabled()


def test_measuring_a_plan_that_is_no_more_is_stopped(window: MainWindow, qtbot: QtBot) -> None:
    plan, page = simulated(window, qtbot)
    page.measure()
    number = page._measuring
    window.project.update("planes", plan=replace(plan, depths_um=plan.depths_um[:1], exposure_s=0.02))
    job = next(job for job in window.jobs.jobs() if job.number == number)
    assert job.stopping or not job.active
    idle(window.jobs, qtbot)
    assert page._curve is None and not len(page.panel.curve.scatter.data)
