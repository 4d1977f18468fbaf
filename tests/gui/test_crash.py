"""Unexpected errors are logged and shown once, and do not end the window."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from lfcal_gui.app import safe_now
from lfcal_gui.crash_dialog import CrashDialog, CrashGuard
from lfcal_gui.log import FAULTS, NAME, Log, log_folder
from lfcal_gui.models.mishaps import Mishap
from lfcal_gui.window import MainWindow
from tests.gui.layout import flaws
from tests.gui.waiting import GUARD_MS


@pytest.fixture
def log(tmp_path: Path) -> Iterator[Log]:
    made = Log(tmp_path / "logs", faults=False)
    yield made
    made.close()


@pytest.fixture
def guard(window: MainWindow, log: Log) -> Iterator[CrashGuard]:
    made = CrashGuard(window, log.path, lambda: safe_now(window))
    made.install()
    yield made
    made.close()


def break_a_slot(guard: CrashGuard, error: BaseException) -> None:
    """Raise an error and call the hook of Python, as PySide6 does for a slot."""
    try:
        raise error
    except type(error):
        sys.excepthook(*sys.exc_info())  # type: ignore[arg-type]


def test_an_error_in_a_slot_is_shown_with_what_is_safe(window: MainWindow, log: Log) -> None:
    before = sys.excepthook, threading.excepthook
    guard = CrashGuard(window, log.path, lambda: safe_now(window))
    guard.install()
    assert sys.excepthook != before[0]
    break_a_slot(guard, KeyboardInterrupt())
    guard.show_raised()
    assert guard.dialog is None, "an interrupt is no error"
    window.project.update("rename", name="precious")
    break_a_slot(guard, KeyError("H"))
    guard.show_raised()
    assert guard.dialog is not None and guard.dialog.isVisible() and not guard.dialog.isModal()
    assert guard.dialog.words.text() == "KeyError: 'H'"
    copy = window.files.rescue.file
    assert str(copy) in guard.dialog.safe.text() and "precious" in copy.read_text()
    assert log.path is not None and str(log.path) in guard.dialog.where.text()
    guard.dialog.copy_text()
    assert "break_a_slot" in QApplication.clipboard().text() and "lfcal 0" in QApplication.clipboard().text()
    assert "break_a_slot" in log.path.read_text()
    window.go("setup")
    assert window.shown is window.page("setup"), "the window stays usable"
    guard.close()
    assert (sys.excepthook, threading.excepthook) == before


def test_repeated_errors_are_shown_and_logged_once(window: MainWindow, guard: CrashGuard, log: Log) -> None:
    for _ in range(100):
        break_a_slot(guard, RuntimeError("each time"))
    guard.show_raised()
    dialogs = [w for w in QApplication.topLevelWidgets() if isinstance(w, CrashDialog) and w.parent() is window]
    assert len(dialogs) == 1 and "(100 times)" in dialogs[0].words.text()
    assert log.path is not None and log.path.read_text().count("Traceback") == 1, "the log has it once"
    dialogs[0].close()
    break_a_slot(guard, RuntimeError("each time"))
    guard.show_raised()
    assert not dialogs[0].isVisible(), "it was shown before"
    break_a_slot(guard, OSError("another"))
    guard.show_raised()
    assert dialogs[0].isVisible() and "another" in dialogs[0].words.text()
    assert len([w for w in QApplication.topLevelWidgets() if isinstance(w, CrashDialog) and w.parent() is window]) == 1


def test_details_have_room_on_every_screen(qapp: QApplication, qtbot: QtBot) -> None:
    """Their lines were cut, and on a low screen the buttons lay over them."""
    dialog = CrashDialog(Path("/var/log/lfcal/lfcal.log"))
    qtbot.addWidget(dialog)
    trace = "\n".join(f'  File "lfcal/module.py", line {k}, in a_function_with_a_long_name' for k in range(6))
    mishap = Mishap("ValueError: no light", trace, "MainThread", ("ValueError",))
    dialog.show_mishaps([mishap] * 2, ["Your work is safe, in a sentence that is as long as a line. " * 3] * 3)
    narrow = dialog.width()
    for on in (True, False, True):
        dialog.more.setChecked(on)
        qapp.processEvents()
        assert not flaws(dialog) and dialog.details.isVisible() is on
    assert dialog.width() > narrow


def test_an_error_of_a_thread_is_shown_by_the_thread_of_the_window(guard: CrashGuard, qtbot: QtBot) -> None:
    thread = threading.Thread(target=lambda: [][1], name="thread of a test")
    thread.start()
    thread.join()
    assert guard.dialog is None, "other threads do not use Qt"
    qtbot.waitUntil(lambda: guard.dialog is not None, timeout=GUARD_MS)
    assert guard.dialog is not None
    assert "IndexError" in guard.dialog.words.text() and "thread of a test" in guard.dialog.text()


def test_logs_rotate_and_begin_with_version_and_system(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfcal_gui.log.MAX_BYTES", 2000)
    log = Log(tmp_path, faults=False)
    from lfcal_gui.workers import LOG

    for k in range(200):
        LOG.info("line %d", k)
    log.close()
    files = sorted(tmp_path.glob(f"{NAME}*"))
    assert len(files) == 6
    for file in files:
        assert file.read_text().startswith("# lfcal 0") and "Python 3" in file.read_text().splitlines()[0]
        assert file.stat().st_size < 3000
    assert "line 199" in (tmp_path / NAME).read_text()
    LOG.info("after")
    assert "after" not in (tmp_path / NAME).read_text()


def test_the_log_is_in_the_folder_of_the_system_or_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert log_folder().name in ("log", "lfcal", "Logs") and not list(tmp_path.iterdir())
    (tmp_path / "file").write_text("")
    log = Log(tmp_path / "file" / "logs", faults=False)
    assert log.path is None and "no log" in log.problem, "the window starts all the same"
    log.close()


KILLED = """
import faulthandler, sys
from pathlib import Path
from lfcal_gui.log import Log
log = Log(Path(sys.argv[1]))
faulthandler._sigabrt()
"""


def test_a_crash_of_the_process_is_logged_with_its_traceback(tmp_path: Path) -> None:
    root = Path(__file__).resolve().parents[2]
    done = subprocess.run(
        [sys.executable, "-c", KILLED, str(tmp_path)],
        env={**os.environ, "PYTHONPATH": str(root)},
        capture_output=True,
        check=False,
    )
    assert done.returncode != 0
    assert "Aborted" in (tmp_path / FAULTS).read_text() and (tmp_path / NAME).read_text().startswith("# lfcal")
