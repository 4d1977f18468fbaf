"""The fit of the optics: from H to the camera, what is shown of it, and what is made of it."""

from __future__ import annotations

import gc
import json
import threading
import weakref
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtGui import QColor
from PySide6.QtWidgets import QApplication, QMenu
from pytestqt.qtbot import QtBot

from lfcal.base import Progress, Work
from lfcal.fit import fit_outputs, measured_camera
from lfcal.psf import open_psf
from lfcal_gui.jobs import JobState
from lfcal_gui.models import ProjectState
from lfcal_gui.pages.h.model_fit import FitSettings, group_rows
from lfcal_gui.pages.h.model_fit_run import FitRun, chi2_map
from lfcal_gui.pages.h.page import Page
from lfcal_gui.theme import DARK, apply_theme
from tests.fit.common import few_patterns
from tests.gui.pages.h.fit.common import GEOMETRY, saved, with_outlier
from tests.gui.pages.h.fit.conftest import told
from tests.gui.waiting import GUARD_MS, idle


def button_states(page: Page) -> list[bool]:
    view = page.fitting.view
    return [b.isEnabled() for b in (view.use_button, view.model_button, view.save_button, view.report_button)]


# -- fitting -----------------------------------------------------------------------------------------------
def test_from_h_to_the_camera(page: Page, qtbot: QtBot) -> None:
    view = page.fitting.view
    assert view.choices.source.text() == "H.h5: 6 of 8 positions recorded, 1 plane"
    assert view.results.isHidden() and not any(button_states(page))
    view.fit_button.click()
    assert page.stop_button.isEnabled() and not view.fit_button.isEnabled() and not view.choices.form.isEnabled()
    assert view.verdict.text().startswith("Fitting")
    idle(page.context.jobs, qtbot)
    found = page.fitting.found
    assert found is not None and not view.results.isHidden() and all(button_states(page))
    fit = found.fit
    assert fit.parameters["gap_um"].value == pytest.approx(1.01 * few_patterns().camera.lattice.gap_um, rel=1e-3)
    assert view.parameters.rowCount() == len(fit.parameters) == 4
    assert "explains the patterns" in view.verdict.text() and view.verdict.property("role") == "good"
    assert page.panel.rows["fit"].state.text().endswith(("off", "noise"))
    said = [view.findings.item(k, 0).text() for k in range(view.findings.rowCount())]
    assert [words.partition(":")[0] for words in said] == ["fixed", "fitted"]
    rounds = view.rounds.error.line.getData()
    assert len(rounds[0]) >= 3 and rounds[1][-1] < rounds[1][0]
    assert page.context.jobs.jobs()[0].result is None, "jobs are remembered for ever: they must not hold patterns"


def test_results_of_a_fit_are_copied_sorted_and_shown_by_position(fitted: Page, qtbot: QtBot) -> None:
    view, found = fitted.panel.map, fitted.fitting.found
    assert found is not None and fitted.panel.map_title.text().startswith("χ²")
    view.customContextMenuRequested.emit(view.rect().center())
    menu = next(one for one in view.findChildren(QMenu) if one.isVisible())
    next(action for action in menu.actions() if action.text() == "Copy values").trigger()
    menu.close()
    head, *rows = (line.split("\t") for line in QApplication.clipboard().text().splitlines())
    assert head == ["z", "y", "x", "chi2", "fate"]
    assert [tuple(map(int, row[:3])) for row in rows] == list(found.places)
    assert [float(row[3]) for row in rows] == pytest.approx([found.chi2[place] for place in found.places], rel=1e-6)
    table, found = fitted.fitting.view.parameters, fitted.fitting.found
    table.sortItems(3, Qt.SortOrder.DescendingOrder)
    assert table.item(0, 0).text() == "gap" and table.number_of(0) == 0
    table.sortItems(5, Qt.SortOrder.AscendingOrder)
    away = [list(found.fit.parameters.values())[table.number_of(k)] for k in range(4)]
    numbers = [(one.value - one.start) / one.sigma for one in away]
    assert numbers == sorted(numbers)
    table.clearSelection()
    qtbot.keyClick(table, Qt.Key.Key_C, Qt.KeyboardModifier.ControlModifier)
    lines = QApplication.clipboard().text().splitlines()
    assert lines[0].split("\t")[:3] == ["Parameter", "Found", "± σ"] and len(lines) == 5
    table.selectRow(1)
    table.copy()
    assert len(QApplication.clipboard().text().splitlines()) == 2
    found, view = fitted.fitting.found, fitted.panel.fitted
    assert fitted.intent.view == "fit" and fitted.panel.view_buttons["Fit"].isChecked()
    fitted.set_intent(z=0, y=found.places[0][1], x=found.places[0][2])
    for _ in range(2):
        fitted._step(0, 1)
    place = found.places[2]
    assert view.place == place == (fitted.intent.z, fitted.intent.y, fitted.intent.x)
    fitted.panel.map.chosen.emit(place[1], place[2] + 1)
    assert view.place == (fitted.intent.z, fitted.intent.y, fitted.intent.x) and view.place in found.places
    fitted.set_intent(z=place[0], y=place[1], x=place[2])
    for picture, values in ((view.measured, found.patterns), (view.model, found.model)):
        np.testing.assert_array_equal(picture.values, values[place])
    np.testing.assert_array_equal(view.residual.values, found.fit.residual(*place))
    assert view.residual.levels == (-5.0, 5.0)
    pixel = found.fit.camera.sensor.pixel_um
    assert all(one.shot.pixel_um == pixel for one in (view.measured, view.model, view.residual))
    assert f"χ² {found.chi2[place]:.3g}" in fitted.panel.readout.text()
    view.model.hovered.emit(3, 4, 0.0)
    words = view.residual.note[0]
    assert f"t 3, s 4: measured {found.patterns[place][3, 4]:.5g}" in words and "σ" in words
    assert all(one.shot.cross is not None and one.shot.cross[1] == 4 for one in view.views)
    fitted.fitting.view.worst_button.click()
    assert view.place == max(found.places, key=lambda one: found.chi2[one])
    fitted.panel.map.chosen.emit(*found.places[4][1:])
    assert view.place == found.places[4]
    fitted.panel.view_buttons["Both"].click()
    assert fitted.panel.pictures.currentWidget() is fitted.panel.split


