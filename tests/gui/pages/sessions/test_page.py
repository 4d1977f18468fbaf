"""The gallery: what is found is shown, filtered, opened, judged on request, compared, and followed over time."""

from __future__ import annotations

import json
import shutil
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import QSettings, Qt
from PySide6.QtTest import QTest
from pytestqt.qtbot import QtBot

from lfcal import judge
from lfcal.base import plain
from lfcal.judge import find_results, inspect
from lfcal.psf import PSFMatrix, save
from lfcal.simulate import sample_recording
from lfcal_gui.context import Context
from lfcal_gui.models import ProjectState, Verdict, stamp_of, with_verdict
from lfcal_gui.pages.sessions.model import NOT_JUDGED, SessionsSettings, own_folders, shown
from lfcal_gui.pages.sessions.model_kept import SIDE, KeptResults, thumbnail
from lfcal_gui.pages.sessions.model_trend import TrendCurve
from lfcal_gui.pages.sessions.page import Page
from lfcal_gui.widgets import ComparePanel
from lfcal_gui.window import MainWindow
from tests.cli.test_trend import dated, write
from tests.gui.conftest import OpenPage
from tests.gui.waiting import GUARD_MS, idle
from tests.judge.test_comparison import moved
from tests.judge.test_report import matrix as judged_matrix
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


def test_results_are_found_filtered_and_ordered(page: Page) -> None:
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
        table.item(row, 0).text(): [table.item(row, k).text() for k in (1, 2, 3)] for row in range(table.rowCount())
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


def test_folders_are_kept(open_page: OpenPage, context: Context, folder: Path, qtbot: QtBot, tmp_path: Path) -> None:
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


def test_folders_of_the_project_come_first(open_page: OpenPage, context: Context, folder: Path, qtbot: QtBot) -> None:
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


def test_thumbnails_folders_and_settings_of_results() -> None:
    values = np.zeros((1000, 600))
    values[501, 333] = 5.0
    small = thumbnail(values)
    assert max(small.shape) <= SIDE and small.max() == 255 and np.count_nonzero(small) == 1
    assert thumbnail(np.full((3, 3), np.nan)).max() == 0 and thumbnail(np.ones((1, 500))).shape[0] == 1
    state = replace(ProjectState(), psf="/a/H.h5", reference="/a/R.h5", recording="/b/session", volume="/c/v.tif")
    assert own_folders(state, Path("/a/bench.lfcal")) == tuple(str(Path(one)) for one in ("/a", "/c", "/b"))
    assert own_folders(ProjectState(), None) == () and shown([], SessionsSettings()) == []
    found = SessionsSettings.from_dict({"kind": "nothing", "order": "oldest", "folder": "/a"})
    assert found == SessionsSettings("/a", "", "oldest")


@pytest.fixture(scope="module")
def record() -> dict[str, Any]:
    """Return an inspection as its file holds it."""
    found: dict[str, Any] = json.loads(json.dumps(plain(inspect(judged_matrix()).to_dict())))
    return found


@pytest.fixture
def reports(tmp_path: Path, record: dict[str, Any]) -> Path:
    """Write three inspections, the newest with a lamp that drifts and a fault."""
    for month, lamp in ((5, (1.0, "good")), (6, (2.0, "good")), (7, (3.5, "fair"))):
        write(tmp_path / f"m{month}", record, month, lamp, {"ghost image": 0.02} if month == 7 else {})
    return tmp_path


def looked(page: Page, folder: Path, qtbot: QtBot) -> None:
    page.choose(str(folder))
    page.panel.setCurrentWidget(page.panel.trend)
    idle(page.context.jobs, qtbot)


def test_what_got_worse_comes_first_with_its_course(open_page: OpenPage, qtbot: QtBot, reports: Path) -> None:
    page: Page = open_page("sessions")
    panel, trending = page.panel.trend, page.trending
    assert not panel.picture_button.isEnabled()
    looked(page, reports, qtbot)
    assert panel.verdict.text().startswith("Worse than before: ghost image") and "3 sessions" in panel.notes.text()
    first = [panel.table.item(0, k).text() for k in range(5)]
    assert first[0].lower().startswith("ghost image") and first[-1] == "worse"
    row = next(k for k in range(panel.table.rowCount()) if "Lamp" in panel.table.item(k, 0).text())
    panel.table.selectRow(row)
    x, y = panel.curve._curves["value"].getData()
    np.testing.assert_allclose(x, [0, 31, 61])
    np.testing.assert_allclose(y, [1, 2, 3.5])
    assert not any(panel.table.isColumnHidden(k) for k in range(5))
    assert panel.curve.plot.vb.viewRange()[1][0] == pytest.approx(0, abs=0.2)
    limits = {"limit of good values", "limit of bad values"}
    assert "Lamp" in panel.title.text() and panel.curve._curves.keys() == {*limits, "value"}
    assert panel.curve.plot.legend is not None and panel.curve._labels[0] == "days since the first session"
    trending.save_picture(str(reports / "trend.png"))
    idle(page.context.jobs, qtbot)
    assert (reports / "trend.png").stat().st_size > 1000


def test_the_filter_of_the_gallery_chooses_the_reports(open_page: OpenPage, qtbot: QtBot, reports: Path) -> None:
    page: Page = open_page("sessions")
    looked(page, reports, qtbot)
    page.panel.words.setText("m7")
    idle(page.context.jobs, qtbot)
    assert (
        "expected two or more, got 1" in page.panel.trend.message.text() and page.panel.trend.stack.currentIndex() == 0
    )
    page.panel.words.setText("")
    idle(page.context.jobs, qtbot)
    assert page.panel.trend.stack.currentIndex() == 1


