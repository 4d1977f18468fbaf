"""Checks of H: faults first, what shows them, positions to record again, the report."""

from __future__ import annotations

import re
import shutil
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import Qt
from pytestqt.qtbot import QtBot

from lfcal.acquire import Options, record
from lfcal.base import InputError, Progress, Work, drain
from lfcal.camera import ScanPlan
from lfcal.devices import Point, open_rig
from lfcal.fit import Setup, starting_effects
from lfcal.judge import Inspection
from lfcal.psf import PSFMatrix, save
from lfcal.simulate import sample_session
from lfcal.tasks import Assemble
from lfcal_gui.context import Context
from lfcal_gui.jobs import JobState
from lfcal_gui.models import FittedCamera, ProjectState, capital, stamp_of
from lfcal_gui.pages.h.checks_view import ChecksView
from lfcal_gui.pages.h.model_checks import (
    CheckPicture,
    CheckRow,
    InspectionRequest,
    InspectionRun,
    QualitySettings,
    asked_of,
    checks_of,
    count_words,
    iter_judge,
    map_of,
    worst_positions,
)
from lfcal_gui.pages.h.page import Page
from lfcal_gui.window import MainWindow
from tests.acquire.rigs import Deceived
from tests.gui.conftest import OpenPage
from tests.gui.waiting import GUARD_MS, idle
from tests.judge.common import added, clean, matrix, plan, sensor
from tests.judge.plain_report import undrawn

SECONDS = QualitySettings(seconds=600.0)


def faulty(path: Path) -> Path:
    """Write an H with a hot column, and a row of frames that were exposed too long."""
    image = sensor(0.0)
    image[:, 25] = 60.0
    values = added(clean(), image)
    values[0, 3:5] *= 1.6
    save(matrix(values), path)
    return path


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return faulty(tmp_path_factory.mktemp("faulty") / "H.h5")


@pytest.fixture
def state(written: Path, tmp_path: Path) -> ProjectState:
    """Return a project of a faulty H."""
    state = replace(ProjectState(), psf=str(shutil.copy(written, tmp_path / "H.h5")))
    return replace(state, settings=SECONDS.into(state))


@pytest.fixture(scope="module")
def judged_once(written: Path) -> InspectionRun:
    """Return what the faulty H is found to be."""
    stamp, kept = stamp_of(str(written)), InspectionRun()
    assert stamp is not None
    drain(iter_judge(asked_of(stamp, SECONDS, None), kept))
    assert kept.inspection.compared
    return kept


