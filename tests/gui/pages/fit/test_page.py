"""The Fit page: from H to the camera, what is shown of it, and what is made of it."""

from __future__ import annotations

import gc
import json
import threading
import weakref
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtGui import QColor
from PySide6.QtWidgets import QApplication, QComboBox
from pytestqt.qtbot import QtBot

from gui.context import Context
from gui.jobs import JobState
from gui.models.page import PageState
from gui.models.project import ProjectState
from gui.pages.fit import PAGE
from gui.pages.fit.model import FitSettings
from gui.pages.fit.model_run import Kept, Question, asked_of, iter_fit
from gui.pages.fit.page import Page
from gui.theme import DARK, LIGHT, apply_theme
from gui.window import MainWindow
from lfcal.fit.files import measured_camera
from lfcal.fit.writing import fit_outputs
from lfcal.progress import Progress, Work, drain
from lfcal.psf import open_psf
from tests.fit.common import few_patterns
from tests.gui.conftest import OpenPage
from tests.gui.pages.fit.common import GEOMETRY, project_of, saved, with_outlier
from tests.gui.waiting import GUARD_MS, idle


@pytest.fixture
def state(tmp_path: Path) -> ProjectState:
    return project_of(saved(tmp_path / "H.h5"))


@pytest.fixture
def page(open_page: OpenPage, qtbot: QtBot) -> Page:
    made: Page = open_page("fit", height=680)
    idle(made.context.jobs, qtbot)
    return made


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> Kept:
    """Return what a fit of the tiny H tells and finds, computed once."""
    kept, project = Kept(), project_of(saved(tmp_path_factory.mktemp("fit") / "H.h5"))
    drain(iter_fit(asked_of(project, GEOMETRY), kept))
    return kept


