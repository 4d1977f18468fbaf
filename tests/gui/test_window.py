from __future__ import annotations

import gc
import random
import sys
import weakref
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import QMimeData, QPoint, Qt, QUrl
from PySide6.QtGui import QCloseEvent, QDropEvent
from PySide6.QtWidgets import (
    QApplication,
    QCheckBox,
    QComboBox,
    QLineEdit,
    QMessageBox,
    QPushButton,
    QSlider,
    QWidget,
)
from pytestqt.qtbot import QtBot

from lfcal.base.errors import InputError
from lfcal.base.progress import Progress, Work
from lfcal.camera import preset
from lfcal_gui._layouts import size_within
from lfcal_gui.app import make_window, parse
from lfcal_gui.jobs import JobState
from lfcal_gui.models.page import PAGES, PLACES
from lfcal_gui.models.project import Project, ProjectState
from lfcal_gui.pages.frames.model import FrameSettings
from lfcal_gui.theme import DARK, LIGHT, current_theme
from lfcal_gui.window import MainWindow
from tests.cli.conftest import true_frame
from tests.gui.recorded import write_recorded
from tests.gui.waiting import GUARD_MS, idle


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    return write_recorded(tmp_path / "recorded")


def test_a_whole_sitting(window: MainWindow, qtbot: QtBot, recorded: Path, tmp_path: Path) -> None:
    """Frames in by drag and drop, corrections, H assembled, HT looked at, exported, saved, reopened."""
    window.take_files([str(recorded)])
    frames: Any = window.page("frames")
    assert window.shown is frames
    idle(window.jobs, qtbot)
    assert frames.opened is not None and frames.loaded is not None
    np.testing.assert_array_equal(frames.loaded.raw, true_frame(0, 0, 0) + 100)
    np.testing.assert_allclose(frames.loaded.fixed, true_frame(0, 0, 0), atol=0.5)
    columns = frames.panel.view.overlays[0].points[:, 1]
    qtbot.keyClick(frames, Qt.Key.Key_Right)
    idle(window.jobs, qtbot)
    assert frames.position == (0, 0, 1)
    moved = frames.panel.view.overlays[0].points[:, 1]
    assert (moved == columns + 1).all() and np.ptp(columns) > 0, "the cutout moves one pixel with the point"
    frames.panel.choices.editor("use_dark").setChecked(False)
    assert not FrameSettings.of(window.project.state).use_dark
    window.project.undo()
    assert frames.panel.choices.editor("use_dark").isChecked()
    idle(window.jobs, qtbot)
    target = tmp_path / "H.h5"
    with qtbot.waitSignal(window.jobs.finished, timeout=GUARD_MS) as end:
        frames.assemble(str(target))
    assert end.args[0].state is JobState.DONE, end.args[0].error
    assert window.project.state.psf == str(target)
    window.go("h", (1, 2, 3))
    psf: Any = window.page("h")
    idle(window.jobs, qtbot)
    np.testing.assert_allclose(psf.panel.main_view.values.max(), 20000, rtol=0.01)
    qtbot.keyClick(psf, Qt.Key.Key_T)
    assert psf.intent.transposed
    np.testing.assert_array_equal(psf.panel.main_view.values, psf.matrix.T[1, 2, 3])
    with qtbot.waitSignal(window.jobs.finished, timeout=GUARD_MS) as end:
        window.page("reconstruct").exporting.start(str(tmp_path / "H.npy"))  # type: ignore[attr-defined]
    assert end.args[0].state is JobState.DONE and (tmp_path / "H.npy").exists()
    window.project.save(tmp_path / "s.lfcal")
    other = Project()
    other.open(tmp_path / "s.lfcal")
    assert other.state == window.project.state


def test_only_existing_pages_and_their_states(window: MainWindow) -> None:
    keys = [spec.key for spec in window.specs]
    assert keys[:2] == ["setup", "acquire"] and "h" in keys
    for place in PLACES:
        assert window.views(place.key)
    assert [window.rail.word(place.key) for place in PLACES] == ["▲ start here", "needs a plan", "none yet", "needs H"]
    assert {spec.key for spec in window.views("")} == set(keys) - {s.key for p in PLACES for s in window.views(p.key)}