def test_one_day_has_no_change_a_month(
    open_page: OpenPage, qtbot: QtBot, tmp_path: Path, record: dict[str, Any]
) -> None:
    write(tmp_path / "a", record, 5, (1.0, "good"))
    dated(write(tmp_path / "b", record, 5, (None, "fair")), "2026-05-01T00:00:02+00:00")  # type: ignore[arg-type]
    dated(write(tmp_path / "c", record, 5, (3.5, "fair")), "2026-05-01T00:00:04+00:00")
    page: Page = open_page("sessions")
    looked(page, tmp_path, qtbot)
    panel = page.panel.trend
    texts = [[panel.table.item(row, k).text() for k in range(4)] for row in range(panel.table.rowCount())]
    assert next(row for row in texts if "Lamp" in row[0])[1:] == ["fair", "3.5 fair", "within 4.0 s"]
    assert {row[3] for row in texts if "Lamp" not in row[0]} == {""}, "what did not change"
    panel.table.selectRow(next(k for k, row in enumerate(texts) if "Lamp" not in row[0]))
    np.testing.assert_allclose(panel.curve._curves["value"].getData()[0], [0, 2, 4])
    assert panel.curve._labels[0] == "seconds since the first session", "all were at day 0"
    assert (
        "3 sessions, 2026-05-01." in panel.notes.text() and "A change per month is not estimated" in panel.notes.text()
    )


def test_columns_without_values_are_hidden_and_a_count_of_none_begins_at_zero(
    open_page: OpenPage, qtbot: QtBot, tmp_path: Path, record: dict[str, Any]
) -> None:
    for month in (5, 6):
        write(tmp_path / f"m{month}", record, month, (1.0, "good"))
    page: Page = open_page("sessions")
    looked(page, tmp_path, qtbot)
    panel = page.panel.trend
    assert [panel.table.isColumnHidden(k) for k in range(5)] == [False, False, False, True, True]
    panel.show_curve(TrendCurve("Missing frames (frames)", np.array([0.0, 31.0]), np.zeros(2), 0.0, 0.0))
    assert panel.curve._curves.keys() == {"limit of good and bad values", "value"}
    low, high = panel.curve.plot.vb.viewRange()[1]
    assert low == pytest.approx(0, abs=0.05) and high == pytest.approx(1, abs=0.05)


def judged_elsewhere(page: Page, folder: Path, day: str) -> None:
    """Keep a verdict of an H in the project, as the place H does."""
    project, path = page.context.project, str(folder / day / f"{day}.h5")
    stamp = stamp_of(path)
    assert stamp is not None
    project.update("open", psf=path)
    project.note(settings=with_verdict(project.state, stamp, Verdict("bad", f"H of {day} is bad.")))


def test_a_verdict_is_asked_for_or_taken_from_elsewhere_and_kept_as_long_as_h_is_the_same(
    page: Page, qtbot: QtBot, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def at_once(path: str, order: str, kept: Any) -> Any:
        kept.verdict = "bad", "This H should not be used."
        yield from ()

    def look() -> None:
        page.look()
        idle(page.context.jobs, qtbot)

    click(page, "may.h5")
    with monkeypatch.context() as patch:
        patch.setattr("lfcal_gui.pages.sessions.page.iter_judged", at_once)
        QTest.mouseClick(page.judge_button, LEFT)
        idle(page.context.jobs, qtbot)
    assert "should not be used" in spoken(page, "may.h5") and NOT_JUDGED in spoken(page, "june.h5")
    assert facts(page)["Verdict"] == "This H should not be used."
    look()
    assert "should not be used" in spoken(page, "may.h5"), "kept"
    judged_elsewhere(page, folder, "june")
    assert "H of june is bad." in spoken(page, "june.h5"), "at once"
    look()
    assert "H of june is bad." in spoken(page, "june.h5")
    for day in ("may", "june"):
        save(matrix(), folder / day / f"{day}.h5")
    look()
    assert NOT_JUDGED in spoken(page, "may.h5") and NOT_JUDGED in spoken(page, "june.h5"), "they are other H"
    click(page, "may.h5")
    (folder / "may" / "may.h5").write_bytes(b"")
    page.judge()
    idle(page.context.jobs, qtbot)
    assert "may.h5" in page.notice.label.text() and NOT_JUDGED in spoken(page, "may.h5")


def test_a_cache_that_is_damaged_or_impossible_fails_nothing(tmp_path: Path) -> None:
    save(matrix(), tmp_path / "H.h5")
    (tmp_path / "file").touch()
    one, good = find_results(tmp_path).results[0], ("good", "This H is good.")
    nowhere, kept = KeptResults(tmp_path / "file" / "below"), KeptResults(tmp_path / "cache")
    assert nowhere.picture(one) is not None and nowhere.verdict(one) is None
    nowhere.keep_verdict(one, good)
    assert nowhere.verdict(one) is None
    nowhere.sweep()
    first = kept.picture(one)
    kept.keep_verdict(one, good)
    assert kept.verdict(one) == good
    for path in (tmp_path / "cache").iterdir():
        path.write_bytes(b"[")
    assert np.array_equal(kept.picture(one), first) and kept.verdict(one) is None  # type: ignore[arg-type]
