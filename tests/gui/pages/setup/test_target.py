"""Targets of many points: planned, stopped, outdated, saved; the same by the page, its command and its script."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pytestqt.qtbot import QtBot
from typer.testing import CliRunner

from lfcal.base import Clock, InputError, Work, drain
from lfcal.camera import ScanPlan
from lfcal.cli._app import build_app
from lfcal.targets import Pose, TargetPlan, Wishes, parse_target, plan_target
from lfcal_gui.context import Context
from lfcal_gui.models import ProjectState
from lfcal_gui.pages.setup import model_scan as model
from lfcal_gui.pages.setup import model_target
from lfcal_gui.pages.setup.model_target import (
    MOST_DRAWN,
    PlaneDrawing,
    PlannedTarget,
    PlanSettings,
    iter_target,
    point_lines,
    read_plan,
    table_rows,
)
from lfcal_gui.pages.setup.step import step
from tests.gui.conftest import OpenPage
from tests.gui.waiting import idle
from tests.targets.common import small

SCAN = ScanPlan.for_camera(small(), virtual_depths=(4.0,), cutout=31)
ARRAY = "array:6x6@1021.3um"


def test_a_plan_is_the_library_s_and_its_drawing_tells_what_is_covered() -> None:
    found = drain(iter_target(SCAN, PlanSettings(ARRAY, most_frames=12)))
    (plane,) = found.planes
    assert len(found.plan.offsets_px[0]) == 12 and found.plan.target == parse_target(ARRAY)
    assert found.plan == plan_target(SCAN, parse_target(ARRAY), Wishes(most_frames=12))
    assert (plane.few, plane.many) == found.plan.points_a_frame(0)
    assert plane.coverage == found.plan.coverage(0) < 1
    for frame in (0, 11):  # as the plan returns them for a single frame
        rows = plane.points[plane.points[:, 0] == frame, 1:]
        np.testing.assert_allclose(rows, found.plan.points(0, frame).pixels)
    ((depth, frames, least, *_, covered, _),), _ = table_rows(found)
    assert depth.endswith("m") and frames == "12" and least == str(found.plan.least_frames(0)) and "%" in covered
    summary = {name: (ours, single) for name, ours, single in found.summary()}
    assert summary["Frames"] == ("12", "252")
    # the noise compared with a single point
    assert all(summary["Noise, middle plane"]) and "Frames, 3 regions" not in summary
    assert found.coding.startswith("Showing 7 frames together, coded: does not pay at 16000 electrons")
    assert found.coding_briefly == "Showing 7 frames together, coded: does not pay."
    assert summary["Phases, all planes"] == (f"{100 * plane.coverage:.2g} %", "100 %")
    lines = list(point_lines(plane, ","))
    assert lines[0] == "frame,row_px,column_px\n" and len(lines) == len(plane.points) + 1
    assert lines[1].startswith("1,") and lines[-1].startswith("12,")


def test_phases_in_the_summary_are_those_of_all_planes() -> None:
    scan = ScanPlan.for_camera(small(), virtual_depths=(4.0, 3.0), cutout=31)
    found = drain(iter_target(scan, PlanSettings("array:4x4@1300um", tolerance=0.3, most_frames=12)))
    shown = [found.plan.shown(z) > 0 for z in range(2)]
    assert shown[0].mean() != shown[1].mean()
    summary = {name: ours for name, ours, _ in found.summary()}
    assert summary["Phases, all planes"] == f"{100 * np.mean(shown):.2g} %"


def test_pose_and_regions_are_those_of_the_command() -> None:
    asked = PlanSettings(ARRAY, most_frames=3).changed("pose", "rotation=1,right=0.2mm").changed("regions", "1x3")
    for key, value in (("pose", "turn=1"), ("regions", "3")):
        with pytest.raises(InputError):
            asked.changed(key, value)
    found = drain(iter_target(SCAN, asked))
    assert (
        found.plan.target.pose == Pose.parse("rotation=1,right=200")
        and len(found.made.facts["regions"]["regions"]) == 3
    )
    summary = {name: given for name, *given in found.summary()}
    assert summary["Frames, 3 regions"] == ["3", "756"]
    assert PlanSettings.of_plan(found.plan).pose == "rotation=1,right=200"


def test_a_saved_plan_is_read_again_with_what_it_shows(tmp_path: Path) -> None:
    plan = plan_target(SCAN, parse_target(ARRAY), Wishes(most_frames=3))
    (tmp_path / "target.json").write_text(plan.to_json())
    (tmp_path / "scan.json").write_text(SCAN.to_json())
    found = read_plan(str(tmp_path / "target.json"))
    assert (
        isinstance(found, PlannedTarget)
        and found.plan == plan
        and len(found.made.facts["expected_error"][0]["error"]) == 3
    )
    assert read_plan(str(tmp_path / "scan.json")) == SCAN


def test_whole_frames_are_drawn_and_the_scan_path_is_a_table() -> None:
    frames = np.repeat(np.arange(4.0), MOST_DRAWN // 3)
    plane = PlaneDrawing(np.column_stack([frames, frames, frames]), 1, 1, np.ones((2, 2), np.intp))
    assert set(plane.drawn()[:, 0]) == {0.0, 1.0, 2.0}
    one = PlaneDrawing(np.zeros((MOST_DRAWN + 1, 3)), 1, 1, np.ones((2, 2), np.intp))
    assert len(one.drawn()) == MOST_DRAWN + 1
    head, first, *rest = model.path_lines(SCAN, "\t")
    assert head == "y\tx\trow_px\tcolumn_px\n" and len(rest) == 251
    assert [float(part) for part in first.split("\t")] == pytest.approx([0, 0, *SCAN.anchor])
    y, x, row, column = (float(part) for part in rest[-1].split("\t"))
    assert (row, column) == pytest.approx((SCAN.anchor[0] + y, SCAN.anchor[1] + x), abs=0.5)


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


def test_what_is_planned_is_shown_and_written_the_same_by_every_route(
    planned: Any, context: Context, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, qtbot: QtBot
) -> None:
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
    monkeypatch.chdir(tmp_path)
    planned.target.save_target("mine.json")
    saved = TargetPlan.from_json(Path("mine.json").read_text())
    assert saved == planned.target.found.plan
    (taken,) = context.history.taken
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
    idle(context.jobs, qtbot)
    scanned = context.history.taken[-1].step
    assert "target" not in scanned.arguments


def test_holes_too_close_are_refused_in_words(open_page: OpenPage, context: Context, qtbot: QtBot) -> None:
    page = open_page("setup")
    type_in(page, "source", "array:6x6@200um")
    page.target.plan_target()
    idle(context.jobs, qtbot)
    target = page.target
    assert "crosstalk of holes" in target.message.text() and target.found is None
    assert target.plan_button.isEnabled() and not target.stop_button.isEnabled()


def test_a_proposed_pitch_is_asked_for_in_both(state: ProjectState) -> None:
    asked = PlanSettings("array,hole=20um", 0.2)
    made = step(replace(state, settings=asked.into(state)))
    assert {"array,hole=20um", "--tolerance=0.2", "--out=target_plan.json"} <= set(made.arguments)
    assert "source='array,hole=20um'" in made.python and "tolerance=0.2" in made.python


def endless(*_: Any) -> Work[Any]:
    clock = Clock("search", 0)
    while True:
        yield clock.at(0)


def test_a_search_is_stopped_and_ends_with_its_wishes_and_its_plan(
    open_page: OpenPage, context: Context, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(model_target, "iter_target", endless)
    page = open_page("setup")
    target = page.target
    type_in(page, "source", "array")
    target.plan_target()
    assert target.stop_button.isEnabled() and "Searching for" in target.message.text()
    target.stop_button.click()
    idle(context.jobs, qtbot)
    assert not target.stop_button.isEnabled() and "There is no plan yet" in target.message.text()
    target.plan_target()
    type_in(page, "tolerance", "0.2")  # what is looked for is wanted no longer
    idle(context.jobs, qtbot)
    assert target.plan_button.isEnabled() and target.found is None
    target.plan_target()
    context.project.update("no plan", plan=None)
    assert not context.jobs.jobs()[0].active
    context.project.update("the plan", plan=SCAN)
    assert target.plan_button.isEnabled() and not target.stop_button.isEnabled()


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
    type_in(page, "tolerance", "0")
    page.target.plan_button.click()
    assert "Tolerance" in page.target.message.text() and not context.jobs.jobs(), "the value before is not used"


def test_a_plan_of_other_values_is_shown_no_longer_and_a_saved_one_is_opened_again(
    planned: Any, context: Context, qtbot: QtBot, tmp_path: Path
) -> None:
    target, path = planned.target, tmp_path / "target_plan.json"
    plan = target.found.plan
    target.save_target(str(path))
    planned.save_plan(str(tmp_path / "plan.json"))
    idle(context.jobs, qtbot)
    latest = context.history.latest("setup")
    assert latest == str(tmp_path / "plan.json"), "no copied step replaces the other plan"
    assert "--out=target_plan.json" in step(context.state, latest).arguments
    assert f"--out={latest}" in step(replace(context.state, settings={}), latest).arguments
    context.project.update("name", name="other")
    context.project.update("exposure", plan=replace(SCAN, exposure_s=0.5))
    assert target.found is None and not target.save_button.isEnabled() and target.stack.currentIndex() == 0
    target.save_target()
    assert "no target plan" in target.message.text()
    planned.open_plan(str(path))
    idle(context.jobs, qtbot)
    assert target.found.plan == plan and context.state.plan == SCAN and target.isVisible()
    assert PlanSettings.of(context.state).source == ARRAY


def test_words_of_no_target_are_refused_and_settings_are_kept_in_a_project() -> None:
    asked = PlanSettings()
    assert not asked.many and asked.changed("source", " array ").many
    for key, value, name in (
        ("source", "array:6x6", "ROWSxCOLUMNS"),
        ("tolerance", 0.0, "Tolerance"),
        ("crosstalk", "2", "Crosstalk"),
        ("most_frames", 0, "Largest number of frames"),
    ):
        with pytest.raises(InputError, match=name) as refused:
            asked.changed(key, value)
        assert "\n" not in str(refused.value)
    asked = PlanSettings(ARRAY, 0.2, 0.01, 7)
    project = ProjectState(settings=asked.into(ProjectState()))
    assert PlanSettings.of(ProjectState.from_json(project.to_json())) == asked
    assert PlanSettings.of(ProjectState(settings={"plan": {"source": "nonsense"}})) == PlanSettings()


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
