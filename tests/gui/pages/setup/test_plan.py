"""Scan plans in the window: time against noise, moved, saved for other programs, by half."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from PySide6.QtWidgets import QFileDialog
from pytestqt.qtbot import QtBot

from lfcal.acquire import RedoList
from lfcal.base import LfcalError, drain
from lfcal.camera import Camera, Forecast, Marks, ScanPlan, StageAxes, preset, stage_table, useq_sequence
from lfcal.simulate import iter_expected_light
from lfcal.tasks import plan_text
from lfcal_gui.context import Context
from lfcal_gui.models import Step, next_step
from lfcal_gui.pages.setup import model_picture, model_scan
from lfcal_gui.pages.setup.model_picture import ScanCosts, numbers_of
from lfcal_gui.pages.setup.model_scan import ROWS, half_of
from lfcal_gui.pages.setup.model_target import PlanSettings
from lfcal_gui.pages.setup.step import scan_step
from lfcal_gui.window import MainWindow
from tests.camera.test_plan import camera_of
from tests.gui.conftest import OpenPage
from tests.gui.waiting import idle

PLAN = ScanPlan.for_camera(preset("bench"), virtual_depths=(3.0, 4.0), cutout=55)


def assumed(*paths: str) -> Camera:
    return replace(preset("bench"), marks=Marks.of(dict.fromkeys(paths, "assumed")))


def typed(form: Any, key: str, text: str) -> None:
    form.editor(key).setText(text)
    form.editor(key).textEdited.emit(text)


def test_the_slider_changes_time_and_noise(open_page: OpenPage, context: Context, qtbot: QtBot) -> None:
    page = open_page("setup")
    context.project.update("made", plan=PLAN)
    row = page.panel.numbers
    assert row.numbers[2].value == "…" and not row.slider.isEnabled()
    page.entered()
    idle(context.jobs, qtbot)
    share = drain(iter_expected_light(PLAN)).noise(PLAN)
    wanted = (sum(one**2 for one in share) / len(share)) ** 0.5
    assert float(row.numbers[2].value) == pytest.approx(100 * wanted, rel=0.05)
    begun, before = row.slider.value(), row.numbers
    assert row.slider.isEnabled() and row.slider.maximum() == 10
    row.slider.setValue(begun + 2)
    plan = context.state.plan
    assert plan == replace(PLAN, frames_averaged=4)
    assert float(row.numbers[2].value) == pytest.approx(100 * wanted / 2, rel=0.06)
    assert page.panel.costs.forecast.hours == Forecast.of(plan).hours
    assert row.numbers[0] != before[0] and row.title.text().endswith("4 frames of 20 ms")
    row.slider.setValue(begun - 2)
    assert context.state.plan == replace(PLAN, exposure_s=0.005), "the same light: less of the full well"
    assert PlanSettings.of(context.state).peak == pytest.approx(0.2)
    assert page.panel.inspector.scan.editor("peak").text() == "20 %" and row.slider.value() == begun - 2
    context.project.undo()
    assert context.state.plan == PLAN and PlanSettings.of(context.state).peak == 0.8
    assert row.slider.value() == begun and row.numbers == before


def test_the_noise_is_computed_once_and_its_failure_is_shown(
    open_page: OpenPage, context: Context, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[ScanPlan] = []
    troubles: list[str] = []
    context.jobs.trouble.connect(troubles.append)

    def fail(plan: ScanPlan) -> None:
        asked.append(plan)
        raise LfcalError("too large")

    monkeypatch.setattr("lfcal_gui.pages.setup.page.expected_light", fail)
    page = open_page("setup")
    page.entered()
    context.project.update("made", plan=PLAN)
    context.project.update("longer", plan=replace(PLAN, frames_averaged=2))
    idle(context.jobs, qtbot)
    noise = page.panel.numbers.numbers[2]
    assert (noise.value, noise.unit, noise.words) == ("-", "noise of H", "computation failed")
    assert len(asked) == 1 and troubles == ["the noise of H could not be computed: too large"]


def test_choices_stay_while_the_slider_is_dragged(open_page: OpenPage, context: Context, qtbot: QtBot) -> None:
    page = open_page("setup")
    three = replace(PLAN, frames_averaged=3)
    context.project.update("made", plan=three)
    page.entered()
    idle(context.jobs, qtbot)
    slider = page.panel.numbers.slider
    assert slider.maximum() == 11, "the plan's averages are none of the steps"
    slider.setSliderDown(True)
    slider.setSliderPosition(slider.value() + 1)
    assert context.state.plan.frames_averaged == 4 and slider.maximum() == 11
    slider.setSliderDown(False)
    assert slider.maximum() == 10


def test_what_is_not_stated_of_the_sensor_is_said_and_no_number_is_made_up() -> None:
    camera = assumed("sensor.full_well_e", "sensor.read_noise_e")
    costs = ScanCosts.of(replace(PLAN, camera=camera), PlanSettings(), None, drain(iter_expected_light(PLAN)))
    noise = numbers_of(costs, None)[2]
    assert (noise.value, noise.unit) == ("-", "noise of H") and noise.words == "full well and read noise only assumed"
    none = ScanCosts.of(PLAN, PlanSettings(peak=None), None, None)
    assert numbers_of(none, None)[2].words == "brightest pixel not planned"


def test_a_cutout_that_leaves_the_sensor_moves_the_scan(window: MainWindow) -> None:
    window.go("setup")
    page: Any = window.page("setup")
    plan = replace(PLAN, anchor=(40.0, 144.0))
    window.project.update("made", plan=plan)
    form = page.panel.inspector.scan

    def comes_next() -> Step:
        window.leading.gather()
        return next_step(window.leading.sitting)

    typed(form, "cutout", "121")
    step = comes_next()
    assert "expected rows" in form.error and window.project.state.plan == plan
    assert step.line == "Next: the cutout leaves the sensor: move the scan." and step.button == "Move it"
    window.leading.do(step.action)
    moved = window.project.state.plan
    assert (moved.cutout, moved.anchor) == ((121, 121), (78.0, 144.0)) and not form.error
    assert comes_next().action != "setup.move"
    window.project.undo()
    typed(form, "cutout", "303")
    step = comes_next()
    assert step.words == "change the plan: the cutout may have at most 301 × 287 px on this sensor."
    assert step.action == "setup.show"
    typed(form, "cutout", "57")
    assert "sensor" not in comes_next().words and window.project.state.plan == replace(plan, cutout=(57, 57))


def test_only_assumed_values_on_which_much_depends_are_asked_for(window: MainWindow, qtbot: QtBot) -> None:
    window.go("setup")
    page: Any = window.page("setup")
    camera = assumed("optics.f_number", "sensor.prnu", "lattice.gap_um", "sensor.shape")
    window.project.update("made", camera=camera, plan=replace(PLAN, camera=camera))
    idle(window.jobs, qtbot)
    window.leading.gather()
    assert window.leading.sitting.assumed == ("gap", "f-number")
    rows = page.panel.inspector.assumed_list.rows
    assert [path for path, *_ in rows[:2]] == ["lattice.gap_um", "optics.f_number"] and len(rows) == 4
    assert rows[0][2].startswith("H by up to ") and rows[-1][2] == "no change"
    page.panel.inspector.assumed_list.ticks["lattice.gap_um"].click()
    assert window.project.state.camera.marks["lattice.gap_um"] == "stated"
    idle(window.jobs, qtbot)
    window.leading.gather()
    assert window.leading.sitting.assumed == ("f-number",)
    page.panel.inspector.values.open()
    assert page.panel.inspector.assumed_list.isVisible()
    page.panel.inspector.buttons["confirm"].click()
    assert not page.panel.inspector.assumed_list.isVisible(), "no gap above the buttons"


def count(monkeypatch: pytest.MonkeyPatch, place: Any, name: str) -> list[object]:
    calls: list[object] = []
    own: Callable[..., Any] = getattr(place, name)

    def counted(*given: Any, **named: Any) -> Any:
        calls.append(given)
        return own(*given, **named)

    monkeypatch.setattr(place, name, counted)
    return calls


def test_exposures_are_shown_and_typed_in_milliseconds(open_page: OpenPage, context: Context) -> None:
    page = open_page("setup")
    context.project.update("made", plan=PLAN)
    form = page.panel.inspector.scan
    assert form.editor("exposure").text() == "20" and form.fields["exposure"].unit == "ms"
    typed(form, "exposure", "28.3")
    assert context.state.plan == replace(PLAN, exposure_s=0.0283)
    typed(form, "exposure", "20, 50")
    assert context.state.plan == replace(PLAN, exposure_s=(0.02, 0.05))
    assert form.editor("exposure").text() == "20, 50" and page.panel.costs.way == "1 frame of 20 ms … 50 ms"
    for wrong, said in (
        ("0", "Exposure: expected a number > 0"),
        ("", "xposure"),
        ("20 s", "Exposure: expected numbers"),
    ):
        typed(form, "exposure", wrong)
        assert said in form.error and 0 not in context.state.plan.exposures


def test_a_plan_is_made_and_saved(open_page: OpenPage, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    page = open_page("setup")
    inspector = page.panel.inspector
    page._set(preset("bench"), "preset bench")
    assert inspector.buttons["make"].isVisible() and inspector.scan.isHidden() and page.panel.strip.isHidden()
    page.save_plan()
    assert "no plan to save" in page.notice.label.text()
    inspector.buttons["make"].click()
    plan = context.state.plan
    assert plan is not None and not inspector.scan.isHidden() and page.panel.strip.count() == 4
    editor = page.panel.inspector.scan.editor("cutout")
    assert editor.text() == f"{plan.cutout[0]}, {plan.cutout[1]}"
    editor.setText("")
    editor.textEdited.emit("")
    assert context.state.plan == plan and editor.text() == f"{plan.cutout[0]}, {plan.cutout[1]}"  # by default
    editor.setText("41x43")
    editor.textEdited.emit("41x43")
    changed = context.state.plan
    assert changed.cutout == (41, 43) and editor.text() == "41x43"
    before = page.panel.forecast.text()
    editor.editingFinished.emit()
    editor.setText("40")
    editor.textEdited.emit("40")
    assert "odd" in page.panel.inspector.scan.error and context.state.plan == changed
    context.project.update("planes", plan=replace(changed, depths_um=changed.depths_um[:2], exposure_s=0.01))
    assert page.panel.forecast.text() != before
    page.save_plan(str(tmp_path / "plan.json"))
    idle(context.jobs, qtbot)
    assert ScanPlan.from_json((tmp_path / "plan.json").read_text()) == context.state.plan
    context.project.update("camera", camera=preset("r29"), plan=None)
    assert inspector.scan.isHidden()
    page.open_plan(str(tmp_path / "plan.json"))
    idle(context.jobs, qtbot)
    assert context.state.camera == preset("bench")


@pytest.mark.parametrize(("name", "half"), [("csv", False), ("useq", False), ("csv", True)])
def test_stage_positions_are_saved_for_other_programs(
    open_page: OpenPage,
    context: Context,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    qtbot: QtBot,
    name: str,
    half: bool,
) -> None:
    """Each format of the command is offered by *Save …*; the file is that of the command, and so is the copied one."""
    (tmp_path / "saved").mkdir()
    monkeypatch.chdir(tmp_path / "saved")
    plan = replace(half_plan(6.0), stage=StageAxes(origin_um=(1.0, 2.0, 3.0)))
    settings = PlanSettings(half_cell=half).into(context.state)
    context.project.update("plan", camera=plan.camera, plan=plan, settings=settings)
    page, offered, said, threads = open_page("setup"), list[str](), list[str](), set[threading.Thread]()

    def watched(*given: Any) -> str:
        threads.add(threading.current_thread())
        return plan_text(*given)

    monkeypatch.setattr(model_scan, "plan_text", watched)

    def typed(*given: Any) -> tuple[str, str]:
        offered.extend(given[3].split(";;"))
        return str(Path.cwd() / given[2]), next(kind for kind in offered if name in kind)

    monkeypatch.setattr(QFileDialog, "getSaveFileName", typed)
    context.message.connect(said.append)
    page.save_plan()
    idle(context.jobs, qtbot)
    assert threads and threading.main_thread() not in threads, "a large scan takes a while to write"
    assert len(offered) == len(ROWS["written_as"].opt.choices)
    (made,) = Path.cwd().iterdir()
    assert "save the plan too" in said[-1] and made.name in said[-1]
    places = half_of(plan) if half else None
    assert made.read_text() == {"csv": stage_table, "useq": useq_sequence}[name](plan, places)
    exec(scan_step(context.state, made.name.replace("plan", "copied")).script(), {})
    (copied,) = Path.cwd().glob("copied*")
    assert copied.read_text() == made.read_text()
    two = ScanPlan.for_camera(preset("bench"), virtual_depths=(3.0, 4.0), exposure_s=(0.01, 0.02))
    whole = PlanSettings().into(context.state)
    context.project.update("plan", camera=two.camera, plan=two, settings=whole)
    page.save_plan(str(tmp_path / "plan.useq.json"))
    idle(context.jobs, qtbot)
    assert "one for all planes" in page.notice.label.text() and not list(tmp_path.glob("plan*")), (
        "a format cannot describe it"
    )


def test_only_what_changed_is_drawn(
    open_page: OpenPage, context: Context, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(plan: ScanPlan) -> None:
        raise LfcalError("not simulated")

    monkeypatch.setattr("lfcal_gui.pages.setup.page.expected_light", none)
    camera = preset("r29")
    planes = [2.0 + 0.05 * k for k in range(60)]
    page = open_page("setup")
    page.hide()
    context.project.update("made", camera=camera, plan=ScanPlan.for_camera(camera, virtual_depths=planes))
    assert not context.jobs.busy, "nothing is simulated for a place that is not looked at"
    page.show()
    idle(context.jobs, qtbot)
    inspector, strip = page.panel.inspector, page.panel.strip
    shown, tiles = count(monkeypatch, inspector, "show_camera"), count(monkeypatch, strip, "show_tiles")
    costs = count(monkeypatch, model_picture.Forecast, "of")
    typed(inspector.scan, "average", "2")
    assert context.state.plan.n_positions > 300_000
    assert not shown and not tiles and len(costs) == 1
    typed(inspector.scan, "cutout", "151")
    assert not shown and len(tiles) == 1


def half_plan(rows: float) -> ScanPlan:
    return ScanPlan.for_camera(camera_of((rows, 12.0), 1), virtual_depths=(3.0,), cutout=31)


def test_a_half_cell_scan_is_saved_with_its_list(
    open_page: OpenPage, context: Context, tmp_path: Path, qtbot: QtBot
) -> None:
    plan = half_plan(6.0)
    context.project.update("plan", camera=plan.camera, plan=plan)
    page, said = open_page("setup"), list[str]()
    context.message.connect(said.append)
    scan, refused = page.panel.inspector.scan, page.panel.inspector.refused
    scan.editor("half_cell").setChecked(True)
    assert "36 of 72 (half cell)" in page.panel.forecast.text() and len(list(page.panel.path_entries())) == 2
    scan.editor("resample").setChecked(True)
    assert "half-cell scan: expected frames that are not resampled" in scan.error
    assert context.state.plan == plan, "a half-cell scan takes frames as they are"
    page.save_plan(str(tmp_path / "plan.json"))
    idle(context.jobs, qtbot)
    assert ScanPlan.from_json((tmp_path / "plan.json").read_text()) == plan
    assert len(RedoList.read(tmp_path / "plan_positions.json").positions) == 36
    assert "plan_positions.json for Positions in Record > Rig" in said[-1]
    odd = half_plan(7.0)
    context.project.update("camera", camera=odd.camera, plan=odd)
    assert "half of which is not a whole number of pixels" in refused.text() and not refused.isHidden()
    page.save_plan(str(tmp_path / "odd.json"))
    assert "not a whole number" in page.notice.label.text() and not (tmp_path / "odd.json").exists()
    scan.editor("half_cell").setChecked(False)
    assert refused.isHidden()
    scan.editor("half_cell").setChecked(True)
    assert "not a whole number" in scan.error
