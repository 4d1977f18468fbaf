"""Tools of the window: the welcome and the sample, verifying files, doctor, preferences, log and manual."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import QSettings, QUrl
from PySide6.QtGui import QTextDocument
from PySide6.QtWidgets import QApplication, QMessageBox
from pytestqt.qtbot import QtBot

import lfcal_gui._help
from lfcal.acquire.recording.recording_file import RecordingFile
from lfcal.acquire.session import record
from lfcal.base.errors import StorageError
from lfcal.base.threads import WORKERS
from lfcal.psf import PSFMatrix, save
from lfcal_gui._welcome import iter_demo
from lfcal_gui.app import begin, make_window, parse
from lfcal_gui.models.manual import doctor_html, doctor_text
from lfcal_gui.preferences import apply_threads, welcome_wanted
from lfcal_gui.theme import DARK, LIGHT, current_theme
from lfcal_gui.window import MainWindow
from tests.acquire.rigs import CAREFUL, rig_for, small_plan
from tests.gui.waiting import GUARD_MS, idle


def damage(path: Path) -> None:
    """Change a byte in the middle of the first frame."""
    with RecordingFile(path) as file:
        first = bytes(np.asarray(file.read(0)).tobytes())
    data = bytearray(path.read_bytes())
    place = data.find(first)
    assert place > 0
    data[place + len(first) // 2] ^= 0xFF
    path.write_bytes(bytes(data))


def test_files_of_h_are_verified_and_others_refused(window: MainWindow, qtbot: QtBot, tmp_path: Path) -> None:
    good = save(PSFMatrix(np.random.default_rng(0).random((2, 3, 4, 9, 11), np.float32)), tmp_path / "H.h5")
    dialog = window.tools.verify()
    assert not dialog.start.isEnabled(), "no file was chosen"
    for path, words in ((good, "intact in 2 of 2 planes"), (tmp_path / "none.h5", "none.h5"), (tmp_path, "session")):
        dialog.path.setText(str(path))
        dialog.check()
        idle(window.jobs, qtbot)
        assert words in dialog.found.toPlainText()
        assert dialog.start.isEnabled() and not dialog.stop.isEnabled()


def test_the_doctor_lists_what_is_there_and_why_something_is_not(window: MainWindow, qtbot: QtBot) -> None:
    dialog = window.tools.doctor()
    assert dialog.width() <= 1000 and dialog.height() <= 600, "it fits the smallest window"
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
    assert os.environ[WORKERS] == "3", "the environment takes precedence"
    window.resize(1500, 900)
    window.log_dock.show()
    dialog.reset.click()
    assert current_theme() is LIGHT and dialog.threads.value() == 0 and dialog.welcome.isChecked()
    assert window.size() == new and window.log_dock.isHidden()
    assert welcome_wanted(window.settings)


def test_the_welcome_is_shown_until_it_is_not_wanted(window: MainWindow, qtbot: QtBot, tmp_path: Path) -> None:
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


def test_damaged_frames_of_a_session_are_found_and_sent_to_acquire(
    window: MainWindow, qtbot: QtBot, tmp_path: Path
) -> None:
    plan, own, copy = small_plan((3, 4), 2), tmp_path / "own", tmp_path / "copy"
    record(own, plan, rig_for(plan), CAREFUL)
    shutil.copytree(own, copy)
    damage(copy / "recording.h5")
    window.project.update("session", camera=plan.camera, plan=plan, recording=str(own))
    dialog = window.tools.verify()
    assert dialog.path.text() == str(own), "the session of the project is offered"
    dialog.start.click()
    idle(window.jobs, qtbot)
    assert dialog.found.toPlainText() == "This session is intact in 24 of 24 frames."
    assert not dialog.again.isVisible()
    dialog.path.setText(str(copy))
    dialog.check()
    assert dialog.path.isReadOnly() and not any(one.isEnabled() for one in dialog.choosers)
    idle(window.jobs, qtbot)
    assert "What remains is intact in 23 of 24 frames." in dialog.found.toPlainText()
    assert "frame damaged" in dialog.found.toPlainText() and not dialog.path.isReadOnly()
    assert dialog.again.isVisible() and not dialog.again.isEnabled(), "it is not the session of the project"
    dialog.path.setText(str(own))
    assert dialog.found.toPlainText() == "" and not dialog.again.isVisible()
    damage(own / "recording.h5")
    dialog.check()
    idle(window.jobs, qtbot)
    dialog.again.click()
    assert len(window.project.state.redo) == 1 and window.shown.spec.key == "acquire"


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


def test_the_sample_is_assembled_in_the_background(qapp: QApplication, qtbot: QtBot, place: Path) -> None:
    """``--demo`` showed no window until H was assembled."""
    options = parse(["--demo"])
    window = make_window(qapp, options, folder=place)
    window.show()
    assert window.isVisible() and not (place / "demo").exists() and window.project.state.name != "sample"
    begin(window, options)
    assert [job.page for job in window.jobs.jobs() if job.active] == ["sample"]
    idle(window.jobs, qtbot)
    psf = window.project.state.psf
    assert window.project.state.name == "sample" and Path(psf).is_file() and Path(psf).is_relative_to(place)
    assert window.shown.spec.key == "h"
    qtbot.waitUntil(lambda: window.context.matrix(psf) is not None, timeout=GUARD_MS)
    assert list(iter_demo(place / "demo")) == [], "the second time it is there"
    window.shut_down()
    window.close()
    window.deleteLater()


def test_the_welcome_opens_the_sample(window: MainWindow, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(QMessageBox, "question", lambda *_: QMessageBox.StandardButton.Discard)
    window.project.update("something", name="unsaved")
    window.tools.welcome().buttons["sample"].click()
    (job,) = (job for job in window.jobs.jobs() if job.title == "Open the sample session")
    window.jobs.cancel(job.number)
    idle(window.jobs, qtbot)
    assert window.project.state.name == "unsaved"


# -- the manual --------------------------------------------------------------------------------------------


def test_the_manual_shows_a_section_and_follows_links(window: MainWindow, monkeypatch: pytest.MonkeyPatch) -> None:
    window.context.help_asked.emit("faults.md", "ghost")
    manual = window._manual
    assert manual is not None and manual.isVisible() and manual.windowTitle() == "Manual: Ghost image"
    assert manual.width() <= 1000 and manual.height() <= 600, "it fits the smallest window"
    text = manual.browser.toPlainText()
    assert "Ghost image" in text and "What to do" in text and "Hot line" not in text
    picture = manual.browser.loadResource(
        QTextDocument.ResourceType.ImageResource.value, QUrl("images/faults/ghost.png")
    )
    assert picture
    manual.whole.click()
    assert "Hot line" in manual.browser.toPlainText() and not manual.whole.isEnabled()
    manual._follow(QUrl("quality.md"))
    assert "Hot line of the sensor" not in manual.windowTitle() and manual._page == "quality.md"
    # links lead into folders and back
    manual._follow(QUrl("tutorials/bad_psf.md"))
    assert manual._page == "tutorials/bad_psf.md" and "PSF" in manual.windowTitle()
    manual._follow(QUrl("../faults.md#ghost"))
    assert manual._page == "faults.md"
    manual._follow(QUrl("../README.md"))
    manual._follow(QUrl("nosuch.md"))
    assert manual._page == "faults.md", "only pages of the manual are shown"
    manual.close()

    def gone() -> None:
        raise StorageError("the manual: not part of this installation")

    monkeypatch.setattr(lfcal_gui._help, "manual_folder", gone)
    window.show_manual("faults.md")
    assert "not part of this installation" in window.log_view.toPlainText()