@pytest.fixture
def fitted(page: Page, known: Kept, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> Page:
    """Return the page after a fit, whose result was computed before."""

    def again(asked: Question, kept: Kept) -> Work[None]:
        yield Progress(0, 1, "known")
        assert known.found is not None
        kept.rounds += known.rounds
        kept.found = replace(known.found, question=asked)

    monkeypatch.setattr("gui.pages.fit.page.iter_fit", again)
    page.fit_button.click()
    idle(page.context.jobs, qtbot)
    assert page.found is not None
    return page


def button_states(page: Page) -> list[bool]:
    return [b.isEnabled() for b in (page.use_button, page.model_button, page.save_button, page.report_button)]


# -- fitting -----------------------------------------------------------------------------------------------
def test_from_h_to_the_camera(page: Page, qtbot: QtBot) -> None:
    panel = page.panel
    assert panel.choices.source.text() == "H.h5: 6 of 8 positions recorded, 1 plane"
    assert panel.stack.currentWidget() is panel.ready and not any(button_states(page))
    page.fit_button.click()
    assert page.stop_button.isEnabled() and not page.fit_button.isEnabled() and not panel.choices.form.isEnabled()
    assert panel.stack.currentWidget() is panel.running
    idle(page.context.jobs, qtbot)
    found = page.found
    assert found is not None and panel.stack.currentWidget() is panel.tabs and all(button_states(page))
    fit = found.fit
    assert fit.parameters["gap_um"].value == pytest.approx(1.01 * few_patterns().camera.lattice.gap_um, rel=1e-3)  # type: ignore[union-attr]
    table = panel.parameters
    assert table.rowCount() == len(fit.parameters) == 4
    assert "explains the patterns" in panel.verdict.text()
    assert QColor(LIGHT.good).name() in panel.verdict.styleSheet()
    kinds = [panel.findings.item(k, 0).text() for k in range(panel.findings.rowCount())]
    assert kinds == ["held", "fitted"]
    rounds = panel.rounds.error.line.getData()
    assert len(rounds[0]) >= 3 and rounds[1][-1] < rounds[1][0]
    assert page.context.jobs.jobs()[0].result is None, "jobs are remembered for ever: they must not hold patterns"


def test_pictures_of_a_position(fitted: Page) -> None:
    panel, found = fitted.panel, fitted.found
    assert found is not None
    view = panel.patterns
    assert view.place == found.places[0] and len(view.map.places) == 6
    view.step(2)
    place = found.places[2]
    assert view.place == place
    for picture, values in ((view.measured, found.patterns), (view.model, found.model)):
        np.testing.assert_array_equal(picture.image, values[place])
    np.testing.assert_array_equal(view.residual.image, found.fit.residual(*place))
    assert view.residual.bar.levels() == (-5.0, 5.0)
    assert f"χ² {found.chi2[place]:.3g}" in view.words.text()
    view.model.hovered.emit(3, 4, 0.0)
    assert f"t 3, s 4: measured {found.patterns[place][3, 4]:.5g}" in view.readout.text() and "σ" in view.readout.text()
    assert all(one.cursor.isVisible() and one.cursor.pos().x() == 4 for one in view.views)
    view.worst_button.click()
    assert view.place == max(found.places, key=lambda one: found.chi2[one])
    view.map.chosen.emit(found.places[4])
    assert view.place == found.places[4] and view.patterns.value() == 4
    fitted.receive((0, 99, 99))
    assert view.place == found.places[4]


def test_pictures_are_zoomed_together(fitted: Page) -> None:
    view = fitted.panel.patterns
    QApplication.processEvents()
    box = view.model.plot.getViewBox()
    box.setRange(xRange=(4, 8), yRange=(5, 9), padding=0)
    box.sigRangeChangedManually.emit([True, True])
    for one in view.views:
        (left, right), (top, bottom) = one.plot.getViewBox().viewRange()
        assert (left + right) / 2 == pytest.approx(6, abs=0.2) and (top + bottom) / 2 == pytest.approx(7, abs=0.2)
        assert right - left < 14
    view.residual.show_all()
    for one in view.views:
        (left, right), _ = one.plot.getViewBox().viewRange()
        assert left <= -0.5 and right >= 14.5


def test_parameters_are_sorted_by_number_and_copied(fitted: Page, qtbot: QtBot) -> None:
    table, found = fitted.panel.parameters, fitted.found
    assert found is not None
    table.sortItems(3, Qt.SortOrder.DescendingOrder)
    assert table.item(0, 0).text() == "gap_um" and table.number_of(0) == 0
    table.sortItems(5, Qt.SortOrder.AscendingOrder)
    away = [found.fit.parameters[table.item(k, 0).text()] for k in range(4)]
    numbers = [(one.value - one.start) / one.sigma for one in away]
    assert numbers == sorted(numbers)
    table.clearSelection()
    qtbot.keyClick(table, Qt.Key.Key_C, Qt.KeyboardModifier.ControlModifier)
    lines = QApplication.clipboard().text().splitlines()
    assert lines[0].split("\t")[:3] == ["Parameter", "Found", "± σ"] and len(lines) == 5
    table.selectRow(1)
    table.copy()
    assert len(QApplication.clipboard().text().splitlines()) == 2


def test_an_outlier_is_found_by_its_line(page: Page, qtbot: QtBot, tmp_path: Path) -> None:
    page.context.project.update("open", psf=str(saved(tmp_path / "outlier.h5", with_outlier())))
    page.fit()
    idle(page.context.jobs, qtbot)
    panel = page.panel
    assert page.found is not None and len(page.found.fit.outliers) == 1
    panel.tabs.setCurrentWidget(panel.findings)
    panel.findings.selectRow(0)
    assert panel.tabs.currentWidget() is panel.patterns
    one = page.found.fit.outliers[0]
    assert panel.patterns.place == (one.z, one.y, one.x) and "left out" in panel.patterns.words.text()
    panel.tabs.setCurrentWidget(panel.findings)
    panel.findings.cellClicked.emit(0, 1)
    assert panel.tabs.currentWidget() is panel.patterns, "a row that is selected already is clicked again"


def test_an_incomplete_model_says_so(fitted: Page) -> None:
    found = fitted.found
    assert found is not None
    worse = replace(found.fit, chi_square=replace(found.fit.chi_square, lit=2.0, sigma=0.05))
    fitted.found = replace(found, fit=worse)
    fitted.entered()
    verdict = fitted.panel.verdict
    assert verdict.text().startswith("The model is incomplete") and QColor(LIGHT.bad).name() in verdict.styleSheet()


# -- what goes wrong ---------------------------------------------------------------------------------------
def test_nothing_to_fit(window: MainWindow) -> None:
    window.go("fit")
    page: Any = window.page("fit")
    assert "Nothing to fit yet" in page.empty.label.text() and not page.fit_button.isEnabled()
    assert PAGE.state(ProjectState()) is PageState.NOTHING


def test_an_error_is_one_line_in_the_page(page: Page, qtbot: QtBot, tmp_path: Path) -> None:
    other = replace(GEOMETRY, camera="window", positions=5)
    project = page.context.project
    project.update("choices", settings=other.into(project.state))
    H = few_patterns()
    values = np.random.default_rng(1).normal(0, 8, H.shape).astype(np.float32)
    dark = type(H)(values, depths=H.depths, camera=H.camera, anchor=H.anchor, facts=H.facts)
    project.update("open", psf=str(saved(tmp_path / "dark.h5", dark)))
    page.fit()
    idle(page.context.jobs, qtbot)
    words = page.panel.verdict.text()
    assert words.startswith("light of the patterns: expected more than their noise") and "\n" not in words
    assert page.found is None and page.fit_button.isEnabled() and not any(button_states(page))


def test_a_fit_that_is_stopped_leaves_the_one_before(fitted: Page, qtbot: QtBot) -> None:
    before = fitted.found
    assert before is not None
    fitted.fit()
    qtbot.keyClick(fitted, Qt.Key.Key_Escape)
    idle(fitted.context.jobs, qtbot)
    assert fitted.found is before and fitted.fit_button.isEnabled() and all(button_states(fitted))
    assert fitted.panel.stack.currentWidget() is fitted.panel.tabs


def test_stopping_waits_for_no_computation(page: Page, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> None:
    """Between two records a fit computes for seconds: the window must not wait for it."""
    inside, let_go = threading.Event(), threading.Event()

    def slow(*_: object) -> Any:
        yield Progress(0, 2, "slow")
        inside.set()
        let_go.wait(GUARD_MS / 1e3)
        yield Progress(1, 2, "slow")

    monkeypatch.setattr("gui.pages.fit.page.iter_fit", slow)
    page.fit()
    qtbot.waitUntil(inside.is_set, timeout=GUARD_MS)
    page.stop_button.click()
    assert page.context.jobs.jobs()[0].state is JobState.CANCELLED
    assert page.fit_button.isEnabled() and page.panel.verdict.text() == "Stopped."
    let_go.set()
    idle(page.context.jobs, qtbot)


# -- another H ---------------------------------------------------------------------------------------------
def test_nothing_of_an_h_is_shown_beside_another(fitted: Page, qtbot: QtBot, tmp_path: Path) -> None:
    there = weakref.ref(fitted.found)
    panel = fitted.panel
    fitted.context.project.update("open", psf=str(saved(tmp_path / "other.h5")))
    idle(fitted.context.jobs, qtbot)
    assert panel.stack.currentWidget() is panel.ready and not any(button_states(fitted))
    assert panel.parameters.rowCount() == panel.findings.rowCount() == 0 and panel.patterns.measured.image is None
    assert panel.status.isHidden() and panel.choices.source.text().startswith("other.h5")
    gc.collect()
    assert there() is None, "its patterns may be large"


def test_a_file_that_is_written_anew_is_another_h(fitted: Page, qtbot: QtBot, tmp_path: Path) -> None:
    path = Path(fitted.context.state.psf)
    saved(tmp_path / "new.h5", with_outlier()).replace(path)
    fitted.entered()
    assert fitted.found is None and fitted.panel.stack.currentWidget() is fitted.panel.ready


def test_a_file_that_is_being_written_is_left_alone(page: Page, qtbot: QtBot) -> None:
    path = page.context.state.psf
    page.context.forget(path)
    page.entered()
    idle(page.context.jobs, qtbot)
    assert page.context.matrix(path) is None and page.empty is not None
    assert "is being written" in page.empty.label.text()
    page.context.matrices.want(path)  # as the window does when it is written
    idle(page.context.jobs, qtbot)
    assert page.empty is None and page.panel.choices.source.text().startswith("H.h5: 6 of 8")


def test_a_fit_of_another_h_comes_too_late(page: Page, qtbot: QtBot, tmp_path: Path) -> None:
    page.fit()
    page.context.project.update("open", psf=str(saved(tmp_path / "other.h5")))
    idle(page.context.jobs, qtbot)
    assert page.found is None and page.fit_button.isEnabled()


# -- choices -----------------------------------------------------------------------------------------------
def test_choices_are_undone_and_kept(page: Page, qtbot: QtBot) -> None:
    choices, project = page.panel.choices, page.context.project
    item = choices.groups.item(1)
    item.setCheckState(Qt.CheckState.Checked)
    name = item.data(Qt.ItemDataRole.UserRole)
    assert page.settings.groups == ("geometry", name)
    project.undo()
    assert page.settings.groups == ("geometry",) and item.checkState() == Qt.CheckState.Unchecked
    choices.way.setCurrentIndex(0)
    assert page.settings.auto and "tried" in choices.legend.text()
    box: Any = choices.form.editor("camera")
    assert isinstance(box, QComboBox)
    box.setCurrentIndex(1)
    assert page.settings.camera == "window" and "this window" in choices.start.text()
    constant: Any = choices.form.editor("constant")
    constant.setText("-3")
    constant.textEdited.emit("-3")
    assert page.settings.constant is None and "0 or more" in choices.form.error
    constant.setText("3")
    constant.textEdited.emit("3")
    assert page.settings.constant == 3 and choices.noise.property("role") == "error"
    kept = FitSettings.of(ProjectState.from_json(project.state.to_json()))
    assert kept == page.settings


def test_choices_since_a_fit_are_told(fitted: Page) -> None:
    project = fitted.context.project
    assert "Choices changed" not in fitted.panel.detail.text()
    project.update("more", settings=replace(GEOMETRY, positions=5).into(project.state))
    assert "Choices changed since this fit" in fitted.panel.detail.text()
    project.undo()
    assert "Choices changed" not in fitted.panel.detail.text()


# -- what is made of it ------------------------------------------------------------------------------------
def test_the_camera_is_used_and_taken_back(fitted: Page) -> None:
    found, project = fitted.found, fitted.context.project
    assert found is not None
    before = project.state
    fitted.use_button.click()
    assert project.state.camera == measured_camera(found.fit) and project.undo_label == "fitted camera"
    assert {name for name, _ in project.state.settings["simulate"]["overrides"]} == {e.name for e in found.fit.effects}
    assert "In use" in fitted.panel.detail.text() and fitted.found is found
    project.undo()
    assert project.state == before and "In use" not in fitted.panel.detail.text()


def test_the_camera_stays_while_a_session_is_recorded(fitted: Page, qtbot: QtBot) -> None:
    go_on, jobs, camera = threading.Event(), fitted.context.jobs, fitted.context.state.camera

    def recording() -> Any:
        while not go_on.is_set():
            yield Progress(0, 1, "recording")
            go_on.wait(0.01)

    jobs.start("Record", "acquire", recording)
    assert not fitted.use_button.isEnabled() and "recorded" in fitted.use_button.toolTip()
    fitted.use()
    assert fitted.context.state.camera == camera and "recorded" in fitted.notice.label.text()
    go_on.set()
    idle(jobs, qtbot)
    assert fitted.use_button.isEnabled()


def test_h_of_the_fit_is_the_reference(fitted: Page, qtbot: QtBot, tmp_path: Path) -> None:
    found = fitted.found
    assert found is not None
    fitted.results.compute(str(tmp_path / "model.h5"))
    idle(fitted.context.jobs, qtbot)
    with open_psf(tmp_path / "model.h5") as H:
        np.testing.assert_array_equal(np.asarray(H), np.asarray(found.fit.model()))
        assert H.provenance["source"] == "H.h5"
    assert fitted.context.state.reference == str(tmp_path / "model.h5") and fitted.found is found
    own = Path(fitted.context.state.psf)
    before = own.stat()
    fitted.results.compute(str(own.parent / "." / own.name))
    assert "is the H that was fitted" in fitted.notice.label.text() and own.stat() == before


def test_a_fit_is_saved_as_the_command_writes_it(
    fitted: Page, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, opened = fitted.found, list[Path]()
    assert found is not None
    monkeypatch.setattr(fitted.results, "show_page", opened.append)
    fitted.results.save(str(tmp_path / "fit"))
    idle(fitted.context.jobs, qtbot)
    written = {path for path in (tmp_path / "fit").rglob("*") if path.is_file()}
    assert written == set(fit_outputs(tmp_path / "fit"))
    data = json.loads((tmp_path / "fit" / "fit.json").read_text())
    assert data["source"] == "H.h5" and [one["name"] for one in data["parameters"]] == list(found.fit.parameters)
    fitted.report_button.click()
    assert opened == [tmp_path / "fit" / "report" / "index.html"]
    fitted.results.save(str(tmp_path))  # its H.h5 is the one that was fitted
    assert "is the H that was fitted" in fitted.notice.label.text()


def test_a_report_that_nobody_saved_goes_with_the_fit(
    fitted: Page, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[Path] = []
    monkeypatch.setattr(fitted.results, "show_page", opened.append)
    fitted.report_button.click()
    idle(fitted.context.jobs, qtbot)
    assert len(opened) == 1 and "the optics from 6 patterns" in opened[0].read_text()
    fitted.context.project.update("open", psf=str(saved(tmp_path / "other.h5")))
    assert not opened[0].exists()


def test_colours_of_the_theme(fitted: Page, qapp: QApplication, context: Context) -> None:
    apply_theme(qapp, DARK)
    context.theme_changed.emit()
    assert QColor(DARK.good).name() in fitted.panel.verdict.styleSheet()
    apply_theme(qapp, LIGHT)