def test_every_page_opens_without_anything_and_fits_a_small_screen(window: MainWindow, qtbot: QtBot) -> None:
    for spec in window.specs:
        window.go(spec.key)
        idle(window.jobs, qtbot)
        assert window.shown is window.page(spec.key)
    assert [spec.key for spec in window.specs] == list(PAGES.names())
    window.project.update("plan", plan=None)
    large = []
    for key in PAGES.names():
        window.go(key)
        idle(window.jobs, qtbot)
        least = window.page(key).body.minimumSizeHint()
        if least.width() > 1280 - 85 or least.height() > 640:
            large.append((key, least))
    assert not large


def test_a_new_window_is_whole_under_its_title_bar() -> None:
    """On a screen of 1280 x 800 the status bar, the only place of messages, lay below its edge."""
    assert size_within((1280, 800)) == (1280, 760)
    assert size_within((1280, 772)) == (1280, 732)
    assert size_within((1920, 1080)) == size_within((800, 800)) == (1280, 800)


def test_undo_through_the_menu(window: MainWindow) -> None:
    camera: Any = window.page("setup")
    editor = camera.panel.inspector.values.editor("optics.f_number")
    editor.setText("8")
    editor.textEdited.emit("8")
    assert window.project.state.camera.optics.f_number == 8  # type: ignore[union-attr]
    assert window.menus.undo.isEnabled() and "f number" in window.menus.undo.text()
    window.menus.undo.trigger()
    assert window.project.state.camera == preset("bench") and editor.text() == "4"
    window.menus.redo.trigger()
    assert editor.text() == "8"


def test_what_does_not_pass_is_marked_and_not_taken(window: MainWindow) -> None:
    camera: Any = window.page("setup")
    form = camera.panel.inspector.values
    editor = form.editor("optics.f_number")
    for text in ("-1", "abc", "", "1e999", "nan"):
        editor.setText(text)
        editor.textEdited.emit(text)
        assert editor.property("invalid"), text
        assert form.error and "\n" not in form.error
    assert window.project.state.camera == preset("bench")
    editor.setText("5.6")
    editor.textEdited.emit("5.6")
    assert not editor.property("invalid") and not form.error


def test_theme_and_sizes(window: MainWindow, qtbot: QtBot) -> None:
    window.go("setup")
    window.set_theme("dark")
    assert current_theme() is DARK
    window.set_theme("light")
    assert current_theme() is LIGHT
    window.resize(1280, 800)
    QApplication.processEvents()
    assert window.minimumSizeHint().width() <= 1280 and window.minimumSizeHint().height() <= 800


def test_closing_asks_about_unsaved_work(window: MainWindow, monkeypatch: pytest.MonkeyPatch) -> None:
    window.project.update("rename", name="changed")
    buttons = QMessageBox.StandardButton
    asked: list[str] = []

    def answer(*args: Any) -> Any:
        asked.append(str(args[1]))
        return buttons.Cancel

    monkeypatch.setattr(QMessageBox, "question", answer)
    event = QCloseEvent()
    window.closeEvent(event)
    assert asked == ["Unsaved changes"] and not event.isAccepted()
    monkeypatch.setattr(QMessageBox, "question", lambda *_: buttons.Discard)
    event = QCloseEvent()
    window.closeEvent(event)
    assert event.isAccepted()


def test_dropped_files_find_their_page(window: MainWindow, tmp_path: Path, qtbot: QtBot) -> None:
    np.save(tmp_path / "H.npy", np.random.default_rng(0).random((2, 3, 3, 5, 5)))
    data = QMimeData()
    data.setUrls([QUrl.fromLocalFile(str(tmp_path / "H.npy"))])
    event = QDropEvent(
        QPoint(5, 5), Qt.DropAction.CopyAction, data, Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier
    )
    window.dropEvent(event)
    idle(window.jobs, qtbot)
    assert window.project.state.psf.endswith("H.npy")
    window.take_files([str(tmp_path / "unknown.xyz")])
    assert "no page can open" in window.log_view.toPlainText()


