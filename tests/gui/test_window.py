"""The window: places and pages, undo, the status bar, messages of pages, and what a recording holds."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import QMimeData, QPoint, Qt, QUrl
from PySide6.QtGui import QCloseEvent, QDropEvent
from PySide6.QtWidgets import (
    QApplication,
    QLabel,
    QMessageBox,
    QPushButton,
    QWidget,
)
from pytestqt.qtbot import QtBot

from lfcal.base.errors import InputError
from lfcal.base.progress import Progress, Work
from lfcal.camera import Marks, ScanPlan, preset
from lfcal_gui._layouts import size_within
from lfcal_gui._rail import BAR
from lfcal_gui.app import make_window, parse
from lfcal_gui.context import Context
from lfcal_gui.models.page import PLACES
from lfcal_gui.models.project import Hold, Project, ProjectState
from lfcal_gui.notice import Notice
from lfcal_gui.pages.setup.model import confirmed
from lfcal_gui.theme import current_theme
from lfcal_gui.window import MainWindow
from tests.gui.layout import flaws
from tests.gui.recorded import write_recorded
from tests.gui.waiting import GUARD_MS, idle, page_of


def test_every_page_has_its_place_and_each_place_its_state(window: MainWindow) -> None:
    keys = [spec.key for spec in window.specs]
    assert keys[:2] == ["setup", "acquire"] and "h" in keys
    for place in PLACES:
        assert window.views(place.key)
    assert [window.rail.word(place.key) for place in PLACES] == ["▲ start here", "needs a plan", "none yet", "needs H"]
    assert {spec.key for spec in window.views("")} == set(keys) - {s.key for p in PLACES for s in window.views(p.key)}


def test_a_new_window_is_whole_under_its_title_bar() -> None:
    """On a screen of 1280 x 800 the status bar, the only place of messages, lay below its edge."""
    assert size_within((1280, 800)) == (1280, 760)
    assert size_within((1280, 772)) == (1280, 732)
    assert size_within((1920, 1080)) == size_within((800, 800)) == (1280, 800)


def test_edits_are_checked_undone_and_redone(window: MainWindow) -> None:
    camera = page_of(window, "setup")
    form = camera.panel.inspector.values
    editor = form.editor("optics.f_number")

    def typed(text: str) -> None:
        editor.setText(text)
        editor.textEdited.emit(text)

    for text in ("-1", "abc", "", "1e999", "nan"):
        typed(text)
        assert editor.property("invalid"), text
        assert form.error and "\n" not in form.error
    assert window.project.state.camera == preset("bench"), "what is refused does not change the camera"
    typed("8")
    assert window.project.state.camera.optics.f_number == 8  # type: ignore[union-attr]
    assert not editor.property("invalid") and not form.error
    assert window.menus.undo.isEnabled() and "f number" in window.menus.undo.text()
    window.menus.undo.trigger()
    assert window.project.state.camera == preset("bench") and editor.text() == "4"
    window.menus.redo.trigger()
    assert editor.text() == "8"


def test_closing_asks_about_unsaved_work(window: MainWindow, monkeypatch: pytest.MonkeyPatch) -> None:
    window.project.update("rename", name="changed")
    asked: list[str] = []
    buttons = QMessageBox.StandardButton
    for answer in (buttons.Cancel, buttons.Discard):
        monkeypatch.setattr(QMessageBox, "question", lambda *said, answer=answer: (asked.append(said[1]), answer)[1])
        event = QCloseEvent()
        window.closeEvent(event)
        assert event.isAccepted() == (answer == buttons.Discard)
    assert asked == ["Unsaved changes"] * 2


def test_dropped_files_find_their_page_and_make_no_other(window: MainWindow, tmp_path: Path, qtbot: QtBot) -> None:
    """Every page was made to ask whether it opens the file, which took seconds."""
    (tmp_path / "notes.docx").write_bytes(b"x")
    for paths in (["notes.docx"], ["a.docx", "b.docx"], ["gone"]):
        window.take_files([str(tmp_path / path) for path in paths])
        assert "no page can open" in window.log_view.toPlainText().splitlines()[-1]
    assert set(window._pages) == {window.specs[0].key}
    np.save(tmp_path / "H.npy", np.ones((1, 2, 2, 3, 3), np.float32))
    data = QMimeData()
    data.setUrls([QUrl.fromLocalFile(str(tmp_path / "H.npy"))])
    event = QDropEvent(
        QPoint(5, 5), Qt.DropAction.CopyAction, data, Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier
    )
    window.dropEvent(event)
    idle(window.jobs, qtbot)
    assert window.project.state.psf.endswith("H.npy") and set(window._pages) == {window.specs[0].key, "h"}


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


# -- the status bar ----------------------------------------------------------------------------------------
def run(window: MainWindow, qtbot: QtBot, title: str, error: str = "") -> str:
    """Run a job to its end and return what the button of the jobs says."""

    def work() -> Work[int]:
        yield Progress(0, 1, "work")
        if error:
            raise InputError(error)
        return 1

    window.jobs.start(title, "plan", work)
    line = window.job_line
    assert line.bar.isVisible()
    idle(window.jobs, qtbot)
    return line.button.text()


def test_jobs_are_listed_without_moving_the_page(window: MainWindow, qtbot: QtBot) -> None:
    """A dock opened and closed automatically, and the page moved under the pointer."""
    line, before = window.job_line, window.stack.geometry()
    assert run(window, qtbot, "Assemble H.h5") == "No jobs running" and line.sheet.isHidden()
    assert run(window, qtbot, "Export H.mat", "no room") == "Failed: Export H.mat"
    assert line.button.property("role") == "error"
    assert window.message.text() == "Export H.mat: no room" and window.message.property("role") == "error"
    assert "Export H.mat: no room" in window.log_view.toPlainText()
    window.log("something else")
    assert window.message.property("role") == "hint"
    assert run(window, qtbot, "Inspect H.h5") == "Failed: Export H.mat", "an error stays until it was read"
    qtbot.keyClick(window, Qt.Key.Key_J, Qt.KeyboardModifier.ControlModifier)
    assert line.sheet.isVisible() and line.button.text() == "No jobs running"
    assert "no room" in line.sheet.panel.row(2).error.text()
    assert window.stack.geometry() == before, "nothing moved"
    qtbot.keyClick(line.sheet, Qt.Key.Key_Escape)
    assert line.sheet.isHidden()
    line.toggle()
    assert run(window, qtbot, "again", "no room") == "No jobs running", "it failed while the sheet was open"


def test_a_failed_job_is_forgotten_when_it_succeeds_or_another_project_begins(window: MainWindow, qtbot: QtBot) -> None:
    """The status bar still said that a recording failed when it was complete, and in a new project."""
    failed = "Failed: Record session"
    assert run(window, qtbot, "Record session", "no frame") == failed
    drawn = window.job_line.button.grab().toImage()
    colours = {drawn.pixelColor(x, y).name() for x in range(drawn.width()) for y in range(drawn.height())}
    assert current_theme().bad in colours, "drawn in the colour of an error"
    assert run(window, qtbot, "Assemble H.h5") == failed, "another job"
    assert run(window, qtbot, "Record session") == "No jobs running"
    assert run(window, qtbot, "Record session", "no frame") == failed
    window.project.update("name", name="another name")
    assert window.job_line.button.text() == failed
    window.project.start(ProjectState())
    assert window.job_line.button.text() == "No jobs running"


# -- places and views --------------------------------------------------------------------------------------


def test_a_place_shows_the_view_that_was_last_used(window: MainWindow, qtbot: QtBot) -> None:
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


def test_a_page_has_its_own_window(window: MainWindow, qtbot: QtBot) -> None:
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


def test_sizes_of_panels_are_kept_until_the_layout_is_reset(qapp: QApplication, place: Path) -> None:
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


WORDS = (
    *(("start here", "fair"), ("needs a plan", ""), ("cannot work", "bad"), ("12 assumed", "")),
    *(("plane 12 of 24", ""), ("1,234 to redo", "fair"), ("complete", "good"), ("exported", "good")),
)


def test_no_word_of_a_place_is_cut(window: MainWindow, qtbot: QtBot) -> None:
    rail = window.rail
    window.resize(1000, 600)
    for theme, place in product(("light", "dark"), rail._buttons):
        window.set_theme(theme)
        for word, mark in WORDS:
            rail.say(place, word, mark)
            qtbot.wait(1)
            assert not flaws(rail), word
            label = rail._buttons[place].word
            flags = label.alignment() | Qt.TextFlag.TextWordWrap
            drawn = label.fontMetrics().boundingRect(label.contentsRect(), flags, label.text())
            assert BAR <= label.x() + drawn.left(), word
            assert label.x() + drawn.right() < label.parentWidget().width() - 1, word


# -- messages of a page ------------------------------------------------------------------------------------


def test_a_notice_moves_nothing(window: MainWindow) -> None:
    window.go("frames")
    page, other = window.page("frames"), window.page("h")
    before = page.body.geometry(), page.mapTo(window, page.body.pos())
    page.refuse("the folder is empty: choose another" * 9)
    QApplication.processEvents()
    assert page.notice.isVisible() and (page.body.geometry(), page.mapTo(window, page.body.pos())) == before
    assert page.notice.label.toolTip() == page.notice.label.text(), "what has no room is in the tooltip"
    window.go("h")
    assert not page.notice.isVisible() and not other.notice.isVisible()
    window.go("frames")
    assert page.notice.isVisible()
    page.notice.button.click()
    assert not page.notice.isVisible()


WHY = "frames: expected grey frames, got colour frames of 3 channels; choose a channel in the dialog of the import"


def test_a_message_without_room_is_shown_in_its_own_window(qtbot: QtBot) -> None:
    root = QWidget()
    qtbot.addWidget(root)
    notice = Notice(root)
    root.resize(1200, 80)
    root.show()
    notice.setGeometry(0, 50, 1200, 24)
    notice.refuse(WHY)
    QApplication.processEvents()
    assert not notice.more.isVisible()
    notice.setGeometry(0, 50, 500, 24)
    QApplication.processEvents()
    assert notice.more.isVisible() and notice.label.toolTip() == WHY
    words = notice.show_whole()
    notice.refuse(f"/data/{'long_' * 20}name.h5: expected an HDF5 file, got 3000 bytes")
    assert "name.h5: expected an HDF5 " in QLabel.text(notice.label), "the reason counts more than the path"
    assert words.isVisible() and words.text() == WHY and words.height() >= words.heightForWidth(words.width())
    words.window().close()


def test_the_second_button_says_what_it_does(qtbot: QtBot) -> None:
    root = QWidget()
    qtbot.addWidget(root)
    notice = Notice(root)
    notice.offer(
        "Dark frames", "Continue", lambda: None, stay="Skip", tip="Go on", stay_tip="Record without dark frames"
    )
    assert (notice.leave.text(), notice.leave.toolTip()) == ("Skip", "Record without dark frames")
    notice.offer("Removed", "Undo", lambda: None, stay="Leave it", tip="Restore the plan")
    assert notice.leave.toolTip() == "Hide this message without any change"


# -- while a session is recorded, camera, plan and devices stay ---------------------------------------------


HELD = "a session is being recorded"


@pytest.fixture
def held(window: MainWindow) -> MainWindow:
    """Return a window whose camera and plan are held as by a recording."""
    plan = ScanPlan.for_camera(preset("bench"), virtual_depths=(3.0,))
    window.project.start(ProjectState(camera=plan.camera, plan=plan))
    hold = Hold(HELD, ("camera", "plan", "recording"), ("acquire",), window.context.refused.emit)
    window.project.hold(hold)
    return window


def test_every_way_to_another_camera_or_plan_is_refused_on_the_page(
    held: MainWindow, tmp_path: Path, qtbot: QtBot
) -> None:
    """The page showed nothing, and the log said that the camera had been taken."""
    (tmp_path / "camera.json").write_text(preset("r29").to_json())
    (tmp_path / "plan.json").write_text(ScanPlan.for_camera(preset("r29"), virtual_depths=(3.0,)).to_json())
    frames = write_recorded(tmp_path / "recorded")
    before = held.project.state
    pages: dict[str, Any] = {key: held.page(key) for key in ("setup", "frames")}
    ways: tuple[tuple[str, Callable[[], object]], ...] = (
        ("setup", lambda: pages["setup"].import_file(str(tmp_path / "camera.json"))),
        ("setup", lambda: pages["setup"].panel.inspector.preset_chosen.emit("r29")),
        ("setup", lambda: pages["setup"].open_plan(str(tmp_path / "plan.json"))),
        ("setup", lambda: held.take_files([str(tmp_path / "plan.json")])),
        ("frames", lambda: pages["frames"].open_folder(str(frames))),
    )
    for key, way in ways:
        held.go(key)
        pages[key].notice.clear()
        way()
        idle(held.jobs, qtbot)
        assert held.project.state == before, key
        assert pages[key].notice.isVisible() and HELD in pages[key].notice.label.text(), key
    assert "taken from" not in held.log_view.toPlainText() and held.log_view.toPlainText().count(HELD) == len(ways)
    assert pages["frames"]._ready is None, "frames that are not wanted are closed"


def test_marks_of_assumed_values_are_held_too() -> None:
    path = "optics.f_number"
    found = replace(preset("bench"), marks=Marks.of({path: "assumed"}))
    project, reported = Project(ProjectState(camera=found)), list[str]()
    project.hold(Hold(HELD, ("camera",), report=reported.append))
    assert not project.update("confirm", camera=confirmed(found, [path])) and reported == [HELD]
    assert project.state.camera.marks == found.marks


def test_what_is_refused_is_not_called_done(held: MainWindow, qtbot: QtBot) -> None:
    """A point of Accuracy, a stage that was measured, a lattice, a sensor: each said that it had been taken."""
    context: Context = held.context
    plan = context.state.plan
    assert plan is not None
    held.go("acquire")
    setup: Any = held.page("acquire").setup  # type: ignore[attr-defined]
    turned = replace(plan, stage=plan.stage.__class__("-x", "+y", "+z"))
    assert setup.measuring._take("stage axes as measured", turned) == ""
    held.go("setup")
    camera: Any = held.page("setup")
    camera.measure_sensor()
    taken = preset("r29")
    assert not camera.dialog._take_over(taken, "measured sensor")
    camera.dialog.close()
    assert context.state.plan == plan and context.state.camera == plan.camera
