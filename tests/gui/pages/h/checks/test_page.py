from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import Qt
from pytestqt.qtbot import QtBot

from lfcal.base.errors import InputError
from lfcal.base.progress import Progress, Work
from lfcal.psf import PSFMatrix, save
from lfcal_gui.jobs import JobState
from lfcal_gui.pages.h.model_checks import checks_of, count_words, map_of, worst_positions
from lfcal_gui.window import MainWindow
from tests.gui.waiting import GUARD_MS, idle


def faulty(path: Path) -> Path:
    """Write a small H in which one frame is missing."""
    r, c = np.mgrid[-10:11, -10:11]
    values = np.zeros((2, 5, 6, 21, 21), np.float32)
    for z, y, x in np.ndindex(2, 5, 6):
        lens = np.cos(np.pi * (r + y) / 5) ** 2 * np.cos(np.pi * (c + x) / 6) ** 2
        values[z, y, x] = 1000 * lens * np.exp(-(r**2 + c**2) / (18.0 + 10 * z))
    values[1, 2, 3] = 0
    recorded = np.ones((2, 5, 6))
    recorded[1, 2, 3] = 0
    save(PSFMatrix(values, recorded=recorded, depths=[-1000, 1000]), path)
    return path


def test_from_h_to_the_list_of_positions(window: MainWindow, qtbot: QtBot, tmp_path: Path) -> None:
    window.project.update("open", psf=str(faulty(tmp_path / "H.h5")))
    with qtbot.waitSignal(window.jobs.finished, timeout=GUARD_MS) as end:
        window.go("h", "checks")
    assert not end.args[0].error
    page: Any = window.page("h")
    idle(window.jobs, qtbot)
    found, view = page.checking.inspection, page.checking.view
    listed, every = checks_of(found), checks_of(found, every=True)
    assert view.table.rowCount() == len(listed) < len(every) == len(found.quality.metrics)
    assert "not applicable" in view.counts.text()
    view.every.click()
    assert view.table.rowCount() == len(every)
    view.every.click()
    said = page.panel.verdict.sentence
    assert found.verdict == (said.toolTip() or said.text()) and found.verdict.startswith(said.text())
    assert "H has no camera" in view.summary.text()
    assert (1, 2, 3) in worst_positions(found)
    ranks = [("bad", "fair", "unknown", "good").index(one.merit) for one in listed]
    assert ranks == sorted(ranks) and ranks[0] == 0, "what failed comes first"
    missing = next(k for k, one in enumerate(listed) if "issing" in one.title)
    view.table.choose(missing)
    assert "What to do" in listed[missing].words and view.words.text()
    assert page.intent.z == 1, "the plane that it concerns is shown"
    assert page.panel.map_range.text() == "1 in this plane", "it was: 0 to 1 yes / no"
    mapped = [one for one in every if map_of(found, one, 1) is not None]
    assert mapped and map_of(found, mapped[0], 99) is None
    view.redo.click()
    assert (1, 2, 3) in window.project.state.redo
    acquire = window.page("acquire")
    assert window.stack.currentWidget() is acquire and acquire.empty is not None, "there is no plan"
    window.go("h")
    page.panel.map.chosen.emit(2, 3)
    assert (page.intent.z, page.intent.y, page.intent.x) == (1, 2, 3)
    row = page.panel.rows["checks"]
    state, many = row.state.text(), sum(not metric.applies for metric in found.quality.metrics)
    assert row.name.text() == "Checks" and f"{many} not applicable" in state
    assert sum(int(part.split()[0]) for part in state.split(", ")) == len(listed) + many, "all rows are counted"
    assert listed[missing].value == "1 frame" and ", bad (0 frames is good, more are rated by" in listed[missing].words
    for cost, merit, rating in ((0.2, "bad", "bad"), (0.05, "fair", "fair"), (0.01, "fair", "repeat")):
        rated = tuple(replace(one, cost=cost) if one.key == "missing" else one for one in found.quality.metrics)
        others = replace(found, quality=replace(found.quality, metrics=rated))
        told = next(one for one in checks_of(others) if one.title == "Missing frames")
        assert (told.merit, told.rating) == (merit, rating), "the word follows the cost; no tick where frames are bad"
        assert (
            f", {rating} (0 frames is good, more are rated by their cost: from 0.03 fair, from 0.1 bad)" in told.words
        )
        assert ("1 to repeat" in count_words(others)) is (rating == "repeat")
    page.panel.level_asked.emit("")
    assert page.panel.map_title.text() == "Position error"
    assert [[2, 3]] in [marks.points.tolist() for marks in page.panel.map.overlays], "crossed out or ringed"


