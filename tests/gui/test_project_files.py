"""Project files and copies of unsaved work: after a crash, in two windows, and when the window closes."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from PySide6.QtWidgets import QApplication, QFileDialog, QMessageBox
from pytestqt.qtbot import QtBot

from lfcal.base.progress import Progress, Work
from lfcal_gui import app
from lfcal_gui._project_files import stop_words
from lfcal_gui.app import make_window, parse
from lfcal_gui.locks import FileLock
from lfcal_gui.models.autosave import keep
from lfcal_gui.models.project import Project, ProjectState, read_project
from lfcal_gui.saving import ask_target, may_replace, with_suffix
from lfcal_gui.window import MainWindow
from tests.gui.waiting import GUARD_MS, idle

ROOT = Path(__file__).resolve().parents[2]
BUTTONS = QMessageBox.StandardButton
KILLED = """
import os, signal, sys
from pathlib import Path
from PySide6.QtWidgets import QApplication
from lfcal_gui.app import make_window, parse
app = QApplication([])
window = make_window(app, parse([]), folder=Path(sys.argv[1]))
window.project.save(Path(sys.argv[2]))
assert window.files.save()
window.project.update("rename", name="work of a day")
window.files.rescue.keep()
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.fixture
def second(qapp: QApplication, place: Path) -> Iterator[MainWindow]:
    """Return another window of the same user."""
    made = make_window(qapp, parse([]), folder=place)
    yield made
    made.shut_down()
    made.deleteLater()