def test_an_outlier_is_found(
    page: Page, known_outlier: FitRun, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lfcal_gui.pages.h._fitting.iter_fit", told(known_outlier))
    page.context.project.update("open", psf=str(saved(tmp_path / "outlier.h5", with_outlier())))
    page.fitting.begin()
    idle(page.context.jobs, qtbot)
    found, view = page.fitting.found, page.fitting.view
    assert len(found.fit.outliers) == 1
    page.set_intent(view="both")
    view.findings.selectRow(0)
    one = found.fit.outliers[0]
    place = (one.z, one.y, one.x)
    assert page.intent.view == "fit" and page.panel.fitted.place == place and "left out" in page.panel.readout.text()
    shown = chi2_map(found, 0)
    assert shown.missing.tolist() == [[one.y, one.x]], "crossed out"
    page.set_intent(view="both")
    view.findings.cellClicked.emit(0, 0)
    assert page.intent.view == "fit", "a row that is selected already is clicked again"


def test_an_error_is_one_line_in_the_page(page: Page, qtbot: QtBot, tmp_path: Path) -> None:
    other = replace(GEOMETRY, camera="window", positions=5)
    project = page.context.project
    project.update("choices", settings=other.into(project.state))
    H = few_patterns()
    values = np.random.default_rng(1).normal(0, 8, H.shape).astype(np.float32)
    dark = type(H)(values, depths=H.depths, camera=H.camera, anchor=H.anchor, facts=H.facts)
    project.update("open", psf=str(saved(tmp_path / "dark.h5", dark)))
    page.fitting.begin()
    idle(page.context.jobs, qtbot)
    words = page.fitting.view.verdict.text()
    assert words.startswith("light of the patterns: expected more light than noise") and "\n" not in words
    assert page.fitting.found is None and page.fitting.view.fit_button.isEnabled() and not any(button_states(page))


@pytest.fixture
def let_go(monkeypatch: pytest.MonkeyPatch) -> Iterator[threading.Event]:
    """Let fits compute between two records until this is set."""
    go_on = threading.Event()

    def slow(*_: object) -> Work[None]:
        yield Progress(0, 2, "slow")
        go_on.wait(GUARD_MS / 1e3)
        yield Progress(1, 2, "slow")

    monkeypatch.setattr("lfcal_gui.pages.h._fitting.iter_fit", slow)
    yield go_on
    go_on.set()


def test_escape_stops_a_fit_and_keeps_what_was_there(fitted: Page, let_go: threading.Event, qtbot: QtBot) -> None:
    before, rounds = fitted.fitting.found, fitted.fitting._rounds
    fitted.activateWindow()
    qtbot.waitUntil(fitted.isActiveWindow, timeout=GUARD_MS)
    qtbot.keyClick(fitted, Qt.Key.Key_Escape)
    assert fitted.fitting.found is before, "without a fit there is nothing to stop"
    qtbot.mouseClick(fitted.fitting.view.fit_button, Qt.MouseButton.LeftButton)
    assert fitted.stop_button.isEnabled()
    focus = QApplication.focusWidget()  # the button that was pressed is grey by now
    assert focus is not None and fitted.isAncestorOf(focus)
    qtbot.keyClick(focus, Qt.Key.Key_Escape)
    assert fitted.context.jobs.jobs()[0].state is JobState.CANCELLED and not let_go.is_set()
    assert fitted.fitting.found is before and fitted.fitting._rounds is rounds
    assert not fitted.fitting.view.results.isHidden()
    assert all(button_states(fitted)) and not fitted.stop_button.isEnabled()
    let_go.set()
    idle(fitted.context.jobs, qtbot)
    assert fitted.fitting.found is before, "what comes of it afterwards is of no interest"


def test_the_first_fit_is_stopped_between_two_records(page: Page, let_go: threading.Event) -> None:
    page.fitting.begin()
    page.stop_button.click()
    assert page.context.jobs.jobs()[0].state is JobState.CANCELLED and not let_go.is_set()
    assert page.fitting.view.fit_button.isEnabled() and page.fitting.view.verdict.text() == "Stopped."


# -- another H ---------------------------------------------------------------------------------------------
def test_nothing_of_an_h_is_shown_beside_another(fitted: Page, qtbot: QtBot, tmp_path: Path) -> None:
    there = weakref.ref(fitted.fitting.found)
    view = fitted.fitting.view
    fitted.context.project.update("open", psf=str(saved(tmp_path / "other.h5")))
    idle(fitted.context.jobs, qtbot)
    assert view.results.isHidden() and not any(button_states(fitted))
    assert view.parameters.rowCount() == view.findings.rowCount() == 0
    assert fitted.panel.fitted.measured.values is None and fitted.intent.view != "fit"
    assert not fitted.panel.view_buttons["Fit"].isVisible()
    assert view.choices.source.text().startswith("other.h5")
    gc.collect()
    assert there() is None, "its patterns may be large"


def test_a_file_that_is_being_written_is_left_alone(page: Page, qtbot: QtBot) -> None:
    path = page.context.state.psf
    page.context.forget(path)
    page.entered()
    idle(page.context.jobs, qtbot)
    assert page.context.matrix(path) is None and page.empty is not None
    assert "is being written" in page.empty.label.text()
    page.context.matrices.want(path)  # as the window does when it is written
    idle(page.context.jobs, qtbot)
    assert page.empty is None and page.fitting.view.choices.source.text().startswith("H.h5: 6 of 8")


# -- choices -----------------------------------------------------------------------------------------------
def test_choices_are_undone_and_kept(page: Page, qtbot: QtBot) -> None:
    choices, project = page.fitting.view.choices, page.context.project
    item = choices.groups.item(1)
    item.setCheckState(Qt.CheckState.Checked)
    name = item.data(Qt.ItemDataRole.UserRole)
    assert page.fitting.settings.groups == ("geometry", name)
    project.undo()
    assert page.fitting.settings.groups == ("geometry",) and item.checkState() == Qt.CheckState.Unchecked
    choices.way.setCurrentIndex(0)
    assert page.fitting.settings.auto and "tried" in choices.legend.text()
    box: Any = choices.form.editor("camera")
    box.setCurrentIndex(1)
    assert page.fitting.settings.camera == "window" and "this window" in choices.start.text()
    for form, key, text in (
        (choices.form, "noise", "-3,1"),
        (choices.form, "noise", "3, 1"),
        (choices.form, "effects", "crosstalk=0.01; more.json"),
    ):
        editor: Any = form.editor(key)
        editor.setText(text)
        editor.textEdited.emit(text)
        if text == "-3,1":
            assert page.fitting.settings.noise is None and "expected a number ≥ 0" in form.error
        assert editor.text() == text, "it is not replaced while it is typed"
    assert page.fitting.settings.noise == (3, 1) and choices.noise.text().startswith("Noise as given here")
    assert page.fitting.settings.effects == ("crosstalk=0.01", "more.json")
    choices.form.editor("hybrid").setChecked(True)  # type: ignore[attr-defined]
    assert page.fitting.settings.hybrid
    kept = FitSettings.of(ProjectState.from_json(project.state.to_json()))
    assert kept == page.fitting.settings


def test_groups_that_the_camera_lacks_are_grey_with_their_reason(page: Page, qtbot: QtBot) -> None:
    choices, project = page.fitting.view.choices, page.context.project
    rows = {
        choices.groups.item(k).data(Qt.ItemDataRole.UserRole): choices.groups.item(k) for k in range(len(group_rows()))
    }
    grey = {name for name, item in rows.items() if not item.flags() & Qt.ItemFlag.ItemIsEnabled}
    # an H is of one region of the field
    over_the_field = {"field_curvature", "field_wavefront", "plane_tilt", "region_depths", "region_places"}
    fourier = {"lens_centres", "fourier_lens", "optical_axis", "travel_tilt", "lenslet_gap"}
    assert grey == {"cats_eye", "depths", "hole", "specimen", *over_the_field, *fourier}
    assert "several regions of the field" in rows["field_wavefront"].toolTip()
    assert rows["depths"].text() == "depth of each plane\nneeds at least two planes"
    assert rows["depths"].toolTip().endswith("needs at least two planes")
    # one that was chosen for another camera neither shows as chosen, nor is it fitted
    both = replace(GEOMETRY, groups=("geometry", "depths"))
    project.update("choices", settings=both.into(project.state))
    assert rows["depths"].checkState() == Qt.CheckState.Unchecked
    page.fitting.begin()
    idle(page.context.jobs, qtbot)
    assert page.fitting.found.fit.groups == ("geometry",)
    alone = replace(GEOMETRY, groups=("depths",))
    project.update("choices", settings=alone.into(project.state))
    page.fitting.begin()
    idle(page.context.jobs, qtbot)
    assert "got depths, which needs at least two planes" in page.fitting.view.verdict.text() + page.notice.label.text()
    # a lens without blades, in this window
    camera = project.state.camera
    plain = replace(camera, optics=replace(camera.optics, blades=0))
    project.update("start", settings=replace(GEOMETRY, camera="window").into(project.state), camera=plain)
    assert rows["blades"].text().endswith("needs an iris with blades")
    project.undo()
    assert rows["blades"].flags() & Qt.ItemFlag.ItemIsUserCheckable


def test_the_camera_is_used_taken_back_and_kept_while_a_session_is_recorded(fitted: Page, qtbot: QtBot) -> None:
    found, project = fitted.fitting.found, fitted.context.project
    before = project.state
    fitted.fitting.view.use_button.click()
    assert project.state.camera == measured_camera(found.fit) and project.undo_label == "fitted camera"
    assert {name for name, _ in project.state.settings["simulate"]["overrides"]} == {e.name for e in found.fit.effects}
    assert "In use" in fitted.fitting.view.detail.text() and fitted.fitting.found is found
    project.undo()
    assert project.state == before and "In use" not in fitted.fitting.view.detail.text()
    go_on, jobs, camera = threading.Event(), fitted.context.jobs, fitted.context.state.camera

    def recording() -> Any:
        while not go_on.is_set():
            yield Progress(0, 1, "recording")
            go_on.wait(0.01)

    jobs.start("Record", "acquire", recording)
    assert not fitted.fitting.view.use_button.isEnabled() and "recorded" in fitted.fitting.view.use_button.toolTip()
    fitted.fitting.use()
    assert fitted.context.state.camera == camera and "recorded" in fitted.notice.label.text()
    go_on.set()
    idle(jobs, qtbot)
    assert fitted.fitting.view.use_button.isEnabled()


def test_h_of_the_fit_is_the_reference(fitted: Page, qtbot: QtBot, tmp_path: Path) -> None:
    found = fitted.fitting.found
    fitted.fitting.results.compute(str(tmp_path / "model.h5"))
    idle(fitted.context.jobs, qtbot)
    with open_psf(tmp_path / "model.h5") as H:
        np.testing.assert_array_equal(np.asarray(H), np.asarray(found.fit.model()))
        assert H.provenance["source"] == "H.h5"
    assert fitted.context.state.reference == str(tmp_path / "model.h5") and fitted.fitting.found is found
    own = Path(fitted.context.state.psf)
    before = own.stat()
    fitted.fitting.results.compute(str(own.parent / "." / own.name))
    assert "is the H that was fitted" in fitted.notice.label.text() and own.stat() == before


def test_a_fit_is_saved_as_by_command(
    fitted: Page, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, opened = fitted.fitting.found, list[Path]()
    monkeypatch.setattr(fitted.fitting.results, "show_page", opened.append)
    fitted.fitting.results.save(str(tmp_path / "fit"))
    idle(fitted.context.jobs, qtbot)
    written = {path for path in (tmp_path / "fit").rglob("*") if path.is_file()}
    assert written == set(fit_outputs(tmp_path / "fit"))
    data = json.loads((tmp_path / "fit" / "fit.json").read_text())
    assert data["source"] == "H.h5" and [one["name"] for one in data["parameters"]] == list(found.fit.parameters)
    fitted.fitting.view.report_button.click()
    assert opened == [tmp_path / "fit" / "report" / "index.html"]
    fitted.fitting.results.save(str(tmp_path))  # its H.h5 is the one that was fitted
    assert "is the H that was fitted" in fitted.notice.label.text()


@pytest.mark.long
def test_an_unsaved_report_is_deleted(
    fitted: Page, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[Path] = []
    monkeypatch.setattr(fitted.fitting.results, "show_page", opened.append)
    fitted.fitting.view.report_button.click()
    idle(fitted.context.jobs, qtbot)
    assert len(opened) == 1 and "optics fitted from 6 patterns" in opened[0].read_text()
    fitted.context.project.update("open", psf=str(saved(tmp_path / "other.h5")))
    assert not opened[0].exists()


def test_fewer_patterns_and_none_are_shown_after_a_fit_of_more(fitted: Page) -> None:
    found, view = fitted.fitting.found, fitted.panel.fitted
    view.show_place(found.places[-1])
    kept = found.places[-3:]
    cut = {key: {p: getattr(found, key)[p] for p in kept} for key in ("patterns", "valid", "model", "residual", "chi2")}
    less = replace(found, places=kept, **cut)
    view.show_fit(less)
    assert view.place is None and view.measured.values is None
    view.show_place(found.places[0])
    assert view.place in less.places
    shown = chi2_map(less, 0)
    assert np.isfinite(shown.values).sum() == 3
    view.show_fit(None)
    assert view.step(2) is None and view.step_plane(1) is None
    view.show_place((0, 0, 0))
    assert view.place is None and view.measured.values is None


def test_an_incomplete_model_and_choices_since_the_fit_are_reported(fitted: Page, qapp: QApplication) -> None:
    found, view, project = fitted.fitting.found, fitted.fitting.view, fitted.context.project
    assert found is not None and "settings changed" not in view.detail.text()
    project.update("more", settings=replace(GEOMETRY, positions=5).into(project.state))
    assert "The settings changed since this fit" in view.detail.text()
    project.undo()
    assert "settings changed" not in view.detail.text()
    apply_theme(qapp, DARK)
    fitted.take_theme()
    assert view.verdict.palette().text().color() == QColor(DARK.good)
    worse = replace(found.fit, chi_square=replace(found.fit.chi_square, lit=2.0, sigma=0.05))
    fitted.fitting.found = replace(found, fit=worse)
    fitted.entered()
    assert view.verdict.text().startswith("The model is incomplete") and view.verdict.property("role") == "bad"


def test_a_late_fit_is_dropped_and_a_rewritten_file_is_another_h(fitted: Page, qtbot: QtBot, tmp_path: Path) -> None:
    saved(tmp_path / "new.h5", with_outlier()).replace(Path(fitted.context.state.psf))
    fitted.entered()
    assert fitted.fitting.found is None and fitted.fitting.view.results.isHidden()
    idle(fitted.context.jobs, qtbot)
    fitted.fitting.begin()
    fitted.context.project.update("open", psf=str(saved(tmp_path / "other.h5")))
    idle(fitted.context.jobs, qtbot)
    assert fitted.fitting.found is None and fitted.fitting.view.fit_button.isEnabled()


def test_a_fit_of_a_recording_is_taken_over_if_it_is_of_this_scan(page: Page, known: FitRun, qtbot: QtBot) -> None:
    fit, view = known.found.fit, page.fitting.view
    page.receive(replace(fit, planned=replace(fit.planned, cutout=(13, 13))))
    idle(page.context.jobs, qtbot)
    assert page.fitting.found is None and "press Fit to fit this H" in view.verdict.text()
    page.receive(fit)
    assert page.stop_button.isEnabled() and not view.fit_button.isEnabled()
    idle(page.context.jobs, qtbot)
    found, settings = page.fitting.found, page.fitting.settings
    assert found.fit is fit and all(button_states(page))
    assert found.places == known.found.places and found.aside == known.found.aside
    for place in found.places:
        np.testing.assert_array_equal(found.patterns[place], known.found.patterns[place])
        np.testing.assert_allclose(found.model[place], known.found.model[place], rtol=1e-6)
    assert settings.positions == 0 and settings.auto and "settings changed" not in view.detail.text()
    assert "during the recording" in view.rounds.words.text()
