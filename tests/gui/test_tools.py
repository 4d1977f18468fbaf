"""Welcome, sample session, verify, doctor, preferences."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import QSettings
from PySide6.QtWidgets import QApplication, QMessageBox
from pytestqt.qtbot import QtBot

from lfcal.acquire.recording.recording_file import RecordingFile
from lfcal.acquire.session import record
from lfcal.base.threads import WORKERS
from lfcal.psf import PSFMatrix, save
from lfcal_gui._welcome import iter_demo
from lfcal_gui.models.manual import doctor_html, doctor_text
from lfcal_gui.preferences import apply_threads, welcome_wanted
from lfcal_gui.theme import DARK, LIGHT, current_theme
from lfcal_gui.window import MainWindow
from tests.acquire.rigs import CAREFUL, rig_for, small_plan
from tests.gui.waiting import GUARD_MS, idle

PLAN = small_plan((3, 4), 2)


def test_a_session_and_its_damage_are_found_and_sent_to_acquire(
    window: MainWindow, qtbot: QtBot, tmp_path: Path
) -> None:
    folder = tmp_path / "session"
    record(folder, PLAN, rig_for(PLAN), CAREFUL)
    window.project.update("session", camera=PLAN.camera, plan=PLAN, recording=str(folder))
    dialog = window.tools.verify()
    assert dialog.path.text() == str(folder), "what the project has is offered"
    dialog.start.click()
    idle(window.jobs, qtbot)
    assert dialog.found.toPlainText() == "This session is intact in 24 of 24 frames."
    assert not dialog.again.isVisible()
    damage(folder / "recording.h5")
    dialog.check()
    idle(window.jobs, qtbot)
    assert (
        "What remains is intact in 23 of 24 frames." in dialog.found.toPlainText()
        and "frame damaged" in dialog.found.toPlainText()
    )
    dialog.again.click()
    assert len(window.project.state.redo) == 1
    assert window.shown.spec.key == "acquire"


def damage(path: Path) -> None:
    """Change a byte in the middle of the first frame."""
    with RecordingFile(path) as file:
        first = bytes(np.asarray(file.read(0)).tobytes())
    data = bytearray(path.read_bytes())
    place = data.find(first)
    assert place > 0
    data[place + len(first) // 2] ^= 0xFF
    path.write_bytes(bytes(data))


def test_an_h_file_is_verified_and_what_is_none_is_told(window: MainWindow, qtbot: QtBot, tmp_path: Path) -> None:
    good = save(PSFMatrix(np.random.default_rng(0).random((2, 3, 4, 9, 11), np.float32)), tmp_path / "H.h5")
    dialog = window.tools.verify()
    assert not dialog.start.isEnabled(), "there is nothing to check yet"
    for path, words in ((good, "intact in 2 of 2 planes"), (tmp_path / "none.h5", "none.h5"), (tmp_path, "session")):
        dialog.path.setText(str(path))
        dialog.check()
        idle(window.jobs, qtbot)
        assert words in dialog.found.toPlainText()
        assert dialog.start.isEnabled() and not dialog.stop.isEnabled()


def test_what_was_found_in_one_place_is_not_sent_for_another(window: MainWindow, qtbot: QtBot, tmp_path: Path) -> None:
    for name in ("copy", "own"):
        record(tmp_path / name, PLAN, rig_for(PLAN), CAREFUL)
    damage(tmp_path / "copy" / "recording.h5")
    own = str(tmp_path / "own")
    window.project.update("session", camera=PLAN.camera, plan=PLAN, recording=own)
    dialog = window.tools.verify()
    dialog.path.setText(str(tmp_path / "copy"))
    dialog.check()
    assert dialog.path.isReadOnly() and not any(one.isEnabled() for one in dialog.choosers)
    idle(window.jobs, qtbot)
    assert "frame damaged" in dialog.found.toPlainText() and dialog.again.isVisible() and not dialog.again.isEnabled()
    assert not dialog.path.isReadOnly()
    dialog.path.setText(own)
    assert dialog.found.toPlainText() == "" and not dialog.again.isVisible()


def test_long_texts_fit_the_smallest_window(window: MainWindow) -> None:
    """They scroll in dialogs that were 620 px high."""
    window.show_manual("faults.md")
    for dialog in (window.tools.doctor(), window._manual):
        assert dialog is not None and dialog.width() <= 1000 and dialog.height() <= 600
        dialog.close()


def test_the_doctor_tells_what_is_there_and_why_not(window: MainWindow, qtbot: QtBot) -> None:
    dialog = window.tools.doctor()
    idle(window.jobs, qtbot)
    shown = dialog.view.toPlainText()
    assert "numpy" in shown and "numba cache" in shown and "simulated camera and stage" in shown
    dialog.copy.click()
    assert "This machine\n  lfcal: " in QApplication.clipboard().text()
    odd: dict[str, Any] = {
        "machine": {"a": "<b>"},
        "libraries": {"gone": None},
        "devices": [{"name": "x", "title": "", "version": "", "reason": "no <driver>"}],
        "plugins": [],
    }
    assert "&lt;driver&gt;" in doctor_html(odd) and "Plug-ins" not in doctor_html(odd)
    assert "  gone: absent" in doctor_text(odd) and "x: absent: no <driver>" in doctor_text(odd)


def test_preferences_are_kept_and_reset(window: MainWindow, monkeypatch: pytest.MonkeyPatch) -> None:
    new = window.size()
    dialog = window.tools.preferences()
    dialog.theme.setCurrentIndex(dialog.theme.findData("dark"))
    assert current_theme() is DARK
    dialog.threads.setValue(1)
    dialog.welcome.setChecked(False)
    kept = QSettings(window.settings.fileName(), QSettings.Format.IniFormat)
    window.settings.sync()
    kept.sync()
    assert (kept.value("theme"), kept.value("threads", 0, type=int), welcome_wanted(kept)) == ("dark", 1, False)
    monkeypatch.delenv(WORKERS, raising=False)
    apply_threads(kept)
    assert os.environ[WORKERS] == "1"
    monkeypatch.setenv(WORKERS, "3")
    apply_threads(kept)
    assert os.environ[WORKERS] == "3", "what the environment says counts"
    window.resize(1500, 900)
    window.log_dock.show()
    dialog.reset.click()
    assert current_theme() is LIGHT and dialog.threads.value() == 0 and dialog.welcome.isChecked()
    assert window.size() == new and window.log_dock.isHidden()
    assert welcome_wanted(window.settings)


@pytest.mark.parametrize(("before", "height", "apart"), [(600, 600, True), (800, 800, False), (800, 600, True)])
def test_the_log_shows_several_lines_in_a_window_of_any_height(
    window: MainWindow, qtbot: QtBot, before: int, height: int, apart: bool
) -> None:
    """A window that was made lower showed half a line."""
    window.resize(1000, before)
    window.log_dock.toggleViewAction().trigger()
    qtbot.waitUntil(window.log_view.isVisible, timeout=GUARD_MS)
    window.resize(1000, height)
    QApplication.processEvents()
    assert window.log_dock.isFloating() == apart
    assert window.log_view.viewport().height() >= 3 * window.log_view.fontMetrics().height()


def test_the_first_start_is_welcomed_until_it_is_not_wanted(window: MainWindow, qtbot: QtBot, tmp_path: Path) -> None:
    window.project.save(tmp_path / "mine.lfcal")
    window.files.recent.add(tmp_path / "mine.lfcal")
    window.tools.begin()
    dialog: Any = window.tools.dialog
    assert dialog.isVisible() and dialog.list.count() == 1
    dialog.box.setChecked(False)
    dialog.list.itemActivated.emit(dialog.list.item(0))
    idle(window.jobs, qtbot)
    assert window.project.path == tmp_path / "mine.lfcal"
    window.tools.dialog = None
    window.tools.begin()
    assert window.tools.dialog is None


def test_the_sample_session_opens_with_h(
    window: MainWindow, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch, place: Path
) -> None:
    monkeypatch.setattr(QMessageBox, "question", lambda *_: QMessageBox.StandardButton.Discard)
    window.project.update("something", name="unsaved")
    window.tools.welcome().buttons["sample"].click()
    assert any(job.title == "Open the sample session" for job in window.jobs.jobs())
    idle(window.jobs, qtbot)
    assert window.project.state.name == "sample" and Path(window.project.state.psf).is_relative_to(place)
    assert window.shown.spec.key == "h"
    qtbot.waitUntil(lambda: window.context.matrix(window.project.state.psf) is not None, timeout=GUARD_MS)
    assert list(iter_demo(place / "demo")) == [], "the second time it is there"