@pytest.mark.parametrize("key", ["h", "accuracy"])
def test_stop_ends_every_job_of_its_page(window: MainWindow, qtbot: QtBot, key: str) -> None:
    """A report could be stopped in the dock Jobs alone, beside a button Stop that was grey."""
    page: Any = window.page(key)
    going_on = threading.Event()

    def report() -> Work[None]:
        while True:
            yield Progress(0, 1, "writing")
            going_on.set()

    assert not page.stop_button.isEnabled()
    number = window.jobs.start("Report", key, report)
    qtbot.waitUntil(going_on.is_set, timeout=GUARD_MS)
    assert page.stop_button.isEnabled() and not page.stop_button.isHidden()
    page.stop_button.click()
    idle(window.jobs, qtbot)
    assert not page.stop_button.isEnabled()
    assert {job.number: job.state for job in window.jobs.jobs()}[number] is JobState.CANCELLED


def test_a_job_of_the_next_step_has_one_button_stop(window: MainWindow, qtbot: QtBot) -> None:
    """Judging could be stopped in the header, and in the view bar right below."""
    window.go("h")
    page: Any = window.page("h")
    going_on = threading.Event()

    def judging() -> Work[None]:
        while True:
            yield Progress(0, 1, "inspecting")
            going_on.set()

    window.jobs.start("Inspect H.h5", "h", judging, kind="judge")
    qtbot.waitUntil(going_on.is_set, timeout=GUARD_MS)
    window.leading.gather()
    assert window.leading.sitting.job == "judge" and page.stop_button.isHidden()
    qtbot.keyClick(page, Qt.Key.Key_Escape)
    idle(window.jobs, qtbot)


def test_what_was_found_before_is_said_to_be_where_the_next_inspection_fails(
    window: MainWindow, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    window.project.update("open", psf=str(faulty(tmp_path / "H.h5")))
    page: Any = window.page("h")
    page.look_into("checks")
    idle(window.jobs, qtbot)
    checking = page.checking
    counts, settings = checking.view.counts.text(), checking.settings

    def fails(asked: Any, kept: Any) -> Work[None]:
        yield Progress(0, 1, "reading")
        raise InputError("no memory; close something")

    monkeypatch.setattr("lfcal_gui.pages.h.model_checks.iter_judge", fails)
    state = window.project.state
    window.project.update("seconds", settings=replace(settings, seconds=settings.seconds + 60).into(state))
    checking.measure(force=True)
    idle(window.jobs, qtbot)
    assert checking.view.counts.text() == counts and checking.view.stack.currentIndex() == 1
    assert "Earlier results" in page.notice.label.text()
    assert "settings changed since" in checking.view.summary.text(), "these were not used"


def test_one_report_at_a_time(window: MainWindow, qtbot: QtBot, tmp_path: Path) -> None:
    window.project.update("open", psf=str(faulty(tmp_path / "H.h5")))
    page: Any = window.page("h")
    page.look_into("checks")
    idle(window.jobs, qtbot)
    page.checking.write_report(str(tmp_path / "report"))
    view = page.checking.view
    assert not view.report_button.isEnabled() and view.measure_button.isEnabled()
    window.jobs.cancel_all()
    idle(window.jobs, qtbot)
    assert view.report_button.isEnabled()


def test_nothing_to_judge(window: MainWindow) -> None:
    window.go("h", "checks")
    page: Any = window.page("h")
    assert page.checking.inspection is None and not page.checking.view.report_button.isEnabled()
    assert "No H" in page.empty.label.text()


def test_a_damaged_h_says_so(window: MainWindow, qtbot: QtBot, tmp_path: Path) -> None:
    (tmp_path / "H.h5").write_bytes(b"no hdf5")
    window.project.update("open", psf=str(tmp_path / "H.h5"))
    page: Any = window.page("h")
    page.checking.write_report(str(tmp_path / "report"))
    page.look_into("checks")
    idle(window.jobs, qtbot)
    assert window.log_view.toPlainText().count("HDF5") >= 2 and "HDF5" in page.checking.view.message.text()
