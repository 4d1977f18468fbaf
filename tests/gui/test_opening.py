"""Files are opened in the background: damage replaces nothing, and another project takes over nothing."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PySide6.QtWidgets import QFileDialog, QMessageBox
from pytestqt.qtbot import QtBot

import lfcal.psf
from lfcal.camera import ScanPlan, preset
from lfcal.psf import PSFMatrix, save
from lfcal.simulate import sample_recording
from lfcal_gui.jobs import Jobs
from lfcal_gui.models.project import ProjectState
from lfcal_gui.pages.acquire import _choices as choices
from lfcal_gui.pages.reconstruct import model_solving
from lfcal_gui.pages.reconstruct.export_model import ExportSettings
from lfcal_gui.pages.setup import page as setup_page
from lfcal_gui.window import MainWindow
from tests.acquire.rigs import small_plan
from tests.gui.waiting import GUARD_MS, go, idle, page_of

DAMAGE = (KeyError("H"), RuntimeError("Can't decode\nchunk"), OSError(5, "I/O error"), TypeError("no"), MemoryError())


@pytest.fixture
def good(tmp_path: Path) -> Path:
    values = np.random.default_rng(0).random((2, 3, 4, 5, 5)).astype(np.float32)
    save(PSFMatrix(values, depths=[0, 10]), tmp_path / "good.h5")
    return tmp_path / "good.h5"


@pytest.fixture
def hanging(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, threading.Event]]:
    """Let every file whose name has "hang" in it open only at the end of the test."""
    events = {"begun": threading.Event(), "end": threading.Event()}
    really = lfcal.psf.open_psf

    def opener(path: Any, *args: Any, **options: Any) -> PSFMatrix:
        if "hang" in Path(path).name:
            events["begun"].set()
            events["end"].wait(GUARD_MS / 1e3)
            raise OSError("too late")
        return really(path, *args, **options)

    monkeypatch.setattr(lfcal.psf, "open_psf", opener)
    yield events
    events["end"].set()


def open_good(window: MainWindow, good: Path, qtbot: QtBot) -> Any:
    page = go(window, "h")
    page.open_file(str(good))
    idle(window.jobs, qtbot)
    assert window.project.state.psf == str(good) and page.matrix is not None
    return page


def test_a_file_that_does_not_open_leaves_the_window_usable_and_can_be_stopped(
    window: MainWindow, good: Path, tmp_path: Path, qtbot: QtBot, hanging: dict[str, threading.Event]
) -> None:
    path = tmp_path / "hang.h5"
    path.write_text("")
    page = open_good(window, good, qtbot)
    page.open_file(str(path))
    assert hanging["begun"].wait(GUARD_MS / 1e3)
    qtbot.waitUntil(page.notice.isVisible, timeout=GUARD_MS)
    assert "hang.h5" in page.notice.label.text() and window.project.state.psf == str(good)
    page.set_intent(z=0)
    qtbot.waitUntil(lambda: page.plane is not None and page.plane.z == 0, timeout=GUARD_MS)
    page.notice.button.click()
    idle(window.jobs, qtbot)
    assert page.matrix is not None and not page.notice.isVisible()
    # the H of a project
    hanging["begun"].clear()
    path = tmp_path / "hang_2.h5"
    path.write_text("")
    window.project.update("open", psf=str(path))
    keys = ("reconstruct", "h")
    for key in keys:
        window.go(key)
        assert "Opening hang_2.h5" in page_of(window, key).empty.label.text()
    assert hanging["begun"].wait(GUARD_MS / 1e3)
    window.context.matrices.cancel(str(path))
    idle(window.jobs, qtbot)
    for key in keys:
        assert "stopped" in page_of(window, key).empty.label.text()
    # an inspection, which opens the file itself
    hanging["begun"].clear()
    page.look_into("checks")
    assert hanging["begun"].wait(GUARD_MS / 1e3)
    window.jobs.cancel(window.jobs.jobs()[0].number)
    assert not window.jobs.running_pages() and "Stopped" in page.checking.view.message.text()
    hanging["end"].set()


def test_only_the_newest_file_is_opened_and_others_are_closed(jobs: Jobs, qtbot: QtBot) -> None:
    go, opened, closed, shown = threading.Event(), [], [], []

    def opener(k: int) -> int:
        go.wait(GUARD_MS / 1e3)
        opened.append(k)
        return k

    for k in range(20):
        jobs.load("x", lambda k=k: opener(k), shown.append, None, closed.append)
    go.set()
    idle(jobs, qtbot)
    assert opened == [0, 19] and shown == [19] and closed == [0]
    go.clear()
    jobs.load("x", lambda: opener(20), shown.append, None, closed.append)
    jobs.drop("x")
    jobs.load("x", lambda: 21, shown.append)
    idle(jobs, qtbot)
    go.set()
    qtbot.waitUntil(lambda: closed == [0, 20], timeout=GUARD_MS)
    assert shown == [19, 21], "what opens after it was dropped is closed"


def test_damage_of_any_kind_is_one_line_and_the_good_h_stays(
    window: MainWindow, good: Path, tmp_path: Path, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = open_good(window, good, qtbot)
    errors = iter([error for error in DAMAGE for _ in range(2)] + [DAMAGE[0]])

    def broken(path: Any) -> PSFMatrix:
        raise next(errors)

    monkeypatch.setattr(lfcal.psf, "open_psf", broken)
    for error in DAMAGE:
        for choose, label in (
            (page.open_file, page.notice.label),
            (page.comparing.choose, page.comparing.view.message),
        ):
            choose(str(tmp_path / "other.h5"))
            idle(window.jobs, qtbot)
            assert label.text() and "\n" not in label.text(), error
            assert window.project.state.psf == str(good) and window.project.state.reference == ""
            assert page.matrix is not None
    page.look_into("checks")
    idle(window.jobs, qtbot)
    assert page.checking.inspection is None and "\n" not in page.checking.view.message.text()


def test_damaged_frames_do_not_replace_the_open_ones(window: MainWindow, tmp_path: Path, qtbot: QtBot) -> None:
    page = go(window, "frames")
    page.open_folder(str(sample_recording()))
    idle(window.jobs, qtbot)
    before = window.project.state
    assert page.opened is not None
    (tmp_path / "session.json").write_text("{}")
    (tmp_path / "frames").mkdir()
    for folder in (tmp_path, tmp_path / "frames"):
        page.open_folder(str(folder))
        idle(window.jobs, qtbot)
        assert page.dialog.isVisible() and page.dialog.choice.frames == str(folder)
        assert not page.dialog.open_button.isEnabled()
        page.dialog.reject()
        assert window.project.state == before and page.opened is not None and page.loaded is not None


@pytest.mark.long
def test_an_error_while_an_open_h_is_read_is_logged(
    window: MainWindow, good: Path, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = open_good(window, good, qtbot)
    monkeypatch.setattr(PSFMatrix, "plane", lambda *_: {}["chunk"])
    page.set_intent(z=0)
    idle(window.jobs, qtbot)
    assert "KeyError: 'chunk'" in window.log_view.toPlainText()


def test_assembling_into_the_open_file_shows_the_new_one(window: MainWindow, good: Path, qtbot: QtBot) -> None:
    page = open_good(window, good, qtbot)
    old = page.matrix

    def work() -> Any:
        assert window.context.matrix(str(good)) is None, "closed while it is written"
        save(PSFMatrix(np.ones((1, 3, 4, 5, 5), np.float32)), good)
        yield from ()

    window.context.start_writing("Write", "h", str(good), work)
    assert "being written" in page.empty.label.text()
    idle(window.jobs, qtbot)
    assert page.matrix is not old and page.matrix.shape == (1, 3, 4, 5, 5)


@pytest.mark.long
def test_a_refusal_is_cleared_when_its_context_changes(window: MainWindow, qtbot: QtBot, tmp_path: Path) -> None:
    """The message about a file that did not open stayed above another H."""
    for name in ("H.h5", "other.h5"):
        save(PSFMatrix(np.ones((1, 2, 2, 5, 5), np.float32)), tmp_path / name)
    (tmp_path / "bad.h5").write_bytes(b"no file of HDF5")
    window.project.update("open", psf=str(tmp_path / "H.h5"))
    page = go(window, "h")
    idle(window.jobs, qtbot)
    page.open_file(str(tmp_path / "bad.h5"))
    idle(window.jobs, qtbot)
    assert page.notice.isVisible() and "bad.h5" in page.notice.label.text()
    window.project.update("settings", settings={"psf": {}})
    assert page.notice.isVisible(), "no other file was opened"
    window.project.update("assembly", psf=str(tmp_path / "other.h5"))
    idle(window.jobs, qtbot)
    assert not page.notice.isVisible()
    page.notice.offer("lies on its side", "Turn", lambda: None, tip="Turn the frames")
    window.project.update("camera", camera=preset("r29"))
    assert page.notice.isVisible(), "an offer waits for its answer"


# -- files are replaced only after a question --------------------------------------------------------------


# -- nothing is replaced unasked ---------------------------------------------------------------------------
@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    shown: list[str] = []
    monkeypatch.setattr(QMessageBox, "question", lambda *args: shown.append(args[2]) or QMessageBox.StandardButton.No)
    return shown


Choose = Callable[[str], None]


@pytest.fixture
def choose(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Choose:
    """Return a function that says which name the user types; the kind is the first offered."""

    def chosen(name: str) -> None:
        monkeypatch.setattr(QFileDialog, "getSaveFileName", lambda *a: (str(tmp_path / name), a[3].split(";;")[0]))

    monkeypatch.setattr(QFileDialog, "getExistingDirectory", lambda *_: str(tmp_path))
    return chosen


def test_every_page_asks_before_it_replaces_a_file(
    window: MainWindow, good: Path, tmp_path: Path, qtbot: QtBot, asked: list[str], choose: Choose
) -> None:
    """The dialog of Qt asks about the name typed; each page asks about what it writes instead."""
    page = open_good(window, good, qtbot)
    names = ("p.json", "x.mat", "x.tif", "index.html", "view.png", "view.npy")
    for name in names:
        (tmp_path / name).write_text("precious")
    page_of(window, "setup").make_default()
    choose("p")
    page_of(window, "setup").save_plan()
    page_of(window, "setup").save_file()
    choose("x")
    use = page_of(window, "reconstruct")
    for suffix in (".mat", ".tif"):
        window.project.update("kind", settings=ExportSettings(suffix=suffix).into(window.project.state))
        use.exporting.ask()
    page_of(window, "h").checking.write_report()
    choose("view")
    page.panel.main_view.save_picture()
    page.panel.main_view.save_data()
    idle(window.jobs, qtbot)
    assert len(asked) == 7 and all((tmp_path / name).read_text() == "precious" for name in names)


def test_a_file_that_cannot_be_written_is_a_message_of_one_line(
    window: MainWindow, good: Path, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown: list[str] = []
    monkeypatch.setattr(QMessageBox, "warning", lambda *args: shown.append(args[2]))
    page = open_good(window, good, qtbot)
    nowhere = tmp_path / "file"
    nowhere.write_text("")
    for write in (page.panel.main_view.save_data, page.panel.main_view.save_picture, page.panel.profile.save_data):
        write(str(nowhere / "x.csv"))
    assert len(shown) == 3 and all("\n" not in words and str(nowhere) in words for words in shown)


# -- another project ---------------------------------------------------------------------------------------


class Held:
    """A function that returns once it is released."""

    def __init__(self, really: Callable[..., Any]) -> None:
        self.really, self.begun, self.go = really, threading.Event(), threading.Event()

    def __call__(self, *args: Any, **options: Any) -> Any:
        self.begun.set()
        self.go.wait(GUARD_MS / 1e3)
        return self.really(*args, **options)

    def after(self, window: MainWindow, qtbot: QtBot) -> ProjectState:
        """Begin another project meanwhile, and return it when all work has ended."""
        assert self.begun.wait(GUARD_MS / 1e3)
        window.project.start(ProjectState(name="another"))
        self.go.set()
        idle(window.jobs, qtbot)
        return window.project.state


def test_a_file_that_is_still_opening_is_not_shown_in_another_project(
    window: MainWindow, good: Path, tmp_path: Path, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = shutil.copy(good, tmp_path / "other.h5")
    page = go(window, "h")
    for before, choose in product(("", str(good)), (page.open_file, page.comparing.choose)):
        window.project.start(ProjectState(psf=before))
        idle(window.jobs, qtbot)
        held = Held(lfcal.psf.open_psf)
        monkeypatch.setattr(lfcal.psf, "open_psf", held)
        choose(str(other))
        assert held.after(window, qtbot) == ProjectState(name="another")
        assert window.context.matrix(str(other)) is None and not page.notice.isVisible()
        assert "Opening" not in page.comparing.view.message.text() and page.comparing.found is None
        monkeypatch.setattr(lfcal.psf, "open_psf", held.really)


def test_a_camera_and_a_folder_that_are_still_read_are_not_taken_by_another_project(
    window: MainWindow, tmp_path: Path, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "r29.json").write_text(preset("r29").to_json())
    setup, acquire = window.page("setup"), window.page("acquire")
    held = Held(setup_page.import_camera)
    monkeypatch.setattr(setup_page, "import_camera", held)
    setup.import_file(str(tmp_path / "r29.json"))  # type: ignore[attr-defined]
    assert held.after(window, qtbot).camera == preset("bench")
    held = Held(choices.folder_state)
    monkeypatch.setattr(choices, "folder_state", held)
    acquire.record.folder_choice.take(str(tmp_path))  # type: ignore[attr-defined]
    assert held.after(window, qtbot).recording == ""


def test_a_volume_is_not_shown_in_another_project(window: MainWindow, good: Path, tmp_path: Path, qtbot: QtBot) -> None:
    """It was shown with the H of the new project, and Save would have written it."""
    window.project.update("open", psf=str(good))
    page = go(window, "reconstruct")
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
    assert "by good.h5" in page.panel.view._title, "the volume is of the H before"
    window.project.start(ProjectState(psf=str(tmp_path / "other.h5")))
    idle(window.jobs, qtbot)
    assert page.solving is None and page.synthetic is None and not solved._matrices
    view = page.panel.view
    assert view.volume is None and view.prepared is None and view.strip.count() == 0
    assert page.panel.save.isHidden() and view.stack.currentWidget() is view.empty
    assert page.panel.status.text() == page.panel.took.text() == ""
    window.project.start(ProjectState(psf=str(good), volume=str(tmp_path / "volume.npy")))
    idle(window.jobs, qtbot)
    assert view._title == "volume.npy" and view.prepared is not None, (
        "the volume of a project is shown when it is opened"
    )
    window.project.update("no volume", volume="")
    assert page.saved is None and view.volume is None
    window.project.start(ProjectState())
    assert page.hint.text() == page.spec.hint, "an empty page named the H before"


def test_a_running_reconstruction_ends_with_its_project(
    window: MainWindow, good: Path, tmp_path: Path, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    window.project.update("open", psf=str(good))
    page = go(window, "reconstruct")
    idle(window.jobs, qtbot)
    page.make_light_field("points", str(tmp_path / "p.tif"), shape=(32, 32))
    idle(window.jobs, qtbot)
    held = Held(model_solving.projector_for)
    monkeypatch.setattr(model_solving, "projector_for", held)
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
def test_a_simulated_frame_is_cleared_when_its_settings_or_plan_change(window: MainWindow, qtbot: QtBot) -> None:
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


def test_measuring_costs_stops_when_the_plan_changes(window: MainWindow, qtbot: QtBot) -> None:
    plan, page = simulated(window, qtbot)
    page.measure()
    number = page._measuring
    window.project.update("planes", plan=replace(plan, depths_um=plan.depths_um[:1], exposure_s=0.02))
    job = next(job for job in window.jobs.jobs() if job.number == number)
    assert job.stopping or not job.active
    idle(window.jobs, qtbot)
    assert page._curve is None and not len(page.panel.curve.scatter.data)
