"""Files are opened beside the window's thread: what hangs can be left, what is damaged replaces nothing."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PySide6.QtWidgets import QApplication, QFileDialog, QMessageBox
from pytestqt.qtbot import QtBot

import lfcal.psf
from lfcal.camera import preset
from lfcal.psf import PSFMatrix, save
from lfcal_gui.app import begin, make_window, parse
from lfcal_gui.pages.reconstruct.export_model import ExportSettings
from lfcal_gui.window import MainWindow
from tests.gui.waiting import GUARD_MS, idle

DAMAGE = (KeyError("H"), RuntimeError("Can't decode\nchunk"), OSError(5, "I/O error"), TypeError("no"), MemoryError())


@pytest.fixture
def good(tmp_path: Path) -> Path:
    values = np.random.default_rng(0).random((2, 3, 4, 5, 5)).astype(np.float32)
    save(PSFMatrix(values, depths=[0, 10]), tmp_path / "good.h5")
    return tmp_path / "good.h5"


@pytest.fixture
def hanging(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, threading.Event]]:
    """Let every file whose name has "hang" in it be opened for ever, until the test ends."""
    events = {"begun": threading.Event(), "end": threading.Event()}
    really = lfcal.psf.open_psf

    def opener(path: Any, *args: Any, **options: Any) -> PSFMatrix:
        if "hang" in Path(path).name:
            events["begun"].set()
            events["end"].wait(GUARD_MS / 1e3)
            raise OSError("it came too late")
        return really(path, *args, **options)

    monkeypatch.setattr(lfcal.psf, "open_psf", opener)
    yield events
    events["end"].set()


def open_good(window: MainWindow, good: Path, qtbot: QtBot) -> Any:
    window.go("h")
    page: Any = window.page("h")
    page.open_file(str(good))
    idle(window.jobs, qtbot)
    assert window.project.state.psf == str(good) and page.matrix is not None
    return page


def test_a_file_that_hangs_leaves_the_window_alive(
    window: MainWindow, good: Path, tmp_path: Path, qtbot: QtBot, hanging: dict[str, threading.Event]
) -> None:
    (tmp_path / "hang.h5").write_text("")
    page = open_good(window, good, qtbot)
    page.open_file(str(tmp_path / "hang.h5"))
    assert hanging["begun"].wait(GUARD_MS / 1e3)
    qtbot.waitUntil(page.notice.isVisible, timeout=GUARD_MS)
    assert "hang.h5" in page.notice.label.text() and window.project.state.psf == str(good)
    page.set_intent(z=0)
    qtbot.waitUntil(lambda: page.plane is not None and page.plane.z == 0, timeout=GUARD_MS)
    page.notice.button.click()
    idle(window.jobs, qtbot)
    assert page.matrix is not None and not page.notice.isVisible()


def test_a_project_whose_h_hangs_can_be_left(
    window: MainWindow, tmp_path: Path, qtbot: QtBot, hanging: dict[str, threading.Event]
) -> None:
    (tmp_path / "hang.h5").write_text("")
    window.project.update("open", psf=str(tmp_path / "hang.h5"))
    for key in ("h", "reconstruct"):
        window.go(key)
        page: Any = window.page(key)
        assert "Opening hang.h5" in page.empty.label.text()
    assert hanging["begun"].wait(GUARD_MS / 1e3)
    window.context.matrices.cancel(str(tmp_path / "hang.h5"))
    idle(window.jobs, qtbot)
    for key in ("h", "reconstruct"):
        assert "stopped" in window.page(key).empty.label.text()  # type: ignore[union-attr]


def test_measuring_a_file_that_hangs_can_be_stopped(
    window: MainWindow, tmp_path: Path, qtbot: QtBot, hanging: dict[str, threading.Event]
) -> None:
    (tmp_path / "hang.h5").write_text("")
    window.project.update("open", psf=str(tmp_path / "hang.h5"))
    window.go("h")
    page: Any = window.page("h")
    page.look_into("checks")
    assert hanging["begun"].wait(GUARD_MS / 1e3)
    window.jobs.cancel(window.jobs.jobs()[0].number)
    assert not window.jobs.running_pages() and "Stopped" in page.checking.view.message.text()
    hanging["end"].set()


def test_what_opens_too_late_is_closed(window: MainWindow, qtbot: QtBot) -> None:
    go, closed, shown = threading.Event(), threading.Event(), []
    window.jobs.load("x", lambda: go.wait(GUARD_MS / 1e3) and "old", shown.append, None, lambda _: closed.set())
    window.jobs.drop("x")
    window.jobs.load("x", lambda: "new", shown.append)
    idle(window.jobs, qtbot)
    go.set()
    assert closed.wait(GUARD_MS / 1e3) and shown == ["new"]


def test_requests_in_a_hurry_open_the_newest_alone(window: MainWindow, qtbot: QtBot) -> None:
    go, opened, closed, shown = threading.Event(), [], [], []

    def opener(k: int) -> int:
        go.wait(GUARD_MS / 1e3)
        opened.append(k)
        return k

    for k in range(20):
        window.jobs.load("x", lambda k=k: opener(k), shown.append, None, closed.append)
    go.set()
    idle(window.jobs, qtbot)
    assert opened == [0, 19] and shown == [19] and closed == [0]


@pytest.mark.few(1)
@pytest.mark.parametrize("error", DAMAGE, ids=lambda e: type(e).__name__)
def test_damage_of_any_kind_is_one_line_and_the_good_h_stays(
    window: MainWindow, good: Path, tmp_path: Path, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    page = open_good(window, good, qtbot)

    def broken(path: Any) -> PSFMatrix:
        raise error

    monkeypatch.setattr(lfcal.psf, "open_psf", broken)
    for choose, said in ((page.open_file, page.notice.label), (page.comparing.choose, page.comparing.view.message)):
        choose(str(tmp_path / "other.h5"))
        idle(window.jobs, qtbot)
        words = said.text()
        assert words and "\n" not in words
        assert window.project.state.psf == str(good) and window.project.state.reference == ""
        assert page.matrix is not None
    page.look_into("checks")
    idle(window.jobs, qtbot)
    assert page.checking.inspection is None and "\n" not in page.checking.view.message.text()


def test_damaged_frames_leave_the_good_ones(window: MainWindow, tmp_path: Path, qtbot: QtBot) -> None:
    from lfcal.simulate import sample_recording

    window.go("frames")
    page: Any = window.page("frames")
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
def test_an_error_while_an_opened_h_is_read_is_told(
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


# -- nothing is replaced unasked ---------------------------------------------------------------------------
@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    told: list[str] = []
    monkeypatch.setattr(QMessageBox, "question", lambda *args: told.append(args[2]) or QMessageBox.StandardButton.No)
    return told


Choose = Callable[[str], None]


@pytest.fixture
def choose(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Choose:
    """Return a function that says which name the user types; the kind is the first offered."""

    def chosen(name: str) -> None:
        monkeypatch.setattr(QFileDialog, "getSaveFileName", lambda *a: (str(tmp_path / name), a[3].split(";;")[0]))

    monkeypatch.setattr(QFileDialog, "getExistingDirectory", lambda *_: str(tmp_path))
    return chosen


def test_no_page_replaces_a_file_unasked(
    window: MainWindow, good: Path, tmp_path: Path, qtbot: QtBot, asked: list[str], choose: Choose
) -> None:
    """The dialog of Qt asks about the name typed; each page asks about what it writes instead."""
    page = open_good(window, good, qtbot)
    names = ("p.json", "x.mat", "x.tif", "index.html", "view.png", "view.npy")
    for name in names:
        (tmp_path / name).write_text("precious")
    window.page("setup").make_default()  # type: ignore[attr-defined]
    choose("p")
    window.page("setup").save_plan()  # type: ignore[attr-defined]
    window.page("setup").save_file()  # type: ignore[attr-defined]
    choose("x")
    use: Any = window.page("reconstruct")
    for suffix in (".mat", ".tif"):
        window.project.update("kind", settings=ExportSettings(suffix=suffix).into(window.project.state))
        use.exporting.ask()
    window.page("h").checking.write_report()  # type: ignore[attr-defined]
    choose("view")
    page.panel.main_view.save_picture()
    page.panel.main_view.save_data()
    idle(window.jobs, qtbot)
    assert len(asked) == 7 and all((tmp_path / name).read_text() == "precious" for name in names)


def test_what_cannot_be_written_is_one_line(
    window: MainWindow, good: Path, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[str] = []
    monkeypatch.setattr(QMessageBox, "warning", lambda *args: told.append(args[2]))
    page = open_good(window, good, qtbot)
    nowhere = tmp_path / "file"
    nowhere.write_text("")
    for write in (page.panel.main_view.save_data, page.panel.main_view.save_picture, page.panel.profile.save_data):
        write(str(nowhere / "x.csv"))
    assert len(told) == 3 and all("\n" not in words and str(nowhere) in words for words in told)


def test_the_sample_is_assembled_beside_the_window(qapp: QApplication, qtbot: QtBot, place: Path) -> None:
    """``--demo`` showed no window until H was assembled."""
    options = parse(["--demo"])
    window = make_window(qapp, options, folder=place)
    window.show()
    assert window.isVisible() and not (place / "demo").exists() and window.project.state.name != "sample"
    begin(window, options)
    assert [job.page for job in window.jobs.jobs() if job.active] == ["sample"]
    idle(window.jobs, qtbot)
    assert window.project.state.name == "sample" and Path(window.project.state.psf).is_file()
    window.shut_down()
    window.close()
    window.deleteLater()


@pytest.mark.long
def test_a_refusal_goes_when_what_it_was_said_beside_goes(window: MainWindow, qtbot: QtBot, tmp_path: Path) -> None:
    """The file that could not be opened stood above another H that was made meanwhile, until it was dismissed."""
    for name in ("H.h5", "other.h5"):
        save(PSFMatrix(np.ones((1, 2, 2, 5, 5), np.float32)), tmp_path / name)
    (tmp_path / "bad.h5").write_bytes(b"no file of HDF5")
    window.project.update("open", psf=str(tmp_path / "H.h5"))
    window.go("h")
    page: Any = window.page("h")
    idle(window.jobs, qtbot)
    page.open_file(str(tmp_path / "bad.h5"))
    idle(window.jobs, qtbot)
    assert page.notice.isVisible() and "bad.h5" in page.notice.label.text()
    window.project.update("settings", settings={"psf": {}})
    assert page.notice.isVisible(), "it is still what was tried last"
    window.project.update("assembly", psf=str(tmp_path / "other.h5"))
    idle(window.jobs, qtbot)
    assert not page.notice.isVisible()
    page.notice.offer("lies on its side", "Turn", lambda: None, tip="Turn the frames")
    window.project.update("camera", camera=preset("r29"))
    assert page.notice.isVisible(), "an offer waits for its answer"