def test_a_file_that_no_page_takes_makes_no_page(window: MainWindow, tmp_path: Path) -> None:
    """Every page was made to be asked, which took seconds."""
    (tmp_path / "notes.docx").write_bytes(b"x")
    for paths in (["notes.docx"], ["a.docx", "b.docx"], ["gone"]):
        window.take_files([str(tmp_path / path) for path in paths])
        assert "no page can open" in window.log_view.toPlainText().splitlines()[-1]
    assert set(window._pages) == {window.specs[0].key}
    np.save(tmp_path / "H.npy", np.ones((1, 2, 2, 3, 3), np.float32))
    window.take_files([str(tmp_path / "H.npy")])
    assert set(window._pages) == {window.specs[0].key, "h"}


def test_a_failing_job_speaks_in_words(window: MainWindow, qtbot: QtBot, tmp_path: Path) -> None:
    np.save(tmp_path / "H.npy", np.ones((1, 2, 2, 3, 3), np.float32))
    window.project.update("open", psf=str(tmp_path / "H.npy"))
    use: Any = window.page("reconstruct")
    idle(window.jobs, qtbot)
    with qtbot.waitSignal(window.jobs.finished, timeout=GUARD_MS) as end:
        use.exporting.start(str(tmp_path / "H.npy" / "H.mat"))
    assert end.args[0].state is JobState.FAILED
    assert "\n" not in end.args[0].error and end.args[0].details
    assert end.args[0].error in window.log_view.toPlainText()


def controls(page: QWidget) -> list[QWidget]:
    kinds = (QLineEdit, QComboBox, QCheckBox, QSlider, QPushButton)
    found = [w for kind in kinds for w in page.findChildren(kind)]
    return [w for w in found if w.isVisibleTo(page) and w.isEnabled()]


SAFE = (
    "…",
    "Open the sample",
    "Assemble",
    "Compute H",
    "ladder",
    "Export",
    "Start",
    "Record",
    "Connect",
    "Report",
    "Reconstruct",
    "Run",
    "Measure",
    "Make",
)


TEXTS = ("", "0", "-1", "1", "1e9", "nan", "inf", "1e400", "1, nan", "3, 4", "3,4", "abc", "0.5", "17")


def use(widget: QWidget, rng: random.Random) -> None:
    """Do with a control what a user may do, at the ends of its range."""
    if isinstance(widget, QLineEdit):
        text = rng.choice(TEXTS)
        widget.setText(text)
        widget.textEdited.emit(text)
    elif isinstance(widget, QComboBox) and widget.count():
        index = rng.choice([0, widget.count() - 1])
        widget.setCurrentIndex(index)
        widget.activated.emit(index)
    elif isinstance(widget, QCheckBox):
        widget.toggle()
    elif isinstance(widget, QSlider):
        widget.setValue(rng.choice([widget.minimum(), widget.maximum()]))
    elif isinstance(widget, QPushButton) and not any(word in widget.text() for word in SAFE):
        widget.click()


@pytest.mark.parametrize("steps", [25, pytest.param(220, marks=pytest.mark.long)])
def test_a_random_walk_over_all_controls(
    window: MainWindow, qtbot: QtBot, recorded: Path, monkeypatch: pytest.MonkeyPatch, steps: int
) -> None:
    """Boundary values in every control: nothing raises, the session stays valid."""
    from PySide6.QtWidgets import QFileDialog

    for name in ("getOpenFileName", "getSaveFileName"):
        monkeypatch.setattr(QFileDialog, name, lambda *_: ("", ""))
    monkeypatch.setattr(QFileDialog, "getExistingDirectory", lambda *_: "")
    window.take_files([str(recorded)])
    np.save(recorded / "H.npy", np.random.default_rng(0).random((2, 3, 4, 9, 11)).astype(np.float32))
    window.project.update("open", psf=str(recorded / "H.npy"))
    rng = random.Random(7)
    raised: list[Any] = []
    monkeypatch.setattr(sys, "excepthook", lambda *args: raised.append(args))
    for step in range(steps):
        spec = rng.choice(window.specs)
        window.go(spec.key)
        page = window.page(spec.key)
        choices = controls(page)
        if not choices:
            continue
        widget = rng.choice(choices)
        use(widget, rng)
        QApplication.processEvents()
        if step % 40 == 0:
            window.project.undo()
            idle(window.jobs, qtbot)
    idle(window.jobs, qtbot)
    assert raised == []
    assert ProjectState.from_json(window.project.state.to_json()) == window.project.state


