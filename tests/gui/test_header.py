"""The line of the next step: it leads through a whole sitting, and its button does not change under the pointer."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import pytest
from PySide6.QtCore import QPoint, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QFileDialog, QPushButton
from pytestqt.qtbot import QtBot

from lfcal.base import Clock
from lfcal.psf import open_psf
from lfcal.simulate import sample_session
from lfcal_gui._header import HELD_S, NEAR_S, NextLine
from lfcal_gui.models import Step
from lfcal_gui.window import MainWindow
from tests.gui.waiting import GUARD_MS, idle, page_of

PAUSE = Step("Recording", "plane 1 of 2.", "Pause", "acquire.pause", "record", stop="acquire.stop")
MAKE = Step("Next", "make H.", "Assemble H", "acquire.assemble", "record")
WHITE = Step("Next", "check the camera.", "White image …", "setup.white", "setup", optional=True)


@pytest.fixture
def line(qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> NextLine:
    """Return a line with the pointer far away."""
    made = NextLine()
    qtbot.addWidget(made)
    made.resize(900, 54)
    made.show()
    monkeypatch.setattr(NextLine, "pointer", staticmethod(lambda: QPoint(-9999, -9999)))
    return made


def later(line: NextLine) -> None:
    """Pretend that the last change was long ago."""
    line._changed -= HELD_S


def test_the_button_stays_while_the_pointer_is_near_it(
    line: NextLine, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    pressed: list[str] = []
    line.pressed.connect(pressed.append)
    line.show_step(PAUSE)
    assert (line.lead.text(), line.words.text(), line.button.text()) == ("Recording:", "plane 1 of 2.", "Pause")
    assert line.stop.isVisible()
    line.show_step(MAKE)
    assert line.button.text() == "Pause" and line.words.text() == "plane 1 of 2.", "it stays for a while after a change"
    qtbot.waitUntil(lambda: line.button.text() == "Assemble H", timeout=GUARD_MS)
    assert line.words.text() == "make H."
    line.show_step(PAUSE)
    qtbot.waitUntil(lambda: line.button.text() == "Pause", timeout=GUARD_MS)
    later(line)
    at = line.button.mapToGlobal(QPoint(-23, 5))
    monkeypatch.setattr(NextLine, "pointer", staticmethod(lambda: at))
    line.show_step(MAKE)
    later(line)
    assert line.words.text() == "plane 1 of 2." and line.button.text() == "Pause" and line.stop.isVisible()
    assert line.lead.text() == "Recording:" and line.accessibleName() == PAUSE.line
    line.show_step(replace(PAUSE, words="plane 2 of 2."))
    assert line.words.text() == "plane 2 of 2.", "a step with the same buttons is shown at once"
    line.show_step(MAKE)
    QTest.mouseClick(line.button, Qt.MouseButton.LeftButton)
    assert pressed == ["acquire.pause"], "what the label said"
    at = line.button.mapToGlobal(QPoint(5, -25))
    qtbot.waitUntil(lambda: line.button.text() == "Assemble H", timeout=GUARD_MS)
    assert not line.stop.isVisible() and line.words.text() == "make H." and line.accessibleName() == MAKE.line
    QTest.keyClick(line, Qt.Key.Key_Return, Qt.KeyboardModifier.ControlModifier)
    assert pressed == ["acquire.pause", "acquire.assemble"]


def test_a_pointer_that_rests_at_the_button_does_not_hide_the_next_step(
    line: NextLine, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    line.show_step(PAUSE)
    later(line)
    at = line.button.mapToGlobal(QPoint(5, 5))
    monkeypatch.setattr(NextLine, "pointer", staticmethod(lambda: at))
    line.show_step(MAKE)
    assert line.button.text() == "Pause"
    line._due -= NEAR_S
    qtbot.waitUntil(lambda: line.button.text() == "Assemble H", timeout=GUARD_MS)
    assert line.words.text() == "make H."


def test_an_optional_step_is_pressed_or_left_out_by_del(line: NextLine) -> None:
    pressed: list[str] = []
    declined: list[tuple[str, str]] = []
    line.pressed.connect(pressed.append)
    line.declined.connect(lambda *said: declined.append(said))
    line.show_step(MAKE)
    line.button.setFocus()
    QTest.keyClick(line.button, Qt.Key.Key_Delete)
    assert not declined and not line.not_now.isEnabled(), "this step is not optional"
    later(line)
    line.show_step(WHITE)
    QTest.keyClick(line.button, Qt.Key.Key_Delete)
    assert declined == [("setup.white", "setup")]
    later(line)
    line.show_step(replace(MAKE, other=WHITE))
    QTest.mouseClick(line.other, Qt.MouseButton.LeftButton)
    QTest.mouseClick(line.button, Qt.MouseButton.LeftButton)
    QTest.keyClick(line.button, Qt.Key.Key_Delete)
    assert pressed == ["setup.white", "acquire.assemble"] and declined == [("setup.white", "setup")] * 2
    later(line)
    line.show_step(MAKE)
    assert not line.other.isVisible() and line.button.text() == "Assemble H"


# -- through the window ------------------------------------------------------------------------------------


# -- through the window ------------------------------------------------------------------------------------
def leads_to(window: MainWindow, qtbot: QtBot, button: str) -> None:
    """Wait until the button has this label."""
    line = window.next_line
    qtbot.waitUntil(lambda: line.button.text() == button and line.step is not None, timeout=GUARD_MS)


def follow(window: MainWindow, button: str, qtbot: QtBot) -> None:
    """Press the button once it has this label."""
    leads_to(window, qtbot, button)
    QTest.mouseClick(window.next_line.button, Qt.MouseButton.LeftButton)


def only_primary(window: MainWindow) -> bool:
    """Return whether the window has one primary button that is seen."""
    buttons = window.findChildren(QPushButton)
    seen = [one for one in buttons if one.property("role") == "primary" and one.isVisible() and one.window() is window]
    return seen == [window.next_line.button]


@pytest.fixture
def answers(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Return a function that says which file the next dialog returns."""

    def answer(path: str) -> None:
        for name in ("getSaveFileName", "getOpenFileName"):
            monkeypatch.setattr(QFileDialog, name, lambda *_, path=path, **__: (path, ""))
        monkeypatch.setattr(QFileDialog, "getExistingDirectory", lambda *_, **__: path)

    return answer


