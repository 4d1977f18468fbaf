"""The page's target of many points: planned beside the window, stopped, outdated, saved; its command and script."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot
from typer.testing import CliRunner

from lfcal.base.progress import Clock, Work
from lfcal.camera import ScanPlan
from lfcal.cli._app import build_app
from lfcal.targets import TargetPlan
from lfcal_gui.context import Context
from lfcal_gui.models.project import ProjectState
from lfcal_gui.pages.setup import model_target
from lfcal_gui.pages.setup.model_target import PlanSettings
from lfcal_gui.pages.setup.step import step
from lfcal_gui.theme import current_theme
from tests.gui.waiting import GUARD_MS, idle
from tests.targets.common import small

OpenPage = Callable[..., Any]
SCAN = ScanPlan.for_camera(small(), virtual_depths=(4.0,), cutout=31)
ARRAY = "array:6x6@1021.3um"


@pytest.fixture
def state() -> ProjectState:
    return ProjectState(camera=SCAN.camera, plan=SCAN)


def type_in(page: Any, key: str, text: str) -> None:
    editor = page.target.form.editor(key)
    editor.setText(text)
    editor.textEdited.emit(text)


@pytest.fixture
def planned(open_page: OpenPage, context: Context, qtbot: QtBot) -> Any:
    page = open_page("setup")
    type_in(page, "source", ARRAY)
    type_in(page, "most_frames", "12")
    page.target.plan_button.click()
    idle(context.jobs, qtbot)
    return page


def test_a_point_is_no_target_and_the_page_says_what_to_type(open_page: OpenPage, context: Context) -> None:
    page = open_page("setup")
    target = page.target
    assert "type array" in target.message.text() and target.stack.currentIndex() == 0
    assert not (target.plan_button.isEnabled() or target.stop_button.isEnabled() or target.save_button.isEnabled())
    page.target.plan_target()
    assert "no target to plan" in target.message.text()
    page.target.save_target()
    assert "no target plan to save" in target.message.text()
    type_in(page, "source", "array:6x")
    assert "ROWSxCOLUMNS" in target.form.error and not context.state.settings
    type_in(page, "source", "array")
    assert target.plan_button.isEnabled() and "Press Plan target" in target.message.text()


def test_what_is_planned_is_shown(planned: Any) -> None:
    target = planned.target
    plan = target.found.plan
    assert target.stack.currentIndex() == 1 and target.save_button.isEnabled()
    assert len(plan.offsets_px[0]) == 12 and target.table.rowCount() == 1
    assert "<b>12</b></td><td>252" in target.costs.text() and "not covered" in target.note.text()
    assert "coded: does not pay" in target.note.text()
    assert len(target.points.data) == sum(len(plan.points(0, k)) for k in range(12))
    assert np.isnan(target.map.values).sum() == (plan.shown(0) == 0).sum() > 0
    target.map.chosen.emit(2, 3)
    assert f"y = 2, x = 3: shown by {plan.shown(0)[2, 3]} frame" in target.read.text()
    assert [name for name, _ in target._entries()] == ["Copy values", "Save data …"]
    assert [name for name, _ in planned.panel.path_entries()] == ["Copy values", "Save data …"]


def test_plots_have_the_colours_of_the_theme_from_the_first(open_page: OpenPage) -> None:
    assert open_page("setup").target.graphics.backgroundBrush().color().name() == current_theme().panel


@pytest.mark.long
def test_a_plan_of_other_values_is_shown_no_longer(planned: Any, context: Context) -> None:
    target = planned.target
    context.project.update("name", name="other")
    assert target.found is not None
    context.project.update("exposure", plan=replace(SCAN, exposure_s=0.5))
    assert target.found is None and not target.save_button.isEnabled() and target.stack.currentIndex() == 0
    planned.target.save_target()
    assert "no target plan" in target.message.text()


def test_holes_too_close_are_refused_in_words(open_page: OpenPage, context: Context, qtbot: QtBot) -> None:
    page = open_page("setup")
    type_in(page, "source", "array:6x6@200um")
    page.target.plan_target()
    idle(context.jobs, qtbot)
    target = page.target
    assert "crosstalk of holes" in target.message.text() and target.found is None
    assert target.plan_button.isEnabled() and not target.stop_button.isEnabled()


def test_a_search_is_stopped(
    open_page: OpenPage, context: Context, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    def endless(*_: Any) -> Work[Any]:
        clock = Clock("search", 0)
        while True:
            yield clock.at(0)

    monkeypatch.setattr(model_target, "iter_target", endless)
    page = open_page("setup")
    target = page.target
    type_in(page, "source", "array")
    page.target.plan_target()
    assert target.stop_button.isEnabled() and "Searching for" in target.message.text()
    target.stop_button.click()
    qtbot.waitUntil(lambda: not context.jobs.busy, timeout=GUARD_MS)
    assert not target.stop_button.isEnabled() and "There is no plan yet" in target.message.text()
    page.target.plan_target()
    type_in(page, "tolerance", "0.2")  # what is looked for is wanted no longer
    qtbot.waitUntil(lambda: not context.jobs.busy, timeout=GUARD_MS)
    assert target.plan_button.isEnabled() and target.found is None


def test_the_file_is_what_the_command_and_the_script_write(
    planned: Any, context: Context, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    planned.target.save_target("mine.json")
    saved = TargetPlan.from_json(Path("mine.json").read_text())
    assert saved == planned.target.found.plan
    (taken,) = context.history.taken
    assert taken.step is not None
    for name, text in taken.step.files:
        Path(name).write_text(text, encoding="utf-8")
    Path("mine.json").unlink()
    run = CliRunner().invoke(build_app(), list(taken.step.arguments))
    assert run.exit_code == 0, run.output
    assert TargetPlan.from_json(Path("mine.json").read_text()) == saved
    Path("mine.json").unlink()
    exec(compile(taken.step.script(), "script", "exec"), {})
    assert TargetPlan.from_json(Path("mine.json").read_text()) == saved
    # a session of it, as far as it is described before anything moves
    run = CliRunner().invoke(build_app(), ["acquire", "mine.json", "-o", "session", "--dry-run"])
    assert run.exit_code == 0, run.output
    planned.save_plan("plan.json")
    scanned = context.history.taken[-1].step
    assert scanned is not None and "target" not in scanned.arguments


@pytest.mark.long
def test_no_copied_step_replaces_the_other_plan(planned: Any, context: Context, tmp_path: Path) -> None:
    planned.save_plan(str(tmp_path / "plan.json"))
    planned.target.save_target(str(tmp_path / "target.json"))
    latest = context.history.latest("setup")
    assert latest == str(tmp_path / "plan.json")
    assert "--out=target_plan.json" in step(context.state, latest).arguments
    assert f"--out={latest}" in step(replace(context.state, settings={}), latest).arguments


def test_a_proposed_pitch_is_asked_for_in_both(state: ProjectState) -> None:
    asked = PlanSettings("array,hole=20um", 0.2)
    made = step(replace(state, settings=asked.into(state)))
    assert {"array,hole=20um", "--tolerance=0.2", "--out=target_plan.json"} <= set(made.arguments)
    assert "source='array,hole=20um'" in made.python and "tolerance=0.2" in made.python


def test_a_saved_target_plan_is_opened_again(planned: Any, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    plan, path = planned.target.found.plan, tmp_path / "target_plan.json"
    planned.target.save_target(str(path))
    context.project.update("other", plan=replace(SCAN, exposure_s=0.5))
    assert planned.target.found is None
    planned.open_plan(str(path))
    idle(context.jobs, qtbot)
    assert planned.target.found.plan == plan and context.state.plan == SCAN
    assert planned.target.isVisible()
    assert PlanSettings.of(context.state).source == ARRAY


def test_what_cannot_be_planned_is_refused_where_it_is_typed(open_page: OpenPage, context: Context) -> None:
    page = open_page("setup")
    form = page.target.form
    type_in(page, "source", "array")
    for key, text, words in (
        ("pose", "rotation=400", r"rotation (degrees): expected a number ≥ -180 and ≤ 180, got 400"),
        ("pose", "tilt_right=90", "tilt_right (degrees): expected a number > -60 and < 60, got 90"),
        ("crosstalk", "100%", "Crosstalk: expected a number ≥ 1e-06 and < 1, got 1"),
        ("tolerance", "0.001", "≥ 0.01"),
        ("regions", "0x0", "2 to 100 in all, got 0x0"),
        ("regions", "99x99", "2 to 100 in all, got 99x99"),
        ("regions", "100000x100000", "2 to 100 in all"),
    ):
        type_in(page, key, text)
        assert words in form.error
        type_in(page, key, {"crosstalk": "0.5%", "tolerance": "0.1"}.get(key, ""))
        assert not form.error
    assert PlanSettings.of(context.state) == PlanSettings(source="array")


def test_regions_without_room_are_refused_before_frames_are_looked_for(
    open_page: OpenPage, context: Context, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lfcal.targets.iter_plan_target", lambda *_: pytest.fail("looked for frames"))
    page = open_page("setup")
    small_sensor = replace(SCAN.camera.sensor, shape=(48, 60))
    plan = ScanPlan.for_camera(replace(SCAN.camera, sensor=small_sensor), virtual_depths=(4.0,), cutout=31)
    context.project.update("small", plan=plan, camera=plan.camera)
    type_in(page, "source", "array:2x2@600um")
    type_in(page, "regions", "2x2")
    page.target.plan_target()
    idle(context.jobs, qtbot)
    assert "without regions" in page.target.message.text() or "regions" in page.target.message.text()


def test_a_search_for_a_plan_that_is_no_more_is_stopped(
    open_page: OpenPage, context: Context, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    def endless(*_: Any) -> Work[Any]:
        clock = Clock("search", 0)
        while True:
            yield clock.at(0)

    monkeypatch.setattr(model_target, "iter_target", endless)
    page = open_page("setup")
    type_in(page, "source", "array")
    page.target.plan_target()
    context.project.update("no plan", plan=None)
    assert not context.jobs.jobs()[0].active
    context.project.update("the plan", plan=SCAN)
    assert page.target.plan_button.isEnabled() and not page.target.stop_button.isEnabled()


def test_a_file_that_is_no_plan_is_named(open_page: OpenPage, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    page = open_page("setup")
    for text in ("{}", '{"format": "lfcal-target-plan", "version": 1}'):
        (tmp_path / "other.json").write_text(text)
        page.open_plan(str(tmp_path / "other.json"))
        idle(context.jobs, qtbot)
        assert page.notice.label.text().startswith("other.json: ")
    page.open_plan(str(tmp_path / "none.json"))
    idle(context.jobs, qtbot)
    assert page.notice.label.text().count("none.json") == 1


def test_nothing_of_the_target_is_cut_where_the_window_is_low(planned: Any, qtbot: QtBot) -> None:
    """With the jobs below the page, fields were as low as half a line, and the last costs were not seen."""
    target = planned.target
    planned.target.show()
    planned.target.resize(1060, 440)
    QApplication.processEvents()
    for part in (target.costs, target.save_button, *(target.form.editor(key) for key in target.form.fields)):
        assert part.height() >= part.minimumSizeHint().height()


def test_nothing_is_planned_with_the_value_before_one_that_is_refused(open_page: OpenPage, context: Context) -> None:
    page = open_page("setup")
    type_in(page, "source", "array")
    type_in(page, "tolerance", "0")
    page.target.plan_button.click()
    assert "Tolerance" in page.target.message.text() and not context.jobs.jobs()