def test_no_window_is_left_behind(qapp: QApplication, place: Path) -> None:
    window = make_window(qapp, parse([]), folder=place)
    window.show()
    for spec in window.specs:
        window.go(spec.key)
    QApplication.processEvents()
    seen = weakref.ref(window.context)
    window.shut_down()
    window.close()
    window.deleteLater()
    del window
    for _ in range(5):
        QApplication.sendPostedEvents(None, 52)  # QEvent.DeferredDelete
        QApplication.processEvents()
        gc.collect()
    assert not [w for w in QApplication.topLevelWidgets() if isinstance(w, MainWindow) and w.isVisible()]
    assert seen() is None or not seen().jobs.busy  # type: ignore[union-attr]


def test_events_do_not_leak_references_to_none(qapp: QApplication, qtbot: QtBot) -> None:
    """PySide6 6.12.0 loses a reference to None with every event and aborts after some thousands."""

    class Watched(QWidget):
        def event(self, event: Any) -> bool:
            return super().event(event)

    widget = Watched()
    qtbot.addWidget(widget)
    before = sys.getrefcount(None)
    for _ in range(2000):
        QApplication.sendEvent(widget, QCloseEvent())
    assert sys.getrefcount(None) > before - 500


def test_jobs_are_listed_without_moving_the_page(window: MainWindow, qtbot: QtBot) -> None:
    """A dock opened and closed by itself, and the page moved under the pointer."""

    def work(error: str = "") -> Work[int]:
        yield Progress(0, 1, "at it")
        if error:
            raise InputError(error)
        return 1

    line, before = window.job_line, window.stack.geometry()
    window.jobs.start("Assemble H.h5", "plan", work)
    assert line.button.text().startswith("Assemble H.h5") and line.bar.isVisible()
    idle(window.jobs, qtbot)
    assert line.button.text() == "No jobs running" and line.sheet.isHidden()
    window.jobs.start("Export H.mat", "plan", lambda: work("no room"))
    idle(window.jobs, qtbot)
    assert line.button.text() == "Failed: Export H.mat" and line.button.property("role") == "error"
    assert window.message.text() == "Export H.mat: no room" and window.message.property("role") == "error"
    window.log("something else")
    assert window.message.property("role") == "hint"
    window.jobs.start("Inspect H.h5", "plan", work)
    idle(window.jobs, qtbot)
    assert line.button.text() == "Failed: Export H.mat", "an error stays until it was read"
    qtbot.keyClick(window, Qt.Key.Key_J, Qt.KeyboardModifier.ControlModifier)
    assert line.sheet.isVisible() and line.button.text() == "No jobs running"
    assert "no room" in line.sheet.panel.row(2).error.text()
    assert window.stack.geometry() == before, "nothing moved"
    qtbot.keyClick(line.sheet, Qt.Key.Key_Escape)
    assert line.sheet.isHidden()
    window.jobs.start("again", "plan", lambda: work("no room"))
    line.toggle()
    idle(window.jobs, qtbot)
    assert line.button.text() == "No jobs running", "it was seen as it failed"


def test_a_failed_job_is_forgotten_when_it_succeeds_or_another_project_begins(window: MainWindow, qtbot: QtBot) -> None:
    """The status bar still said that a recording failed when it was complete, and in a new project."""

    def work(error: str = "") -> Work[int]:
        yield Progress(0, 1, "at it")
        if error:
            raise InputError(error)
        return 1

    def run(title: str, error: str = "") -> str:
        window.jobs.start(title, "acquire", lambda: work(error))
        idle(window.jobs, qtbot)
        return window.job_line.button.text()

    assert run("Record session", "no frame") == "Failed: Record session"
    drawn = window.job_line.button.grab().toImage()
    colours = {drawn.pixelColor(x, y).name() for x in range(drawn.width()) for y in range(drawn.height())}
    assert current_theme().bad in colours, "drawn in the colour of an error"
    assert run("Assemble H.h5") == "Failed: Record session", "another job"
    assert run("Record session") == "No jobs running"
    assert run("Record session", "no frame") == "Failed: Record session"
    window.project.update("name", name="another name")
    assert window.job_line.button.text() == "Failed: Record session"
    window.project.start(ProjectState())
    assert window.job_line.button.text() == "No jobs running"