def test_the_next_button_leads_from_a_folder_of_frames_to_an_exported_h(
    window: MainWindow, qtbot: QtBot, tmp_path: Path, answers: Callable[[str], None]
) -> None:
    shutil.copytree(sample_session(), tmp_path / "theirs")
    window.go("frames")
    answers(str(tmp_path / "theirs"))
    follow(window, "Import folder …", qtbot)
    qtbot.waitUntil(lambda: "frames, " in window.next_line.words.text(), timeout=GUARD_MS)
    assert window.next_line.words.text().startswith("assemble H from 1,254 frames, ")
    follow(window, "Assemble H", qtbot)
    qtbot.waitUntil(lambda: window.shown.spec.key == "h", timeout=GUARD_MS)
    assert (tmp_path / "theirs" / "H.h5").exists(), "named without a question"
    leads_to(window, qtbot, "Export as .mat")
    assert window.leading.sitting.verdict is not None, "H was judged without being asked for"
    assert window.rail.word("h") == "✓ good" and "H is good" in window.next_line.words.text() and only_primary(window)
    answers(str(tmp_path / "H.mat"))
    follow(window, "Export as .mat", qtbot)
    leads_to(window, qtbot, "Show folder")
    with h5py.File(tmp_path / "H.mat") as file, open_psf(tmp_path / "theirs" / "H.h5") as H:
        assert {"H", "Ht"} <= set(file) and file["H"].size == file["Ht"].size == H.size
    assert window.next_line.words.text().startswith("H is exported to H.mat") and only_primary(window)
    assert window.next_line.lead.text() == "Done:" and window.rail.word("use") == "✓ exported"
    idle(window.jobs, qtbot)


def test_every_action_of_a_step_exists(window: MainWindow) -> None:
    from tests.gui.models.test_next_step import TABLE

    pages = {spec.key: set(window.page(spec.key).deeds()) for spec in window.specs}
    known = {f"{page}.{deed}" for page, deeds in pages.items() for deed in deeds} | set(window.leading.own)
    actions = {action for _, _, action, _ in TABLE if not action.startswith("jobs.")}
    assert {*actions, "acquire.stop"} <= known


def test_the_project_keeps_that_a_step_was_left_out(window: MainWindow, qtbot: QtBot) -> None:
    page = page_of(window, "setup")
    page._set(window.context.state.camera, "preset bench")
    leads_to(window, qtbot, "Plan the scan")
    assert window.next_line.other.isVisible() and window.next_line.other.text() == "White image …"
    window.next_line.button.setFocus()
    QTest.keyClick(window.next_line.button, Qt.Key.Key_Delete)
    qtbot.waitUntil(lambda: not window.next_line.other.isVisible(), timeout=GUARD_MS)
    QTest.keyClick(window, Qt.Key.Key_Return, Qt.KeyboardModifier.ControlModifier)
    leads_to(window, qtbot, "Use the simulated rig")
    assert window.context.state.plan is not None and "setup.white" in window.context.state.settings["declined"]


def test_a_new_h_is_shown_unless_the_user_works_elsewhere(window: MainWindow, qtbot: QtBot) -> None:
    for clicked in (False, True):
        begun, end = threading.Event(), threading.Event()

        def work(begun: threading.Event = begun, end: threading.Event = end) -> Any:
            yield Clock("assemble", 1).at(0)
            begun.set()
            end.wait(GUARD_MS / 1e3)

        window.go("setup")
        window.jobs.start("Assemble", "frames", work, lambda _: window.context.made.emit("h", None))
        qtbot.waitUntil(begun.is_set, timeout=GUARD_MS)
        if clicked:
            QTest.mouseClick(window.shown, Qt.MouseButton.LeftButton)
        end.set()
        idle(window.jobs, qtbot)
        assert (window.shown.spec.key == "setup") == clicked
