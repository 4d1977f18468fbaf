"""The gallery: what is found is shown, filtered, opened, judged on request and compared by clicks."""

from __future__ import annotations

import json
import shutil
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import QSettings, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from lfcal import judge
from lfcal.judge.results import find_results
from lfcal.psf import PSFMatrix, save
from lfcal.simulate import sample_recording
from lfcal_gui.context import Context
from lfcal_gui.models import Verdict, stamp_of, with_verdict
from lfcal_gui.models.project import ProjectState
from lfcal_gui.pages.sessions.model import NOT_JUDGED, SessionsSettings, own_folders, shown
from lfcal_gui.pages.sessions.model_kept import SIDE, KeptResults, thumbnail
from lfcal_gui.pages.sessions.page import Page
from lfcal_gui.widgets import ComparePanel
from lfcal_gui.window import MainWindow
from tests.gui.conftest import OpenPage
from tests.gui.waiting import GUARD_MS, idle
from tests.judge.test_comparison import moved
from tests.judge.test_results import DEPTHS, QUALITY, matrix

NO_KEY, CTRL = Qt.KeyboardModifier.NoModifier, Qt.KeyboardModifier.ControlModifier
LEFT = Qt.MouseButton.LeftButton


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with two H, two recordings, a report and a damaged H."""
    root = tmp_path / "bench"
    for day, shift in (("may", (0.0, 0.0)), ("june", (0.3, -0.2))):
        (root / day).mkdir(parents=True)
        save(PSFMatrix(moved(shift).astype(np.float32), depths=DEPTHS), root / day / f"{day}.h5")
        shutil.copytree(sample_recording(), root / day / f"recorded_{day}")
    session = root / "june" / "recorded_june" / "session.json"
    data = json.loads(session.read_text())
    data["runs"][0] |= {"how": "stopped", "acknowledged": 100}
    session.write_text(json.dumps(data))
    (root / "report").mkdir()
    (root / "report" / "quality.json").write_text(json.dumps(QUALITY | {"inspected": "2026-05-01T00:00:00+00:00"}))
    (root / "torn.h5").write_bytes((root / "may" / "may.h5").read_bytes()[:3000])
    return root


@pytest.fixture
def page(open_page: OpenPage, folder: Path, qtbot: QtBot) -> Page:
    made: Page = open_page("sessions")
    made.choose(str(folder))
    idle(made.context.jobs, qtbot)
    return made


def names(page: Page) -> list[str]:
    model = page.panel.tiles.model()
    return [str(model.index(row).data()) for row in range(model.rowCount())]


def click(page: Page, name: str, held: Qt.KeyboardModifier = NO_KEY) -> None:
    tiles = page.panel.tiles
    index = tiles.model().index(names(page).index(name))
    tiles.scrollTo(index)
    QTest.mouseClick(tiles.viewport(), LEFT, held, tiles.visualRect(index).center())


def facts(page: Page) -> dict[str, str]:
    table = page.panel.facts
    cells = [[table.item(row, k) for k in range(2)] for row in range(table.rowCount())]
    return {a.text(): b.text() for a, b in cells if a is not None and b is not None}


def spoken(page: Page, name: str) -> str:
    model = page.panel.tiles.model()
    return str(model.index(names(page).index(name)).data(Qt.ItemDataRole.AccessibleTextRole))


def test_what_is_found_has_its_verdict_and_date(page: Page) -> None:
    assert set(names(page)) == {"may.h5", "june.h5", "recorded_may", "recorded_june", "report", "torn.h5"}
    assert page.panel.counted.text() == "6 results" and page.panel.stack.currentIndex() == 1
    assert NOT_JUDGED in spoken(page, "may.h5"), "nothing is judged without being asked to"
    assert spoken(page, "report") == "report, 2026-05-01, Report, This H is good."
    assert "unfinished: 100 of 627 positions" in spoken(page, "recorded_june")
    assert "HDF5" in spoken(page, "torn.h5") and str(page.folders[0]) not in spoken(page, "torn.h5")
    click(page, "may.h5")
    assert facts(page)["Period"] == "4 × 6" or facts(page)["Period"].count("×") == 1
    assert facts(page)["Verdict"] == NOT_JUDGED and page.judge_button.isEnabled() and page.open_button.isEnabled()
    click(page, "torn.h5")
    assert "HDF5" in facts(page)["Problem"] and not page.open_button.isEnabled() and not page.judge_button.isEnabled()


def test_results_are_filtered_and_ordered(page: Page) -> None:
    panel = page.panel
    QTest.keyClicks(panel.words, "unfinished")
    assert names(page) == ["recorded_june"] and panel.counted.text() == "1 of 6"
    panel.words.setText("no such words")
    assert panel.message.text() == "No result matches the filter." and panel.stack.currentIndex() == 0
    panel.words.clear()
    for box, value, wanted in (
        (panel.kind, "H", {"may.h5", "june.h5"}),
        (panel.kind, "recording", {"recorded_may", "recorded_june"}),
    ):
        box.setCurrentIndex(box.findData(value))
        box.activated.emit(box.currentIndex())
        assert set(names(page)) == wanted
    panel.kind.setCurrentIndex(0)
    panel.kind.activated.emit(0)
    panel.order.setCurrentIndex(panel.order.findData("name"))
    panel.order.activated.emit(0)
    assert names(page) == sorted(names(page))
    panel.order.setCurrentIndex(panel.order.findData("verdict"))
    panel.order.activated.emit(0)
    assert names(page)[0] == "torn.h5" and names(page)[-1] in ("report", "recorded_may")


def test_two_h_are_compared_by_clicks(page: Page, qtbot: QtBot) -> None:
    panel = page.panel
    assert not page.compare_button.isEnabled() and not panel.findChildren(ComparePanel), "made when it is needed"
    click(page, "june.h5")
    click(page, "may.h5", CTRL)
    assert page.compare_button.isEnabled() and not page.open_button.isEnabled()
    QTest.mouseClick(page.compare_button, LEFT)
    idle(page.context.jobs, qtbot)
    assert panel.currentWidget() is panel.pair_stack and panel.pair_stack.currentWidget() is panel.compare
    assert page.pairing.found is not None and "%" in panel.compare.verdict.text()
    assert panel.compare.views[0].values is not None and not panel.compare.choose_button.isVisible()
    assert page.context.state.psf == page.context.state.reference == "", "the project stays as it is"
    paths = [str(page.folders[0] / Path(day) / f"{day}.h5") for day in ("may", "june")]
    assert all(page.context.matrix(path) is not None for path in paths)
    page.let_go()
    assert page.pairing.found is None and all(page.context.matrix(path) is None for path in paths)


def test_two_recordings_are_compared_by_their_facts(page: Page, qtbot: QtBot) -> None:
    click(page, "recorded_may")
    click(page, "recorded_june", CTRL)
    page.panel.tiles.setFocus()
    QTest.keyClick(page.panel.tiles, Qt.Key.Key_D, CTRL)
    idle(page.context.jobs, qtbot)
    table = page.panel.pair_table
    rows = {
        table.item(row, 0).text(): [table.item(row, k).text() for k in (1, 2, 3)]  # type: ignore[union-attr]
        for row in range(table.rowCount())
    }
    assert page.panel.currentWidget() is page.panel.pair_stack
    assert rows["Camera"][2] == "" and rows["Recorded"][2] == "differs"
    assert set(rows) >= {"Exposure", "Light per frame", "Date", "Device", "Stage", "Cutout"}
    assert {*rows["Recorded"][:2]} == {"627 of 627 positions", "100 of 627 positions"}


def test_pictures_of_what_is_seen_are_read_once(page: Page, qtbot: QtBot, cache: Path) -> None:
    tiles = page.panel.tiles
    qtbot.waitUntil(lambda: len(tiles._model.pictures) == 6, timeout=GUARD_MS)
    pictures = {path.name: image for path, image in tiles._model.pictures.items()}
    assert pictures["may.h5"] is not None and pictures["recorded_may"] is not None and pictures["report"] is None
    before = {path: path.stat().st_mtime_ns for path in cache.iterdir()}
    assert sum(path.suffix == ".npy" for path in before) >= 4
    page.look()
    idle(page.context.jobs, qtbot)
    qtbot.waitUntil(lambda: len(tiles._model.pictures) == 6, timeout=GUARD_MS)
    assert {path: path.stat().st_mtime_ns for path in cache.iterdir()} == before


def test_judging_is_asked_for_and_kept(page: Page, qtbot: QtBot, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def at_once(path: str, order: str, kept: Any) -> Any:
        kept.verdict = "bad", "This H should not be used."
        yield from ()

    monkeypatch.setattr("lfcal_gui.pages.sessions.page.iter_judged", at_once)
    click(page, "may.h5")
    QTest.mouseClick(page.judge_button, LEFT)
    idle(page.context.jobs, qtbot)
    assert "should not be used" in spoken(page, "may.h5") and NOT_JUDGED in spoken(page, "june.h5")
    assert facts(page)["Verdict"] == "This H should not be used."
    page.look()
    idle(page.context.jobs, qtbot)
    assert "should not be used" in spoken(page, "may.h5"), "kept"
    save(matrix(), folder / "may" / "may.h5")
    page.look()
    idle(page.context.jobs, qtbot)
    assert NOT_JUDGED in spoken(page, "may.h5"), "it is another H"


def test_h_that_was_judged_elsewhere_shows_its_verdict(page: Page, qtbot: QtBot, folder: Path) -> None:
    """The tile said "Not judged" of an H whose verdict the rail showed."""
    project = page.context.project
    for day in ("may", "june"):
        path = str(folder / day / f"{day}.h5")
        stamp = stamp_of(path)
        assert stamp is not None
        project.update("open", psf=path)
        project.note(settings=with_verdict(project.state, stamp, Verdict("bad", f"H of {day} is bad.")))
        assert f"H of {day} is bad." in spoken(page, f"{day}.h5"), "at once"
    page.look()
    idle(page.context.jobs, qtbot)
    assert "H of may is bad." in spoken(page, "may.h5") and "H of june is bad." in spoken(page, "june.h5")
    save(matrix(), folder / "may" / "may.h5")
    page.look()
    idle(page.context.jobs, qtbot)
    assert NOT_JUDGED in spoken(page, "may.h5"), "it is another H"


@pytest.mark.long
def test_an_h_is_judged_by_its_metrics(page: Page, qtbot: QtBot) -> None:
    click(page, "may.h5")
    page.judge()
    idle(page.context.jobs, qtbot)
    assert "This H" in spoken(page, "may.h5")


def test_what_cannot_be_judged_says_why(page: Page, qtbot: QtBot, folder: Path) -> None:
    click(page, "may.h5")
    (folder / "may" / "may.h5").write_bytes(b"")
    page.judge()
    idle(page.context.jobs, qtbot)
    assert "may.h5" in page.notice.label.text() and NOT_JUDGED in spoken(page, "may.h5")


def test_a_result_opens_on_its_page(window: MainWindow, folder: Path, qtbot: QtBot) -> None:
    window.go("sessions")
    page: Any = window.page("sessions")
    page.choose(str(folder))
    idle(window.jobs, qtbot)
    click(page, "may.h5")
    page.panel.tiles.setFocus()
    QTest.keyClick(page.panel.tiles, Qt.Key.Key_Return)
    idle(window.jobs, qtbot)
    assert window.project.state.psf == str(folder / "may" / "may.h5")
    assert window.stack.currentWidget() is window.page("h")
    window.go("sessions")
    click(page, "recorded_may")
    QTest.mouseClick(page.open_button, LEFT)
    idle(window.jobs, qtbot)
    assert window.stack.currentWidget() is window.page("acquire")


def test_folders_are_remembered(
    open_page: OpenPage, context: Context, folder: Path, qtbot: QtBot, tmp_path: Path
) -> None:
    context.preferences = QSettings(str(tmp_path / "window.ini"), QSettings.Format.IniFormat)
    first: Page = open_page("sessions")
    for one in (folder, folder / "may"):
        first.choose(str(one))
        idle(context.jobs, qtbot)
    context.preferences.sync()
    again: Page = open_page("sessions")
    box = again.panel.folder
    assert [box.itemData(k) for k in range(box.count())] == ["", str(folder / "may"), str(folder)]
    box.setCurrentIndex(2)
    box.activated.emit(2)
    idle(context.jobs, qtbot)
    assert again.folders == (str(folder),) and len(names(again)) == 6


def test_the_folders_of_the_project_come_first(
    open_page: OpenPage, context: Context, folder: Path, qtbot: QtBot
) -> None:
    page: Page = open_page("sessions")
    page.entered()
    idle(context.jobs, qtbot)
    assert page.panel.message.text().startswith("This project has no file yet")
    context.project.update("open", psf=str(folder / "may" / "may.h5"))
    idle(context.jobs, qtbot)
    assert set(names(page)) == {"may.h5", "recorded_may"}


def test_a_folder_that_vanished_says_so(page: Page, folder: Path, qtbot: QtBot) -> None:
    shutil.rmtree(folder)
    page.look()
    idle(page.context.jobs, qtbot)
    assert str(folder) in page.panel.message.text() and "no such" in page.panel.message.text().lower()
    click_none = page.panel.tiles.selected()
    assert not click_none and not page.open_button.isEnabled()


@pytest.fixture
def answer() -> Iterator[threading.Event]:
    """Return what the disk waits for."""
    found = threading.Event()
    yield found
    found.set()


def test_a_disk_without_an_answer_holds_up_nothing(
    page: Page, folder: Path, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch, answer: threading.Event
) -> None:
    read = judge.iter_find_results

    def hangs(*folders: str) -> Any:
        if folders == (str(folder),):
            answer.wait(GUARD_MS / 1e3)
        return (yield from read(*folders))

    monkeypatch.setattr("lfcal.judge.iter_find_results", hangs)
    page.look()
    assert page.panel.message.text() == "Searching …" and page.panel.status.text().startswith("Searching")
    page.choose(str(folder / "may"))
    qtbot.waitUntil(lambda: len(names(page)) == 2, timeout=GUARD_MS)
    answer.set()
    idle(page.context.jobs, qtbot)
    assert len(names(page)) == 2, "what comes late is dropped"


@pytest.mark.long
def test_500_results_never_hold_the_window(page: Page, qtbot: QtBot, tmp_path: Path) -> None:
    many = tmp_path / "many"
    many.mkdir()
    path = save(matrix(), many / "H.h5")
    for k in range(1, 500):
        shutil.copy(path, many / f"H{k}.h5")
    worst, start = 0.0, time.monotonic()
    page.choose(str(many))
    while page.context.jobs.busy:
        before = time.thread_time()
        QApplication.processEvents()
        worst = max(worst, time.thread_time() - before)
        time.sleep(0.002)
    assert len(names(page)) == 500 and time.monotonic() - start < 60
    assert worst < 0.05


# -- models ------------------------------------------------------------------------------------------------
def test_own_folders_are_each_named_once() -> None:
    state = replace(ProjectState(), psf="/a/H.h5", reference="/a/R.h5", recording="/b/session", volume="/c/v.tif")
    assert own_folders(state, Path("/a/bench.lfcal")) == tuple(str(Path(one)) for one in ("/a", "/c", "/b"))
    assert own_folders(ProjectState(), None) == ()


def test_a_thumbnail_keeps_single_bright_pixels() -> None:
    values = np.zeros((1000, 600))
    values[501, 333] = 5.0
    small = thumbnail(values)
    assert max(small.shape) <= SIDE and small.max() == 255 and np.count_nonzero(small) == 1
    assert thumbnail(np.full((3, 3), np.nan)).max() == 0 and thumbnail(np.ones((1, 500))).shape[0] == 1


def test_where_nothing_can_be_kept_nothing_fails(tmp_path: Path) -> None:
    save(matrix(), tmp_path / "H.h5")
    (tmp_path / "file").touch()
    kept, one = KeptResults(tmp_path / "file" / "below"), find_results(tmp_path).results[0]
    assert kept.picture(one) is not None and kept.verdict(one) is None
    kept.keep_verdict(one, ("good", "This H is good."))
    assert kept.verdict(one) is None
    kept.sweep()


def test_a_damaged_entry_of_the_cache_is_made_again(tmp_path: Path) -> None:
    save(matrix(), tmp_path / "H.h5")
    one, kept = find_results(tmp_path).results[0], KeptResults(tmp_path / "cache")
    first = kept.picture(one)
    kept.keep_verdict(one, ("good", "This H is good."))
    assert kept.verdict(one) == ("good", "This H is good.")
    for path in (tmp_path / "cache").iterdir():
        path.write_bytes(b"[")
    assert np.array_equal(kept.picture(one), first) and kept.verdict(one) is None  # type: ignore[arg-type]


def test_settings_that_are_not_known_take_their_defaults() -> None:
    assert SessionsSettings.from_dict({"kind": "nothing", "order": "oldest", "folder": "/a"}) == SessionsSettings(
        "/a", "", "oldest"
    )
    assert shown([], SessionsSettings()) == []