@pytest.fixture
def boxes(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return what warning boxes said; questions are answered by No."""
    shown: list[str] = []
    monkeypatch.setattr(QMessageBox, "warning", lambda *args: shown.append(args[2]))
    monkeypatch.setattr(QMessageBox, "question", lambda *args: shown.append(args[2]) or BUTTONS.No)
    return shown


# -- after a crash -----------------------------------------------------------------------------------------
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no such signal here")
def test_after_a_kill_the_work_is_offered_and_restored(
    window: MainWindow, place: Path, tmp_path: Path, qtbot: QtBot
) -> None:
    own = tmp_path / "p.lfcal"
    done = subprocess.run(
        [sys.executable, "-c", KILLED, str(place), str(own)],
        env={**os.environ, "PYTHONPATH": str(ROOT), "QT_QPA_PLATFORM": "offscreen"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == -signal.SIGKILL, done.stderr
    window.files.begin()
    idle(window.jobs, qtbot)
    dialog = window.files.rescue.dialog
    assert dialog is not None and dialog.isVisible() and str(own) in dialog.words.text()
    assert window.project.state.name == "untitled", "nothing happens before the answer"
    dialog.restore.click()
    assert window.project.state.name == "work of a day" and window.project.unsaved and window.project.path == own
    copies = list((place / "autosave").glob("*.lfcal"))
    assert copies == [window.files.rescue.file], "the copy is this window's now"
    assert window.files.save() and not list((place / "autosave").iterdir())
    other = Project()
    other.open(own)
    assert other.state.name == "work of a day"


def test_copies_of_closed_windows_are_offered_kept_and_discarded(
    window: MainWindow, place: Path, tmp_path: Path, qtbot: QtBot, boxes: list[str]
) -> None:
    rescue, own, damaged = window.files.rescue, tmp_path / "own.lfcal", tmp_path / "damaged.lfcal"
    Project(ProjectState("own")).save(own)

    def left_behind(name: str, path: Path | None = None) -> Path:
        project, file = Project(ProjectState(), path), place / "autosave" / f"{name}.lfcal"
        project.update("rename", name=name)
        keep(project, file)
        return file

    def offered(asked: bool = True) -> Any:
        rescue.look(asked=asked)
        idle(window.jobs, qtbot)
        return rescue.dialog

    file = left_behind("another")
    window.files.begin(own)
    idle(window.jobs, qtbot)
    assert rescue.dialog is None and window.project.state.name == "own", "it belongs to another project"
    assert "unsaved work of another project" in window.log_view.toPlainText()
    dialog = offered()
    assert dialog.focusWidget() is dialog.restore, "Space does not discard the work"
    dialog.close()
    assert file.exists() and window.project.state.name == "own"
    offered().discard.click()
    assert not list((place / "autosave").iterdir()) and not boxes
    damaged.write_text("{")
    left_behind("saved by the copy", damaged)
    window.files.begin(damaged)
    idle(window.jobs, qtbot)
    assert len(boxes) == 1
    rescue.dialog.restore.click()
    assert window.project.state.name == "saved by the copy" and window.project.path == damaged


def test_the_work_of_an_open_window_is_not_offered(
    window: MainWindow, second: MainWindow, place: Path, qtbot: QtBot
) -> None:
    window.project.update("rename", name="mine")
    second.project.update("rename", name="yours")
    assert window.files.rescue.keep() != second.files.rescue.keep()
    second.files.begin()
    idle(second.jobs, qtbot)
    assert second.files.rescue.dialog is None
    assert len(list((place / "autosave").glob("*.lfcal"))) == 2


def test_the_copy_is_kept_unless_the_user_closed_the_window(qapp: QApplication, place: Path) -> None:
    for asked in (False, True):
        made = make_window(qapp, parse([]), folder=place)
        made.project.update("rename", name="kept")
        made.files.rescue.keep()
        made.shut_down(asked=asked)
        made.deleteLater()
        left = [path.suffix for path in (place / "autosave").iterdir()]
        assert left == [".lfcal"], "of the first alone, and no locks"


# -- two windows -------------------------------------------------------------------------------------------
def test_a_second_window_gets_a_copy(
    window: MainWindow, second: MainWindow, tmp_path: Path, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch, boxes: Any
) -> None:
    own = tmp_path / "p.lfcal"
    window.project.update("rename", name="shared")
    monkeypatch.setattr(QFileDialog, "getSaveFileName", lambda *_: (str(own), "(*.lfcal)"))
    assert window.files.save()
    asked: list[str] = []

    def answer(box: QMessageBox) -> int:
        asked.append(box.text())
        box.defaultButton().click()
        return 0

    monkeypatch.setattr(QMessageBox, "exec", answer)
    second.files.open(own)
    idle(second.jobs, qtbot)
    assert "p.lfcal is open in another window" in asked[0]
    assert second.project.path is None and second.project.state.name == "p copy" and second.project.unsaved
    before = own.read_text()
    assert not second.files.save_as() and "another window" in boxes[-1]
    assert own.read_text() == before
    window.shut_down(asked=True)
    assert second.files.save_as() and second.project.path == own, "it is free now"


def test_locks_of_dead_processes_are_ignored(tmp_path: Path) -> None:
    code = "import sys; from pathlib import Path; from lfcal_gui.locks import FileLock; import os\n"
    code += "lock = FileLock(Path(sys.argv[1])); assert lock.take(); os._exit(0)"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "p")], env=environment, check=True)
    assert (tmp_path / ".p.window").exists()
    lock, other = FileLock(tmp_path / "p"), FileLock(tmp_path / "p")
    assert lock.take() and not other.take()
    words, away = other.holder()
    assert str(os.getpid()) in words and not away
    lock.release()
    assert other.take()
    other.release()
    assert not list(tmp_path.iterdir())


def test_a_lock_of_another_machine_is_taken_only_on_request(tmp_path: Path) -> None:
    (tmp_path / ".p.window").write_text("12345\nlfcal\nfar-away\n")
    lock = FileLock(tmp_path / "p")
    assert not lock.take() and lock.holder() == ("process 12345 on far-away", True)
    assert lock.take_over()
    lock.release()


def test_windows_does_not_remove_a_lock_that_is_open(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object, **__: object) -> None:
        raise PermissionError("the file is open")

    (tmp_path / ".p.window").write_text("12345\nlfcal\nfar-away\n")
    lock = FileLock(tmp_path / "p")
    monkeypatch.setattr(Path, "unlink", refused)
    assert not lock.take_over() and not lock.take()


def test_the_reason_why_no_window_opens_is_shown(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """On Windows, lfcal-gui has no console: sys.stderr is None there."""
    shown: list[str] = []
    library = SimpleNamespace(user32=SimpleNamespace(MessageBoxW=lambda *words: shown.append(words[1])))
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setattr(ctypes, "windll", library, raising=False)
    monkeypatch.setattr(app, "_lacking", lambda: "PySide6 is not installed")
    assert app.main([]) == 2
    assert capsys.readouterr().err == "lfcal-gui: PySide6 is not installed\n" and not shown
    monkeypatch.setattr(sys, "stderr", None)
    assert app.main([]) == 2
    assert capsys.readouterr().err == "" and shown == ["PySide6 is not installed"]


# -- files are replaced only after a question --------------------------------------------------------------


# -- nothing is replaced unasked ---------------------------------------------------------------------------
def test_a_damaged_project_does_not_replace_the_open_one(
    window: MainWindow, tmp_path: Path, qtbot: QtBot, boxes: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    window.project.update("rename", name="kept")
    monkeypatch.setattr(QMessageBox, "question", lambda *_: BUTTONS.Discard)
    (tmp_path / "bad.lfcal").write_text("nothing")
    window.files.open(tmp_path / "bad.lfcal")
    idle(window.jobs, qtbot)
    assert len(boxes) == 1 and boxes[0].startswith("bad.lfcal: project")
    assert window.project.state.name == "kept"


def test_a_path_on_a_network_share_is_named_and_never_touched(
    window: MainWindow, tmp_path: Path, boxes: list[str], qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    share = "//server/share/H.h5"
    path = tmp_path / "foreign.lfcal"
    path.write_text(ProjectState(name="foreign", psf=share, settings={"frames": {"dark": share}}).to_json())
    touched, stat = [], os.stat

    def noted(name: Any, *args: Any, **more: Any) -> os.stat_result:
        touched.append(str(name))
        return stat(name, *args, **more)

    monkeypatch.setattr(os, "stat", noted)
    window.files.open(path)
    qtbot.waitUntil(lambda: window.project.state.name == "foreign", timeout=GUARD_MS)
    idle(window.jobs, qtbot)
    assert any("psf //server/share/H.h5 and 1 more" in line for line in boxes), boxes
    assert any(str(path) in name for name in touched) and not any("server" in name for name in touched)


def test_a_file_that_changed_on_the_disk_is_asked_about(window: MainWindow, tmp_path: Path, boxes: list[str]) -> None:
    own = tmp_path / "p.lfcal"
    window.project.save(own)
    Project(ProjectState("of another program")).save(own)
    window.project.update("rename", name="mine")
    assert not window.files.save() and "Replace" in boxes[-1]
    assert "of another program" in own.read_text()


def test_names_take_the_suffix_of_the_chosen_kind() -> None:
    for typed, kind, path in (
        ("/a/H", "MATLAB (*.mat)", "/a/H.mat"),
        ("/a/H.h5", "MATLAB (*.mat)", "/a/H.h5"),
        ("/a/H_0.5um", "TIFF (*.tif *.tiff)", "/a/H_0.5um.tif"),
        ("/a/v1.2", "Project (*.lfcal)", "/a/v1.2.lfcal"),
        ("/a/H", "All files (*)", "/a/H"),
        ("/a/plan.json", "Sequence (*.useq.json)", "/a/plan.useq.json"),
        ("/a/plan.useq.json", "Sequence (*.useq.json)", "/a/plan.useq.json"),
        ("/a/plan.json", "Plan (*.json);;Sequence (*.useq.json)", "/a/plan.json"),
    ):
        assert with_suffix(typed, kind) == path, (typed, kind)


def test_a_file_whose_suffix_was_added_is_asked_about(
    window: MainWindow, tmp_path: Path, boxes: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "H.mat").write_text("precious")
    monkeypatch.setattr(QFileDialog, "getSaveFileName", lambda *_: (str(tmp_path / "H"), "MATLAB (*.mat)"))
    assert ask_target(window, "Export", "H.mat", "MATLAB (*.mat);;numpy (*.npy)") == ""
    assert str(tmp_path / "H.mat") in boxes[-1]
    monkeypatch.setattr(QMessageBox, "question", lambda *_: BUTTONS.Yes)
    assert ask_target(window, "Export", "H.mat", "") == str(tmp_path / "H.mat")
    assert may_replace(window, [tmp_path / "new"])


# -- jobs, when another project is opened or the window closes ---------------------------------------------
@pytest.fixture
def go_on() -> Iterator[threading.Event]:
    """Return what ends the work of a test, at the latest after the test."""
    event = threading.Event()
    yield event
    event.set()


@pytest.fixture
def working(go_on: threading.Event) -> Callable[[], Work[None]]:
    """Return work that continues until ``go_on`` is set, or until it is stopped."""

    def work() -> Work[None]:
        while not go_on.wait(0.001):
            yield Progress(0, 1, "work")

    return work


Working = Callable[[], Work[None]]


def test_a_job_continues_until_all_questions_are_answered(
    window: MainWindow, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch, working: Working, go_on: threading.Event
) -> None:
    window.jobs.start("Record", "acquire", working)
    qtbot.waitUntil(lambda: window.jobs.jobs()[0].progress is not None, timeout=GUARD_MS)
    asked: list[tuple[Any, ...]] = []
    # Enter presses the default button
    monkeypatch.setattr(QMessageBox, "question", lambda *said: (asked.append(said), said[-1])[1])
    assert not window.files.may_leave()
    assert asked[0][-1] == BUTTONS.No and "Recorded positions are kept" in asked[0][2]
    window.project.update("rename", name="changed")
    answers = iter((BUTTONS.Yes, BUTTONS.Cancel))
    monkeypatch.setattr(QMessageBox, "question", lambda *_: next(answers))
    assert not window.files.may_leave()
    assert window.jobs.jobs()[0].active and not window.jobs.jobs()[0].stopping
    go_on.set()
    idle(window.jobs, qtbot)
    assert window.jobs.jobs()[0].state.value == "done"


def test_the_question_about_jobs_promises_only_what_each_keeps(
    window: MainWindow, qtbot: QtBot, working: Working, go_on: threading.Event
) -> None:
    window.jobs.start("Search", "multiplex", working, at_once=True)
    assert stop_words(window.jobs).endswith("\n\nStop it?")
    window.jobs.start("Record", "acquire", working, at_once=True)
    assert stop_words(window.jobs).endswith("Stop them? Recorded positions are kept.")
    window.context.start_writing("Assemble", "frames", "H.h5", working)
    assert "Complete planes of an H" in stop_words(window.jobs)
    go_on.set()
    idle(window.jobs, qtbot)


def test_jobs_continue_until_another_project_was_read(
    window: MainWindow,
    qtbot: QtBot,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    boxes: list[str],
    working: Working,
) -> None:
    window.jobs.start("Assemble", "frames", working)
    qtbot.waitUntil(lambda: window.jobs.jobs()[0].progress is not None, timeout=GUARD_MS)
    asked: list[str] = []
    monkeypatch.setattr(QMessageBox, "question", lambda *args: asked.append(args[1]) or BUTTONS.Yes)
    monkeypatch.setattr(QFileDialog, "getOpenFileName", lambda *_: ("", ""))
    window.files.open()
    assert not asked, "no file was chosen"
    (tmp_path / "bad.lfcal").write_text("nothing")
    window.files.open(tmp_path / "bad.lfcal")
    qtbot.waitUntil(lambda: not window.jobs.loading("project"), timeout=GUARD_MS)
    job = window.jobs.jobs()[0]
    assert asked == ["Jobs are running"] and len(boxes) == 1 and job.active and not job.stopping
    Project(ProjectState("good")).save(tmp_path / "good.lfcal")
    window.files.open(tmp_path / "good.lfcal")
    idle(window.jobs, qtbot)
    assert window.project.state.name == "good" and window.jobs.jobs()[0].state.value == "stopped"


def test_changes_made_while_a_project_is_read_are_asked_about(
    window: MainWindow, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, go_on: threading.Event
) -> None:
    own, other = tmp_path / "own.lfcal", tmp_path / "other.lfcal"
    Project(ProjectState("other")).save(other)
    window.project.save(own)
    reads: list[Path] = []

    def slow(path: Path) -> ProjectState:
        reads.append(path)
        go_on.wait(GUARD_MS / 1e3)
        return read_project(path)

    monkeypatch.setattr("lfcal_gui._project_files.read_project", slow)
    answers = iter((BUTTONS.Cancel, BUTTONS.Save))
    monkeypatch.setattr(QMessageBox, "question", lambda *_: next(answers))
    window.files.open(other)
    window.project.update("rename", name="meanwhile")
    go_on.set()
    idle(window.jobs, qtbot)
    assert window.project.state.name == "meanwhile" and window.project.unsaved
    go_on.clear()
    window.project.save(own)
    window.files.open(own)
    window.project.update("rename", name="and more")
    go_on.set()
    idle(window.jobs, qtbot)
    assert window.project.state.name == "and more" == read_project(own).name and not window.project.unsaved
    assert reads == [other, own, own]


def test_closing_does_not_block_the_window(
    window: MainWindow, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch, go_on: threading.Event
) -> None:
    """It was blocked for up to seven seconds while a job stopped, a simulator was connected or a file opened."""
    begun, shown, waits = [threading.Event() for _ in range(4)], list[str](), list[float]()

    def hang(event: threading.Event) -> str:
        event.set()
        go_on.wait(GUARD_MS / 1e3)
        return "device"

    def job(event: threading.Event) -> Work[None]:
        hang(event)
        yield Progress(0, 1, "job")

    window.jobs.compute("connect", partial(hang, begun[0]), shown.append)
    window.jobs.load("file", partial(hang, begun[1]), shown.append)
    window.jobs.start("Fit", "fit", partial(job, begun[2]), leave=True)
    window.jobs.start("Simulate", "simulate", partial(job, begun[3]), at_once=True)
    assert all(event.wait(GUARD_MS / 1e3) for event in begun)
    monkeypatch.setattr(QMessageBox, "question", lambda *_: BUTTONS.Yes)
    for name in ("lfcal_gui.jobs.wait_for", "lfcal_gui.workers.wait_for", "lfcal_gui._background.wait_for"):
        monkeypatch.setattr(name, lambda threads, seconds: waits.append(seconds))
    assert not window.close() and window.isVisible() and sum(waits) == 0
    assert "the window then closes" in window.log_view.toPlainText() and not window.centralWidget().isEnabled()
    assert not window.close(), "it asks only once"
    window.jobs.compute("live view", lambda: "again", shown.append)
    window.jobs.load("another", lambda: "again", shown.append)
    number = window.jobs.start("Late", "fit", partial(job, begun[2]))
    assert not next(one for one in window.jobs.jobs() if one.number == number).active, "nothing begins any more"
    monkeypatch.undo()
    go_on.set()
    qtbot.waitUntil(lambda: not window.isVisible(), timeout=GUARD_MS)
    assert shown == ["device"], "what was connected is handed over, to be released"
    assert not window.jobs.busy


def test_endless_work_does_not_keep_the_window_open(
    window: MainWindow, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch, go_on: threading.Event
) -> None:
    begun, waits = threading.Event(), list[float]()
    window.jobs.compute("stuck", lambda: begun.set() or go_on.wait(GUARD_MS / 1e3), lambda _: None)
    assert begun.wait(GUARD_MS / 1e3)
    monkeypatch.setattr("lfcal_gui.jobs.COMPUTATIONS_S", 0.05)
    monkeypatch.setattr("lfcal_gui.workers.wait_for", lambda threads, seconds: waits.append(seconds))
    assert not window.close()
    qtbot.waitUntil(lambda: not window.isVisible(), timeout=GUARD_MS)
    assert waits == [0.0]


def test_a_new_project_begins_with_its_camera(window: MainWindow) -> None:
    """It stayed on the page in view, which was empty then."""
    window.go("h")
    window.files.new()
    assert window.shown.spec.key == "setup"
