"""Project files and copies of unsaved work, through the window."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from PySide6.QtWidgets import QApplication, QFileDialog, QMessageBox
from pytestqt.qtbot import QtBot

from lfcal_gui import app
from lfcal_gui._project_files import stop_words
from lfcal_gui.app import make_window, parse
from lfcal_gui.locks import FileLock
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
if len(sys.argv) > 2:
    window.project.save(Path(sys.argv[2]))
    assert window.files.save()
window.project.update("rename", name="work of a day")
window.files.rescue.keep()
os.kill(os.getpid(), signal.SIGKILL)
"""


def kill_a_window(place: Path, *more: Path) -> None:
    """Let a window in a process of its own keep a copy, and kill it."""
    done = subprocess.run(
        [sys.executable, "-c", KILLED, str(place), *map(str, more)],
        env={**os.environ, "PYTHONPATH": str(ROOT), "QT_QPA_PLATFORM": "offscreen"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == -signal.SIGKILL, done.stderr


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
    told: list[str] = []
    monkeypatch.setattr(QMessageBox, "warning", lambda *args: told.append(args[2]))
    monkeypatch.setattr(QMessageBox, "question", lambda *args: told.append(args[2]) or BUTTONS.No)
    return told


# -- after a crash -----------------------------------------------------------------------------------------
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no such signal here")
def test_after_a_kill_the_work_is_offered_and_restored(
    window: MainWindow, place: Path, tmp_path: Path, qtbot: QtBot
) -> None:
    own = tmp_path / "p.lfcal"
    kill_a_window(place, own)
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


def left_behind(place: Path, name: str = "lost", path: Path | None = None) -> Path:
    """Put a copy where a window that is gone would have left it."""
    from lfcal_gui.models.autosave import keep

    project = Project(ProjectState(), path)
    project.update("rename", name=name)
    file = place / "autosave" / f"{name}.lfcal"
    keep(project, file)
    return file


def test_discard_removes_and_later_keeps(window: MainWindow, place: Path, qtbot: QtBot) -> None:
    file = left_behind(place)
    window.files.begin()
    idle(window.jobs, qtbot)
    dialog = window.files.rescue.dialog
    assert dialog is not None and dialog.focusWidget() is dialog.restore, "Space does not discard the work"
    dialog.close()
    assert file.exists() and window.project.state.name == "untitled"
    window.files.rescue.look(asked=True)
    idle(window.jobs, qtbot)
    window.files.rescue.dialog.discard.click()
    assert not list((place / "autosave").iterdir())


def test_the_work_of_a_living_window_is_not_offered(
    window: MainWindow, second: MainWindow, place: Path, qtbot: QtBot
) -> None:
    window.project.update("rename", name="mine")
    second.project.update("rename", name="yours")
    assert window.files.rescue.keep() != second.files.rescue.keep()
    second.files.begin()
    idle(second.jobs, qtbot)
    assert second.files.rescue.dialog is None
    assert len(list((place / "autosave").glob("*.lfcal"))) == 2


def test_a_clean_end_leaves_nothing_and_another_end_keeps(qapp: QApplication, place: Path) -> None:
    for asked in (False, True):
        made = make_window(qapp, parse([]), folder=place)
        made.project.update("rename", name="kept")
        made.files.rescue.keep()
        made.shut_down(asked=asked)
        made.deleteLater()
        left = [path.suffix for path in (place / "autosave").iterdir()]
        assert left == [".lfcal"], "of the first alone, and no locks"


def test_only_the_project_that_is_opened_is_asked_about(
    window: MainWindow, place: Path, tmp_path: Path, qtbot: QtBot
) -> None:
    own = tmp_path / "own.lfcal"
    Project(ProjectState("own")).save(own)
    left_behind(place, "another")
    window.files.begin(own)
    idle(window.jobs, qtbot)
    assert window.files.rescue.dialog is None and window.project.state.name == "own"
    assert "unsaved work of another project" in window.log_view.toPlainText()


def test_a_project_that_is_damaged_has_its_copy_offered(
    window: MainWindow, place: Path, tmp_path: Path, qtbot: QtBot, boxes: list[str]
) -> None:
    own = tmp_path / "own.lfcal"
    own.write_text("{")
    left_behind(place, "saved by the copy", own)
    window.files.begin(own)
    idle(window.jobs, qtbot)
    assert len(boxes) == 1 and window.files.rescue.dialog is not None
    window.files.rescue.dialog.restore.click()
    assert window.project.state.name == "saved by the copy" and window.project.path == own


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


def test_locks_of_dead_processes_count_for_nothing(tmp_path: Path) -> None:
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


def test_a_lock_of_another_machine_is_only_taken_when_asked_for(tmp_path: Path) -> None:
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


@pytest.mark.parametrize("console", [True, False])
def test_the_reason_why_no_window_opens_is_shown(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], console: bool
) -> None:
    """On Windows, lfcal-gui has no console: sys.stderr is None there."""
    shown: list[tuple[object, ...]] = []
    library = SimpleNamespace(user32=SimpleNamespace(MessageBoxW=lambda *words: shown.append(words)))
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setattr(ctypes, "windll", library, raising=False)
    monkeypatch.setattr(app, "_lacking", lambda: "PySide6 is not installed")
    if not console:
        monkeypatch.setattr(sys, "stderr", None)
    assert app.main([]) == 2
    assert [words[1] for words in shown] == ([] if console else ["PySide6 is not installed"])
    assert capsys.readouterr().err == ("lfcal-gui: PySide6 is not installed\n" if console else "")


# -- nothing is replaced unasked ---------------------------------------------------------------------------
def test_a_damaged_project_leaves_the_good_one(
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


@pytest.mark.parametrize(
    ("typed", "kind", "path"),
    [
        ("/a/H", "MATLAB (*.mat)", "/a/H.mat"),
        ("/a/H.h5", "MATLAB (*.mat)", "/a/H.h5"),
        ("/a/H_0.5um", "TIFF (*.tif *.tiff)", "/a/H_0.5um.tif"),
        ("/a/v1.2", "Project (*.lfcal)", "/a/v1.2.lfcal"),
        ("/a/H", "All files (*)", "/a/H"),
        ("/a/plan.json", "Sequence (*.useq.json)", "/a/plan.useq.json"),
        ("/a/plan.useq.json", "Sequence (*.useq.json)", "/a/plan.useq.json"),
        ("/a/plan.json", "Plan (*.json);;Sequence (*.useq.json)", "/a/plan.json"),
    ],
)
def test_names_take_the_suffix_of_the_chosen_kind(typed: str, kind: str, path: str) -> None:
    assert with_suffix(typed, kind) == path


def test_a_suffix_added_does_not_get_round_the_question(
    window: MainWindow, tmp_path: Path, boxes: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "H.mat").write_text("precious")
    monkeypatch.setattr(QFileDialog, "getSaveFileName", lambda *_: (str(tmp_path / "H"), "MATLAB (*.mat)"))
    assert ask_target(window, "Export", "H.mat", "MATLAB (*.mat);;numpy (*.npy)") == ""
    assert str(tmp_path / "H.mat") in boxes[-1]
    monkeypatch.setattr(QMessageBox, "question", lambda *_: BUTTONS.Yes)
    assert ask_target(window, "Export", "H.mat", "") == str(tmp_path / "H.mat")
    assert may_replace(window, [tmp_path / "new"])


def test_jobs_go_on_until_everything_is_answered(
    window: MainWindow, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    from lfcal.base.progress import Progress

    going = threading.Event()

    def work() -> Any:
        while not going.wait(0.001):
            yield Progress(0, 1, "work")

    number = window.jobs.start("Record", "acquire", work)
    qtbot.waitUntil(lambda: window.jobs.jobs()[0].progress is not None, timeout=GUARD_MS)
    window.project.update("rename", name="changed")
    answers = iter((BUTTONS.Yes, BUTTONS.Cancel))
    monkeypatch.setattr(QMessageBox, "question", lambda *_: next(answers))
    assert not window.files.may_leave()
    going.set()
    idle(window.jobs, qtbot)
    assert next(job for job in window.jobs.jobs() if job.number == number).state.value == "done"


def test_jobs_go_on_until_another_project_is_known_to_be_good(
    window: MainWindow, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, boxes: list[str]
) -> None:
    from lfcal.base.progress import Progress

    going = threading.Event()

    def work() -> Any:
        while not going.wait(0.001):
            yield Progress(0, 1, "work")

    window.jobs.start("Assemble", "frames", work)
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


def test_what_is_done_while_a_project_is_read_is_asked_about(
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


def test_closing_does_not_hold_the_window_while_a_job_stops(
    window: MainWindow, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    from lfcal.base.progress import Progress

    go_on = threading.Event()

    def work() -> Any:
        yield Progress(0, 2, "work")
        go_on.wait(GUARD_MS / 1e3)
        yield Progress(1, 2, "work")

    window.jobs.start("Simulate", "simulate", work)
    qtbot.waitUntil(lambda: window.jobs.jobs()[0].progress is not None, timeout=GUARD_MS)
    monkeypatch.setattr(QMessageBox, "question", lambda *_: BUTTONS.Yes)
    waits: list[float] = []
    monkeypatch.setattr("lfcal_gui.jobs.wait_for", lambda threads, seconds: waits.append(seconds))
    assert not window.close() and window.isVisible() and not waits
    assert "the window then closes" in window.log_view.toPlainText() and not window.centralWidget().isEnabled()
    assert not window.close(), "asked once is enough"
    monkeypatch.undo()
    go_on.set()
    qtbot.waitUntil(lambda: not window.isVisible(), timeout=GUARD_MS)
    assert not window.jobs.busy


def test_enter_does_not_stop_what_is_at_work(window: MainWindow, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> None:
    from lfcal.base.progress import Progress

    going = threading.Event()

    def work() -> Any:
        while not going.wait(0.001):
            yield Progress(0, 1, "work")

    window.jobs.start("Record", "acquire", work)
    asked: list[tuple[Any, ...]] = []

    def enter(*question: Any) -> Any:
        asked.append(question)
        return question[-1]  # the default button

    monkeypatch.setattr(QMessageBox, "question", enter)
    assert not window.files.may_leave()
    job = window.jobs.jobs()[0]
    assert (
        job.active and not job.stopping and asked[0][-1] == BUTTONS.No and "Recorded positions are kept" in asked[0][2]
    )
    going.set()
    idle(window.jobs, qtbot)


def test_of_what_stops_only_that_is_promised_which_it_keeps(window: MainWindow, qtbot: QtBot) -> None:
    from lfcal.base.progress import Progress

    going = threading.Event()

    def work() -> Any:
        while not going.wait(0.001):
            yield Progress(0, 1, "work")

    window.jobs.start("Search", "multiplex", work, at_once=True)
    assert stop_words(window.jobs).endswith("\n\nStop it?")
    window.jobs.start("Record", "acquire", work, at_once=True)
    assert stop_words(window.jobs).endswith("Stop them? Recorded positions are kept.")
    window.context.start_writing("Assemble", "frames", "H.h5", work)
    assert "Complete planes of an H" in stop_words(window.jobs)
    going.set()
    idle(window.jobs, qtbot)


@pytest.fixture
def go_on() -> Iterator[threading.Event]:
    """Return what ends whatever hangs, at the latest with the test."""
    event = threading.Event()
    yield event
    event.set()


def test_closing_does_not_hold_the_window_while_something_is_computed_or_opened(
    window: MainWindow, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch, go_on: threading.Event
) -> None:
    """It stood still for up to seven seconds: while a simulator was connected, a light field made, a file opened."""
    from functools import partial

    from lfcal.base.progress import Progress

    begun, told, waits = [threading.Event() for _ in range(3)], list[str](), list[float]()

    def hang(event: threading.Event) -> str:
        event.set()
        go_on.wait(GUARD_MS / 1e3)
        return "device"

    def fit() -> Any:
        hang(begun[2])
        yield Progress(0, 1, "fit")

    window.jobs.compute("connect", partial(hang, begun[0]), told.append)
    window.jobs.load("file", partial(hang, begun[1]), told.append)
    window.jobs.start("Fit", "fit", fit, leave=True)
    assert all(event.wait(GUARD_MS / 1e3) for event in begun)
    monkeypatch.setattr(QMessageBox, "question", lambda *_: BUTTONS.Yes)
    for name in ("lfcal_gui.jobs.wait_for", "lfcal_gui.workers.wait_for", "lfcal_gui._background.wait_for"):
        monkeypatch.setattr(name, lambda threads, seconds: waits.append(seconds))
    assert not window.close() and window.isVisible() and sum(waits) == 0
    window.jobs.compute("live view", lambda: "again", told.append)
    window.jobs.load("another", lambda: "again", told.append)
    number = window.jobs.start("Late", "fit", fit)
    assert not next(job for job in window.jobs.jobs() if job.number == number).active, "nothing begins any more"
    monkeypatch.undo()
    go_on.set()
    qtbot.waitUntil(lambda: not window.isVisible(), timeout=GUARD_MS)
    assert told == ["device"], "what was connected is handed over, to be released"


def test_what_never_ends_does_not_keep_the_window_open(
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
