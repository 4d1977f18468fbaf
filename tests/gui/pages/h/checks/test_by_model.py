"""Checks of H by the camera's model: faults first, what shows them, the fitted camera, stopping, another H."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pytestqt.qtbot import QtBot

from lfcal.base.errors import InputError
from lfcal.base.progress import Work, drain
from lfcal.fit.setup import Setup, starting_effects
from lfcal.judge import Inspection
from lfcal.psf import save
from lfcal_gui.models import capital
from lfcal_gui.models.project import ProjectState
from lfcal_gui.models.stamp import FittedCamera, stamp_of
from lfcal_gui.pages.h.checks_view import ChecksView
from lfcal_gui.pages.h.model_checks import (
    CheckRow,
    InspectionRequest,
    InspectionRun,
    QualitySettings,
    asked_of,
    checks_of,
    iter_judge,
    worst_positions,
)
from lfcal_gui.pages.h.page import Page
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
    assert kept.inspection is not None and kept.inspection.compared
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
    assert len(faults) >= 2 and view.table.item(0, 0).text() == "▲"  # type: ignore[union-attr]
    row_of(page, "hot line of the sensor")
    assert "What to do" in view.words.text() and "counts" in view.words.text()
    assert view.pictures.currentWidget() is view.plotted and page.panel.map_title.text() == "Position error"
    position = next(one for one in found.quality.metrics if one.key == "position")
    assert position.map is not None
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
def test_metrics_that_a_fault_makes_point_at_it(page: Page, qtbot: QtBot) -> None:
    found = found_by(page, qtbot)
    told = {row.title: row.rating for row in checks_of(found)}
    bad = [m for m in found.quality.metrics if m.merit in ("bad", "fair")]
    settled = [m.spec.title for m in bad if found.settled(m) is not None]
    assert settled and all(told[title] == "see fault" for title in settled)
    row_of(page, settled[0])
    assert "which causes it" in view_of(page).words.text()


@pytest.mark.usefixtures("known")
def test_positions_to_record_again_are_those_of_the_whole_inspection(page: Page, qtbot: QtBot) -> None:
    found = found_by(page, qtbot)
    page.checking.redo()
    assert page.context.state.redo == worst_positions(found) == tuple(place for place, _ in found.redo())


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
@pytest.mark.usefixtures("known")
def test_a_file_written_anew_is_inspected_anew(page: Page, qtbot: QtBot, tmp_path: Path) -> None:
    found_by(page, qtbot)
    save(matrix(clean()[:, :, :, 4:-4, 4:-4]), tmp_path / "H.h5")
    page.checking.follow()
    assert page.checking.inspection is None
    assert found_by(page, qtbot).quality.shape[3:] == (33, 33)


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
    assert found is not None and found.why_not == "it was stopped" and not found.compared
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
    assert found is not None and "was left out" in found.why_not and found.why_not in found.verdict
    assert view_of(page).form.check("seconds", -1.0) and page.checking.settings.seconds == 0


def test_the_camera_of_page_fit_is_taken_where_it_is_of_this_h(page: Page, tmp_path: Path) -> None:
    stamp = stamp_of(page.context.state.psf)
    assert stamp is not None
    setup = Setup(plan().camera, starting_effects(plan()), (0.0, 0.0))
    fitted, other = FittedCamera(stamp, setup), FittedCamera((str(tmp_path / "other.h5"), 0, 0), setup)
    assert (
        asked_of(stamp, SECONDS, fitted).setup is setup
        and "the fit found it" in asked_of(stamp, SECONDS, fitted).source
    )
    assert asked_of(stamp, SECONDS, other).setup is None
    assert asked_of(stamp, replace(SECONDS, camera="own"), fitted).setup is None


@pytest.mark.usefixtures("known")
def test_a_fit_found_later_is_offered(page: Page, qtbot: QtBot) -> None:
    found_by(page, qtbot)
    stamp = stamp_of(page.context.state.psf)
    assert stamp is not None and "settings changed" not in view_of(page).summary.text()
    page.context.set_fitted(FittedCamera(stamp, Setup(plan().camera, starting_effects(plan()), (0.0, 0.0))))
    assert "settings changed" in view_of(page).summary.text()


@pytest.mark.long
@pytest.mark.usefixtures("known")
def test_a_fit_found_later_is_compared_with(page: Page, qtbot: QtBot) -> None:
    found_by(page, qtbot)
    stamp = stamp_of(page.context.state.psf)
    assert stamp is not None
    page.context.set_fitted(FittedCamera(stamp, Setup(plan().camera, starting_effects(plan()), (0.0, 0.0))))
    page.checking.measure(force=True)
    idle(page.context.jobs, qtbot)
    assert page.checking.inspection is not None and page.checking.inspection.compared
    assert "as the fit found it" in view_of(page).summary.text()


def test_a_folder_that_is_no_fit_is_said(page: Page, qtbot: QtBot, tmp_path: Path) -> None:
    view = page.checking.make_view()
    page.checking.choose_fit(str(tmp_path))
    assert page.checking.settings.camera == "saved" and view.form.editor("camera").findData("saved") >= 0
    page.checking.measure()
    idle(page.context.jobs, qtbot)
    assert page.checking.inspection is None and "fit.json" in view_of(page).message.text()


@pytest.mark.usefixtures("known")
def test_the_report_tells_what_the_page_shows(
    page: Page, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    undrawn(monkeypatch)
    found = found_by(page, qtbot)
    page.checking.write_report(str(tmp_path / "report"))
    idle(page.context.jobs, qtbot)
    text = (tmp_path / "report" / "index.html").read_text(encoding="utf-8")
    assert found.verdict in text and "hot line of the sensor" in text


@pytest.mark.parametrize("changes", [{"seconds": float("nan")}, {"seconds": -1.0}, {"camera": "other"}])
def test_settings_that_are_none_are_refused(changes: dict[str, object]) -> None:
    with pytest.raises(InputError):
        replace(SECONDS, **changes)  # type: ignore[arg-type]


@pytest.mark.usefixtures("known")
def test_a_fault_leads_to_its_section_of_the_atlas(page: Page, qtbot: QtBot) -> None:
    found, asked = found_by(page, qtbot), list[tuple[str, str]]()
    page.context.help_asked.connect(lambda *wanted: asked.append(wanted))
    words = view_of(page).words
    for finding in found.faults:
        row_of(page, finding.title)
        link = re.search(r"href='(fault:\w+)'", words.text())
        assert link is not None
        words.linkActivated.emit(link[1])
        assert asked[-1] == ("faults.md", finding.name)


@pytest.mark.long
@pytest.mark.usefixtures("known")
def test_another_theme_leaves_what_is_chosen(page: Page, qtbot: QtBot) -> None:
    """The tables are drawn anew in the theme's colours, and began with their first row."""
    found_by(page, qtbot)
    view = view_of(page)
    assert view.table.rowCount() > 1 and view.table.chosen() == 0
    for number in (1, 5):
        view.table.choose(number)
        words = view.words.text()
        page.theme_changed.emit()
        assert view.table.chosen() == number and view.words.text() == words


def test_the_limit_of_an_old_project_is_the_new_default() -> None:
    """10 s, the default of 0.1, ended before H was fully judged."""
    assert QualitySettings.from_dict({"seconds": 10.0, "by_number": True}) == QualitySettings(by_number=True)
    assert QualitySettings.from_dict({"seconds": 0.0}).seconds == 0.0
    for seconds in (10.0, 60.0):
        chosen = QualitySettings(seconds=seconds)
        assert QualitySettings.from_dict(chosen.to_dict()) == chosen