@pytest.fixture
def known(judged_once: InspectionRun, state: ProjectState, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the page's job know what the faulty H is found to be; all else that is asked is measured."""
    first = stamp_of(state.psf)

    def at_once(asked: InspectionRequest, kept: InspectionRun) -> Work[None]:
        if asked.stamp == first and asked.seconds == SECONDS.seconds and asked.setup is None and not asked.folder:
            kept.report, kept.depths, kept.inspection = judged_once.report, judged_once.depths, judged_once.inspection
        else:
            yield from iter_judge(asked, kept)

    monkeypatch.setattr("lfcal_gui.pages.h.model_checks.iter_judge", at_once)


@pytest.fixture
def page(open_page: OpenPage) -> Page:
    made: Page = open_page("h")
    return made


def found_by(page: Page, qtbot: QtBot) -> Inspection:
    """Open the checks, and wait for an inspection."""
    page.look_into("checks")
    idle(page.context.jobs, qtbot)
    assert page.checking.inspection is not None, view_of(page).message.text()
    return page.checking.inspection


def view_of(page: Page) -> ChecksView:
    assert page.checking.view is not None
    return page.checking.view


def row_of(page: Page, title: str) -> int:
    """Return the number of a check, and look at it."""
    number = next(k for k, one in enumerate(page.checking.checks) if one.title.startswith(capital(title)))
    view_of(page).table.choose(number)
    return number


def test_faults_come_first_with_what_shows_them(page: Page, qtbot: QtBot) -> None:
    found = found_by(page, qtbot)
    view, checks = view_of(page), page.checking.checks
    assert "hot line" in found.verdict and "patterns compared with the camera" in view.summary.text()
    faults = [one.title for one in checks if one.found in found.faults]
    assert faults == [capital(one.title) for one in found.faults] == [one.title for one in checks][: len(faults)]
    assert len(faults) >= 2 and view.table.item(0, 0).text() == "▲"
    row_of(page, "hot line of the sensor")
    assert "What to do" in view.words.text() and "counts" in view.words.text()
    assert view.pictures.currentWidget() is view.plotted and page.panel.map_title.text() == "Position error"
    position = next(one for one in found.quality.metrics if one.key == "position")
    page.set_intent(z=0)
    qtbot.waitUntil(lambda: np.array_equal(page.panel.map.values, position.map[0]), timeout=GUARD_MS)
    ringed = [list(place[1:]) for place in worst_positions(found) if place[0] == page.intent.z]
    assert ringed and ringed in [marks.points.tolist() for marks in page.panel.map.overlays]
    assert view.unit.text() == "counts"
    row_of(page, "single frames")
    idle(page.context.jobs, qtbot)
    check, shown = page.checking.chosen, page.panel.map
    assert isinstance(check, CheckRow) and shown.values is not None and page.intent.z == check.plane == 0
    here = check.positions[check.positions[:, 0] == 0, 1:]
    assert np.argwhere(shown.values > 0).tolist() == sorted(map(list, here.tolist()))
    assert len(here) in [len(marks.points) for marks in shown.overlays] and len(here) > 0
    assert view.pictures.currentWidget() is view.image and "record again" in check.words
    assert view.redo.text() == f"Record {len(found.redo())} positions again"


@pytest.mark.usefixtures("known")
def test_nothing_of_an_earlier_h_stays(page: Page, qtbot: QtBot, tmp_path: Path) -> None:
    found_by(page, qtbot)
    save(matrix(clean()), tmp_path / "other.h5")
    page.context.project.update("open", psf=str(tmp_path / "other.h5"))
    checking, view = page.checking, view_of(page)
    assert checking.inspection is None and view.stack.currentIndex() == 0, "nothing of the first is shown"
    found = found_by(page, qtbot)
    assert not found.faults and not any(one.found in found.faults for one in checking.checks)
    assert "hot" not in view.words.text().split("(")[0] and view.redo.isHidden()


@pytest.mark.long
def test_stopped_while_it_compares_the_metrics_stay(page: Page, qtbot: QtBot) -> None:
    seen: list[str] = []

    def stop(job: object) -> None:
        stage = getattr(getattr(job, "progress", None), "stage", "")
        seen.append(stage)
        if stage == "comparing with the camera":
            page.stop()

    page.context.jobs.changed.connect(stop)
    with qtbot.waitSignal(page.context.jobs.finished, timeout=GUARD_MS):
        page.look_into("checks")
    found = page.checking.inspection
    assert found.why_not == "it was stopped" and not found.compared
    assert "it was stopped" in view_of(page).summary.text() and view_of(page).stack.currentIndex() == 1
    assert "comparing with the camera" in seen and not page.stop_button.isEnabled()


@pytest.mark.long
@pytest.mark.usefixtures("known")
def test_without_time_only_the_metrics_are_measured(page: Page, qtbot: QtBot) -> None:
    found_by(page, qtbot)
    view_of(page).form.edited.emit("seconds", 0.0)
    assert "settings changed" in view_of(page).summary.text()
    page.checking.measure(force=True)
    idle(page.context.jobs, qtbot)
    found = page.checking.inspection
    assert "was left out" in found.why_not and found.why_not in found.verdict
    assert view_of(page).form.check("seconds", -1.0) and page.checking.settings.seconds == 0


@pytest.mark.usefixtures("known")
def test_metrics_point_at_their_fault_and_faults_at_the_atlas_the_report_and_positions(
    page: Page, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, asked = found_by(page, qtbot), list[tuple[str, str]]()
    words = view_of(page).words
    told = {row.title: row.rating for row in checks_of(found)}
    bad = [m for m in found.quality.metrics if m.merit in ("bad", "fair")]
    settled = [m.spec.title for m in bad if found.settled(m) is not None]
    assert settled and all(told[title] == "see fault" for title in settled)
    row_of(page, settled[0])
    assert "which causes it" in words.text()
    page.context.help_asked.connect(lambda *wanted: asked.append(wanted))
    for finding in found.faults:
        row_of(page, finding.title)
        link = re.search(r"href='(fault:\w+)'", words.text())
        words.linkActivated.emit(link[1])
        assert asked[-1] == ("faults.md", finding.name)
    undrawn(monkeypatch)
    page.checking.write_report(str(tmp_path / "report"))
    idle(page.context.jobs, qtbot)
    text = (tmp_path / "report" / "index.html").read_text(encoding="utf-8")
    assert found.verdict in text and "hot line of the sensor" in text
    page.checking.redo()
    assert page.context.state.redo == worst_positions(found) == tuple(place for place, _ in found.redo())


def test_the_camera_of_page_fit_is_taken_where_it_is_of_this_h(page: Page, tmp_path: Path) -> None:
    stamp = stamp_of(page.context.state.psf)
    assert stamp is not None
    setup = Setup(plan().camera, starting_effects(plan()), (0.0, 0.0))
    fitted, other = FittedCamera(stamp, setup), FittedCamera((str(tmp_path / "other.h5"), 0, 0), setup)
    asked = asked_of(stamp, SECONDS, fitted)
    assert asked.setup is setup and "the fit found it" in asked.source
    assert asked_of(stamp, SECONDS, other).setup is None
    assert asked_of(stamp, replace(SECONDS, camera="own"), fitted).setup is None


@pytest.mark.usefixtures("known")
def test_a_fit_found_later_is_offered_and_another_theme_leaves_what_is_chosen(page: Page, qtbot: QtBot) -> None:
    found_by(page, qtbot)
    view, stamp = view_of(page), stamp_of(page.context.state.psf)
    view.table.choose(1)
    words = view.words.text()
    page.theme_changed.emit()
    assert view.table.chosen() == 1 and view.words.text() == words
    assert stamp is not None and "settings changed" not in view.summary.text()
    page.context.set_fitted(FittedCamera(stamp, Setup(plan().camera, starting_effects(plan()), (0.0, 0.0))))
    assert "settings changed" in view.summary.text()


def test_settings_that_are_none_are_refused_and_the_limit_of_an_old_project_is_the_new_default() -> None:
    for changes in ({"seconds": float("nan")}, {"seconds": -1.0}, {"camera": "other"}):
        with pytest.raises(InputError):
            replace(SECONDS, **changes)  # type: ignore[arg-type]
    # 10 s, the default of 0.1, ended before H was fully judged
    assert QualitySettings.from_dict({"seconds": 10.0, "by_number": True}) == QualitySettings(by_number=True)
    assert QualitySettings.from_dict({"seconds": 0.0}).seconds == 0.0
    for seconds in (10.0, 60.0):
        chosen = QualitySettings(seconds=seconds)
        assert QualitySettings.from_dict(chosen.to_dict()) == chosen


def test_what_was_found_stays_where_the_next_inspection_fails_and_one_report_is_written_at_a_time(
    open_page: OpenPage, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page: Page = open_page("h")
    project, jobs, checking = page.context.project, page.context.jobs, page.checking
    project.update("open", psf=str(with_a_gap(tmp_path / "gap.h5")))
    page.look_into("checks")
    idle(jobs, qtbot)
    checking.write_report(str(tmp_path / "report"))
    view = view_of(page)
    assert not view.report_button.isEnabled() and view.measure_button.isEnabled()
    jobs.cancel_all()
    idle(jobs, qtbot)
    assert view.report_button.isEnabled()
    counts, settings = view.counts.text(), checking.settings

    def fails(asked: Any, kept: Any) -> Work[None]:
        yield Progress(0, 1, "reading")
        raise InputError("no memory; close something")

    monkeypatch.setattr("lfcal_gui.pages.h.model_checks.iter_judge", fails)
    longer = replace(settings, seconds=settings.seconds + 60)
    project.update("seconds", settings=longer.into(project.state))
    checking.measure(force=True)
    idle(jobs, qtbot)
    assert view.counts.text() == counts and view.stack.currentIndex() == 1
    assert "Earlier results" in page.notice.label.text()
    assert "settings changed since" in view.summary.text(), "these were not used"


def test_a_folder_that_is_no_fit_is_said(page: Page, qtbot: QtBot, tmp_path: Path) -> None:
    view = page.checking.make_view()
    page.checking.choose_fit(str(tmp_path))
    assert page.checking.settings.camera == "saved" and view.form.editor("camera").findData("saved") >= 0
    page.checking.measure()
    idle(page.context.jobs, qtbot)
    assert page.checking.inspection is None and "fit.json" in view_of(page).message.text()


def with_a_gap(path: Path) -> Path:
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
    window.project.update("open", psf=str(with_a_gap(tmp_path / "H.h5")))
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
    assert (
        listed[missing].value == "1 frame"
        and ", bad (0 frames is good; larger values are rated by" in listed[missing].words
    )
    for cost, merit, rating in ((0.2, "bad", "bad"), (0.05, "fair", "fair"), (0.01, "fair", "repeat")):
        rated = tuple(replace(one, cost=cost) if one.key == "missing" else one for one in found.quality.metrics)
        others = replace(found, quality=replace(found.quality, metrics=rated))
        told = next(one for one in checks_of(others) if one.title == "Missing frames")
        assert (told.merit, told.rating) == (merit, rating), "the word follows the cost; no tick where frames are bad"
        assert (
            f", {rating} (0 frames is good; larger values are rated by their cost: fair from 0.03, bad from 0.1)"
            in told.words
        )
        assert ("1 to repeat" in count_words(others)) is (rating == "repeat")
    page.panel.level_asked.emit("")
    # the plane may still be read
    qtbot.waitUntil(lambda: page.panel.map_title.text() == "Position error", timeout=GUARD_MS)
    assert [[2, 3]] in [marks.points.tolist() for marks in page.panel.map.overlays], "crossed out or ringed"


@pytest.mark.parametrize("key", ["h", "accuracy"])
def test_stop_ends_every_job_of_its_page(open_page: OpenPage, context: Context, qtbot: QtBot, key: str) -> None:
    context.project.start(ProjectState())
    page, started = open_page(key), threading.Event()

    def report() -> Work[None]:
        while True:
            yield Progress(0, 1, "writing")
            started.set()

    assert not page.stop_button.isEnabled()
    number = context.jobs.start("Report", key, report)
    qtbot.waitUntil(started.is_set, timeout=GUARD_MS)
    assert page.stop_button.isEnabled() and not page.stop_button.isHidden()
    page.stop_button.click()
    idle(context.jobs, qtbot)
    assert not page.stop_button.isEnabled()
    assert {job.number: job.state for job in context.jobs.jobs()}[number] is JobState.CANCELLED


def test_a_job_of_the_next_step_has_one_button_stop(window: MainWindow, qtbot: QtBot) -> None:
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


def rows(*names: str) -> tuple[CheckRow, ...]:
    nothing: Any = None
    return tuple(CheckRow(nothing, k, "1", "< 2", "> 3", "good", "good", "–", k) for k in names)


@pytest.fixture
def checks_view(qtbot: QtBot) -> ChecksView:
    made = ChecksView()
    qtbot.addWidget(made)
    return made


def test_the_first_check_of_a_second_inspection_is_explained_too(checks_view: ChecksView) -> None:
    """The row chosen stays the same, but it shows another inspection."""
    chosen: list[int] = []
    checks_view.chosen.connect(chosen.append)
    checks_view.show_checks("", rows("first", "second"))
    checks_view.show_checks("", rows("second", "first"))
    assert chosen == [0, 0] and checks_view.table.currentRow() == 0
    checks_view.table.selectRow(1)
    assert chosen == [0, 0, 1]


def test_checks_sorted_by_hand_still_show_their_own(checks_view: ChecksView) -> None:
    seen: list[int] = []
    checks_view.chosen.connect(seen.append)
    checks_view.show_checks("", rows("b", "a"))
    checks_view.table.clearSelection()
    checks_view.table.sortItems(1)
    checks_view.table.selectRow(0)
    assert seen == [0, 1], "'a' was given as the second"


def test_a_narrow_table_hides_columns_and_maps_are_numbered_from_their_origin(checks_view: ChecksView) -> None:
    checks_view.show()
    checks_view.show_checks("", rows("a"))
    checks_view.table.resize(280, 200)
    assert checks_view.table.isColumnHidden(3) and "< 2\t> 3" in checks_view.table.text()
    checks_view.table.resize(900, 200)
    assert not checks_view.table.isColumnHidden(3)
    checks_view.show_check("", CheckPicture("Left", ("down (px)", "across (px)"), "%", np.eye(5), origin=(-2, -2)))
    assert checks_view.image.shot.origin == (-2, -2)
    checks_view.show_check("", CheckPicture("Sensor", ("row (px)", "column (px)"), "counts", np.eye(5)))
    assert checks_view.image.shot.origin == (0, 0), "the next one starts at 0 again"


BAD = ((0, 3, 4), (0, 9, 20), (0, 15, 7))


@pytest.fixture
def sampled() -> ScanPlan:
    """Return a plane of the sample."""
    sample = ScanPlan.from_json((sample_session() / "plan.json").read_text(encoding="utf-8"))
    return replace(sample, depths_um=sample.depths_um[:1], settle_s=0.0)


@pytest.fixture
def session(sampled: ScanPlan, tmp_path: Path) -> Path:
    """Record with a stage that is displaced at a few positions, which its encoder does not see."""
    bad = sampled.stage_um(np.array(BAD))

    def true(_: int, target: Point) -> Point:
        off = float(np.abs(bad - target).max(axis=1).min()) < 1.0
        return (target[0] + 60.0, target[1] + 40.0, target[2]) if off else target

    folder = tmp_path / "session"
    with open_rig(sampled, "sim", {}) as rig:
        deceived = replace(rig, stage=Deceived(rig.stage, true))
        record(folder, sampled, deceived, Options(reference_every=0, check_stage=False))
    drain(Assemble(frames=folder, out=folder / "H.h5").work())[0].report.matrix.close()
    return folder


@pytest.mark.long
def test_bad_positions_are_recorded_again(window: MainWindow, qtbot: QtBot, sampled: ScanPlan, session: Path) -> None:
    first = session / "H.h5"
    window.project.update("bad", plan=sampled, camera=sampled.camera, recording=str(session), psf=str(first))
    window.go("acquire")
    acquire: Any = window.page("acquire")
    qtbot.waitUntil(lambda: acquire.panel.setup.devices.backend.count() > 0, timeout=GUARD_MS)
    acquire.setup.connect_devices()
    qtbot.waitUntil(lambda: acquire.setup.station is not None, timeout=GUARD_MS)
    window.go("h", "checks")
    psf: Any = window.page("h")
    checking = psf.checking
    qtbot.waitUntil(lambda: checking.inspection is not None, timeout=GUARD_MS)
    before, button = checking.inspection, checking.view.redo
    assert {place for place, _ in before.redo()} == set(BAD) and before.merit != "good"
    kept = first.read_bytes()
    assert button.text() == "Record 3 positions again"
    qtbot.mouseClick(button, Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: window.project.state.psf == str(session / "H-2.h5"), timeout=GUARD_MS)
    qtbot.waitUntil(lambda: psf.plane is not None and psf.reference_plane is not None, timeout=GUARD_MS)
    assert window.stack.currentWidget() is psf
    assert (psf.intent.z, psf.intent.y, psf.intent.x) in BAD and psf.intent.view == "difference"
    qtbot.waitUntil(lambda: checking.inspection is not None and not checking._job, timeout=GUARD_MS)
    assert checking.inspection.merit == "good" and not checking.inspection.redo() and button.isHidden()
    assert first.read_bytes() == kept and window.project.state.reference == str(first)
    idle(window.jobs, qtbot)