def test_places_are_left_and_found_again(window: MainWindow, qtbot: QtBot) -> None:
    keys = Qt.KeyboardModifier
    qtbot.keyClick(window, Qt.Key.Key_2, keys.ControlModifier)
    assert window.shown.spec.key == "acquire"
    qtbot.keyClick(window, Qt.Key.Key_2, keys.AltModifier)
    assert window.shown.spec.key == "frames"
    (segment,) = [b for b in window.shown.findChildren(QPushButton) if b.text() == "Compute" and b.isCheckable()]
    qtbot.mouseClick(segment, Qt.MouseButton.LeftButton)
    assert window.shown.spec.key == "simulate" and not segment.isChecked(), "it is the button of another page"
    rail = {b.title.text(): b for b in window.rail.findChildren(QPushButton)}
    qtbot.mouseClick(rail["H"], Qt.MouseButton.LeftButton)
    assert window.shown.spec.key == "h" and rail["H"].isChecked() and not rail["Record"].isChecked()
    qtbot.mouseClick(rail["Record"], Qt.MouseButton.LeftButton)
    assert window.shown.spec.key == "simulate", "a place is as it was left"
    qtbot.keyClick(window, Qt.Key.Key_3, keys.AltModifier)
    qtbot.keyClick(window, Qt.Key.Key_4, keys.ControlModifier)
    qtbot.keyClick(window, Qt.Key.Key_3, keys.AltModifier)
    assert window.shown.spec.key == "reconstruct", "it has no third view"


def test_a_page_in_a_window_of_its_own(window: MainWindow, qtbot: QtBot) -> None:
    qtbot.keyClick(window, Qt.Key.Key_M, Qt.KeyboardModifier.ControlModifier)
    page = window.page("multiplex")
    own = page.window()
    assert own is not window and own.isVisible() and window.shown is page
    keys = {key.toString() for action in own.actions() for key in action.shortcuts()}
    assert keys >= {"Ctrl+Z", "Ctrl+K", "Ctrl+Shift+P", "Ctrl+J"}
    page.refuse("no room on the disk")
    assert page.notice.isVisible() and page.notice.window() is own
    own.resize(1100, 720)
    own.close()
    window.activateWindow()
    qtbot.waitUntil(lambda: window.shown.spec.key == "setup", timeout=GUARD_MS)
    window.go("multiplex")
    assert page.window() is own and own.isVisible() and (own.width(), own.height()) == (1100, 720)
    window.go("h")
    assert window.shown is window.page("h")


def test_a_notice_moves_nothing(window: MainWindow) -> None:
    window.go("frames")
    page, other = window.page("frames"), window.page("h")
    before = page.body.geometry(), page.mapTo(window, page.body.pos())
    page.refuse("the folder is empty: choose another" * 9)
    QApplication.processEvents()
    assert page.notice.isVisible() and (page.body.geometry(), page.mapTo(window, page.body.pos())) == before
    assert page.notice.label.toolTip() == page.notice.label.text(), "what has no room stands in the tip"
    window.go("h")
    assert not page.notice.isVisible() and not other.notice.isVisible()
    window.go("frames")
    assert page.notice.isVisible()
    page.notice.button.click()
    assert not page.notice.isVisible()


def test_borders_are_kept_for_the_next_start(qapp: QApplication, place: Path) -> None:
    def sizes(made: MainWindow) -> list[int]:
        made.resize(1280, 800)
        made.show()
        made.go("h")
        made.page("h").show_body()
        QApplication.processEvents()
        return list(made.page("h").panel.split.sizes())  # type: ignore[attr-defined]

    def closed(made: MainWindow) -> None:
        made.shut_down()
        made.close()
        made.deleteLater()

    first = make_window(qapp, parse([]), folder=place)
    before = sizes(first)
    first.page("h").panel.split.setSizes([300, sum(before) - 300])  # type: ignore[attr-defined]
    closed(first)
    second = make_window(qapp, parse([]), folder=place)
    kept = sizes(second)
    assert kept[0] < before[0]
    second.reset_layout()
    assert sizes(second)[0] > kept[0]
    closed(second)
    third = make_window(qapp, parse([]), folder=place)
    assert sizes(third)[0] > kept[0]
    closed(third)
