"""Invariants of a window: numbers of axes, values of the project that are shown, and buttons that are enabled."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pyqtgraph as pg
from PySide6.QtWidgets import QCheckBox, QComboBox, QLineEdit

from lfcal_gui.base_page import BasePage
from lfcal_gui.jobs import JobState
from lfcal_gui.models.form import parse, text_of
from lfcal_gui.models.next_step import next_step, rail_words
from lfcal_gui.models.project import ProjectState
from lfcal_gui.pages.h.model import shown_unit
from lfcal_gui.pages.h.model_checks import checks_of
from lfcal_gui.pages.setup.model import values_of as values_of_camera
from lfcal_gui.pages.setup.model_scan import values_of as values_of_plan
from lfcal_gui.pages.setup.model_target import PlanSettings
from lfcal_gui.widgets._axes import Plot
from lfcal_gui.widgets.folded_form import FoldedForm
from lfcal_gui.window import MainWindow

__all__ = ["check_window"]

VIEWS = {"both": "Both", "sum": "Sum", "difference": "Difference", "fit": "Fit"}
"""Segments of the page H, by the view that they show."""

STOPPED_BY = ("h", "accuracy")
"""Pages whose button Stop is enabled only while they have a job."""


def check_window(window: MainWindow) -> None:
    """Raise `AssertionError` if the window contradicts its state."""
    _axes(window)
    _jobs(window)
    _project(window)
    made = {spec.key: window.page(spec.key) for spec in window.specs if spec.key in window._pages}
    for key, page in made.items():
        found: Any = CHECKS.get(key)
        if found is not None:
            found(window, page)
    running = window.jobs.running_pages()
    for key in STOPPED_BY:
        if key in made:
            button: Any = made[key]
            assert button.stop_button.isEnabled() == (key in running), f"Stop of {key}: {key in running} runs"


def _axes(window: MainWindow) -> None:
    for view in window.shown.findChildren(pg.GraphicsView):
        plots = [item for item in view.scene().items() if isinstance(item, Plot)]
        for plot in plots:
            for side in ("bottom", "left"):
                axis = plot.getAxis(side)
                assert axis.autoSIPrefixScale == 1, f"{axis.labelText}: numbers off by {axis.autoSIPrefixScale}"


def _jobs(window: MainWindow) -> None:
    failed = [job for job in window.jobs.jobs() if job.state is JobState.FAILED and not _meant(job)]
    assert not failed, failed[0].details


def _meant(job: Any) -> bool:
    """Return whether a job failed with an error whose message is written for users."""
    import lfcal.base.errors as errors

    last = job.details.strip().splitlines()[-1] if job.details.strip() else ""
    return last.split(":")[0].split(".")[-1] in errors.__all__ or not last


def _project(window: MainWindow) -> None:
    state, project = window.context.state, window.project
    assert state.plan is None or state.plan.camera == state.camera, "the plan is of another camera"
    assert ProjectState.from_json(state.to_json()) == state, "the project is not saved as it is"
    assert window.menus.undo.isEnabled() == bool(project.undo_label)
    assert window.menus.redo.isEnabled() == bool(project.redo_label)
    assert window.menus.undo.text() == f"Undo {project.undo_label}".strip()
    assert ("*" in window.windowTitle()) == project.unsaved, f"{window.windowTitle()}, unsaved: {project.unsaved}"
    window.leading.gather()
    sitting = window.leading.sitting
    for place, said in rail_words(sitting).items():
        assert window.rail.word(place).endswith(said.words), f"{place} is said to be {window.rail.word(place)}"
    line = window.next_line
    assert line._wanted == next_step(sitting)
    assert line.step is not None and (line.words.text(), line.button.text()) == (line.step.words, line.step.button)


def _body(page: BasePage) -> bool:
    return page.empty is None


def _h(window: MainWindow, page: Any) -> None:
    """Compare the H that is shown with that of the project, and the header with its name."""
    path = window.context.state.psf
    assert page.matrix is (window.context.matrix(path) if path else None), "this is not the H of the project"
    assert _body(page) == (page.matrix is not None)
    name = re.match(r"(.+?): \(z, y, x, t, s\) = (\(.+?\)), ", page.hint.text())
    if page.matrix is None:
        assert name is None, f"the header shows {name} without an H"
        return
    assert name is not None and name[1] == Path(path).name and name[2] == str(page.matrix.shape)
    planes, ny, nx = page.matrix.shape[:3]
    intent = page.intent
    assert 0 <= intent.z < planes and 0 <= intent.y < ny and 0 <= intent.x < nx
    assert page.panel.strip.count() == planes
    if page.plane is not None:
        _h_pictures(page)
    _checks(window, page)
    _fit(page)


def _h_pictures(page: Any) -> None:
    """Compare controls, titles, unit and values with the chosen position."""
    panel, intent, matrix = page.panel, page.intent, page.matrix
    assert page.plane.z == intent.z == panel.strip.currentRow()
    shown = [title for title, button in panel.view_buttons.items() if button.isChecked()]
    assert shown == [VIEWS.get(intent.view, "HT" if intent.transposed else "H")]
    if intent.view == "fit":
        assert panel.fitted.place == (intent.z, intent.y, intent.x)
        return
    names, at = ("HT", "H") if intent.transposed else ("H", "HT"), f"position y {intent.y}, x {intent.x}"
    shows = "measured" if intent.view == "difference" or page.reference_plane is None else intent.show
    what = "" if shows == "measured" else "Other H: "
    main, linked = panel.main_view.shot.caption, panel.linked_view.shot.caption
    assert main == f"{what}{names[0]}, {at}", f"{main} for {what}{names[0]}, {at}"
    apart = intent.view == "difference" and page.reference_plane is not None
    assert linked.startswith(f"{names[0]} minus the other H" if apart else f"{what}{names[1]}, ")
    unit = shown_unit(intent, matrix, page.reference)
    assert {panel.main_view.quantity, panel.linked_view.quantity} == {unit}
    assert (panel.readout.text().startswith("Point at")) == (intent.pixel is None)
    if shows == "measured":
        seen = matrix.T if intent.transposed else matrix
        wanted = np.asarray(seen[intent.z, intent.y, intent.x])
        np.testing.assert_array_equal(panel.main_view.values, wanted, f"another pattern than {at} is shown")


def _form(form: FoldedForm, values: dict[str, Any]) -> None:
    """Compare fields that are not refused with the values of the project."""
    for key, field in form.fields.items():
        editor = form.editor(key)
        if editor.isHidden() or editor.property("invalid"):
            continue  # it shows the refused text and the reason
        if isinstance(editor, QLineEdit):
            message = f"{key}: {editor.text()} is shown for {values[key]}"
            if field.read is not None:
                assert field.read(editor.text()) == field.read(values[key]), message
                continue
            assert parse(field, editor.text()) == _as_shown(field, values[key]), message
        elif isinstance(editor, QComboBox):
            assert editor.currentData() == values[key] or editor.findData(values[key]) < 0, key
        elif isinstance(editor, QCheckBox):
            assert editor.isChecked() == bool(values[key]), key


def _as_shown(field: Any, value: Any) -> Any:
    """Return ``value`` as it is read from the ten digits of a form."""
    return parse(field, text_of(field, value))


def _setup(window: MainWindow, page: Any) -> None:
    values = values_of_camera(window.context.state.camera)
    inspector, plan = page.panel.inspector, window.context.state.plan
    if plan is not None:
        values |= {**PlanSettings.of(window.context.state).shown(), **values_of_plan(plan)}
    assert inspector.scan.isHidden() == (plan is None) == (not inspector.no_plan.isHidden())
    _form(inspector.values, values)
    if plan is not None:
        _form(inspector.scan, values)


def _checks(window: MainWindow, page: Any) -> None:
    """Compare the buttons and the inspection with the H of the project."""
    there, checking = bool(window.context.state.psf), page.checking
    busy = {job.title.split()[0] for job in window.jobs.jobs() if job.active and job.page == "h"}
    if not there:
        assert checking.inspection is None, "an inspection is shown, and there is no H"
    view = checking.view
    if view is None:
        return
    assert not (view.measure_button.isEnabled() and not there), "Inspect without an H"
    assert not ("Report" in busy and view.report_button.isEnabled()), f"Report while {busy} runs"
    if checking.inspection is not None and view.stack.currentIndex() == 1:
        checks = checks_of(checking.inspection, every=view.every.isChecked())
        assert view.table.rowCount() == len(checks)
        number = view.table.chosen()
        if number >= 0:
            title = checks[number].title
            assert title.lower() in view.words.text().lower(), f"{title} is chosen"


def _fit(page: Any) -> None:
    if "fitting" in page.__dict__:
        view, found = page.fitting.view, page.fitting.found
        if found is None:
            assert not (view.use_button.isEnabled() or view.save_button.isEnabled()), "nothing was fitted"


def _frames(window: MainWindow, page: Any) -> None:
    state = window.context.state
    assert page.assemble_button.isEnabled() == (page.opened is not None)
    if page.opened is not None:
        assert page.opened.folder == state.frames, f"{page.opened.folder} is shown, {state.frames} is the project's"
        assert page.hint.text().startswith(f"{len(page.opened.source)} frames")
        z, y, x = page.position
        planes, ny, nx = page.opened.frames.shape
        assert 0 <= z < planes and 0 <= y < ny and 0 <= x < nx
    if not state.frames:
        assert page.loaded is None and not _body(page)


def _acquire(window: MainWindow, page: Any) -> None:
    recording, buttons = page.record.recording, page.panel.record.buttons
    for key in ("pause", "stop", "abort"):
        assert recording or not buttons[key].isEnabled() or not _body(page), f"{key}, and nothing is recorded"
    assert buttons["pause"].isEnabled() or not recording, "Pause during a recording"
    assert not (recording and (buttons["start"].isEnabled() or buttons["assemble"].isEnabled()))
    assert _body(page) == (window.context.state.plan is not None or recording)


def _reconstruct(window: MainWindow, page: Any) -> None:
    running = any(job.active and job.kind == "reconstruct" for job in window.jobs.jobs())  # not a measurement of costs
    assert (page.panel.go.text() == "Stop") == running


def _simulate(window: MainWindow, page: Any) -> None:
    """Compare the answer of the planner with the plan and the settings, unless it is computed again."""
    state = window.context.state
    assert _body(page) == (state.plan is not None)
    if page.verdict is not None and state.plan is not None and page.isVisible():  # updated when it is shown again
        asked = window.jobs.busy
        assert asked or page.verdict.fits(state.plan, page.settings), "an earlier answer of the planner is shown"


CHECKS = {
    "setup": _setup,
    "simulate": _simulate,
    "h": _h,
    "frames": _frames,
    "acquire": _acquire,
    "reconstruct": _reconstruct,
}
