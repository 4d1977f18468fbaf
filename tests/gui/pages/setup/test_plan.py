from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from PySide6.QtWidgets import QFileDialog, QMessageBox
from pytestqt.qtbot import QtBot

from lfcal.acquire import RedoList
from lfcal.camera import ScanPlan, StageAxes, preset, stage_table, useq_sequence
from lfcal_gui.pages.setup.model_scan import ROWS, half_of
from lfcal_gui.pages.setup.model_target import PlanSettings
from lfcal_gui.pages.setup.step import scan_step
from lfcal_gui.window import MainWindow
from tests.camera.test_plan import camera_of
from tests.gui.waiting import idle


def test_plan_both_ways(window: MainWindow, qtbot: QtBot, tmp_path: Path) -> None:
    window.go("setup")
    page: Any = window.page("setup")
    inspector = page.panel.inspector
    page._set(preset("bench"), "preset bench")
    assert inspector.buttons["make"].isVisible() and inspector.scan.isHidden() and page.panel.strip.isHidden()
    page.save_plan()
    assert "no plan to save" in page.notice.label.text()
    inspector.buttons["make"].click()
    plan = window.project.state.plan
    assert plan is not None and not inspector.scan.isHidden() and page.panel.strip.count() == 4
    editor = page.panel.inspector.scan.editor("cutout")
    assert editor.text() == f"{plan.cutout[0]}, {plan.cutout[1]}"
    editor.setText("")
    editor.textEdited.emit("")
    assert window.project.state.plan == plan and editor.text() == f"{plan.cutout[0]}, {plan.cutout[1]}"  # by default
    editor.setText("41x43")
    editor.textEdited.emit("41x43")
    changed = window.project.state.plan
    assert changed is not None and changed.cutout == (41, 43) and editor.text() == "41x43"
    before = page.panel.forecast.text()
    editor.editingFinished.emit()
    editor.setText("40")
    editor.textEdited.emit("40")
    assert "odd" in page.panel.inspector.scan.error and window.project.state.plan == changed
    window.project.update("planes", plan=replace(changed, depths_um=changed.depths_um[:2], exposure_s=0.01))
    assert page.panel.forecast.text() != before
    page.save_plan(str(tmp_path / "plan.json"))
    assert ScanPlan.from_json((tmp_path / "plan.json").read_text()) == window.project.state.plan
    window.project.update("camera", camera=preset("r29"), plan=None)
    assert inspector.scan.isHidden()
    page.open_plan(str(tmp_path / "plan.json"))
    idle(window.jobs, qtbot)
    assert window.project.state.camera == preset("bench")


@pytest.mark.parametrize("half", [False, True])
@pytest.mark.parametrize("name", ["csv", "useq"])
def test_stage_positions_are_saved_for_other_programs(
    window: MainWindow, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, half: bool
) -> None:
    """Each format of the command is offered by *Save …*; the file is that of the command, and so is the copied one."""
    (tmp_path / "saved").mkdir()
    monkeypatch.chdir(tmp_path / "saved")
    plan = ScanPlan.for_camera(camera_of((6.0, 12.0), 1), virtual_depths=(3.0,), cutout=31)
    plan = replace(plan, stage=StageAxes(origin_um=(1.0, 2.0, 3.0)))
    settings = PlanSettings(half_cell=half).into(window.project.state)
    window.project.update("plan", camera=plan.camera, plan=plan, settings=settings)
    page: Any = window.page("setup")
    offered: list[str] = []

    def typed(*given: Any) -> tuple[str, str]:
        offered.extend(given[3].split(";;"))
        return str(Path.cwd() / given[2]), next(kind for kind in offered if name in kind)

    monkeypatch.setattr(QFileDialog, "getSaveFileName", typed)
    said: list[str] = []
    page.context.message.connect(said.append)
    page.save_plan()
    assert len(offered) == len(ROWS["written_as"].opt.choices)
    (made,) = Path.cwd().iterdir()
    assert "save the plan too" in said[-1] and made.name in said[-1]
    places = half_of(plan) if half else None
    assert made.read_text() == {"csv": stage_table, "useq": useq_sequence}[name](plan, places)
    exec(scan_step(window.project.state, made.name.replace("plan", "copied")).script(), {})
    (copied,) = Path.cwd().glob("copied*")
    assert copied.read_text() == made.read_text()


def test_a_plan_that_a_format_cannot_describe_is_refused(
    window: MainWindow, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    monkeypatch.setattr(QMessageBox, "warning", lambda *given: said.append(given[2]))
    plan = ScanPlan.for_camera(preset("bench"), virtual_depths=(3.0, 4.0), exposure_s=(0.01, 0.02))
    window.project.update("plan", camera=plan.camera, plan=plan)
    page: Any = window.page("setup")
    page.save_plan(str(tmp_path / "plan.useq.json"))
    assert "one for all planes" in said[-1] and not list(tmp_path.glob("plan*"))


def test_a_half_cell_scan_is_shown_and_saved_with_its_positions(
    window: MainWindow, qtbot: QtBot, tmp_path: Path
) -> None:
    plan = ScanPlan.for_camera(camera_of((6.0, 12.0), 1), virtual_depths=(3.0,), cutout=31)
    window.project.update("plan", camera=plan.camera, plan=plan)
    window.go("setup")
    page: Any = window.page("setup")
    said: list[str] = []
    page.context.message.connect(said.append)
    page.panel.inspector.scan.editor("half_cell").setChecked(True)
    assert "36 of 72 (half cell)" in page.panel.forecast.text() and len(list(page.panel.path_entries())) == 2
    resample = page.panel.inspector.scan.editor("resample")
    resample.setChecked(True)
    assert "half-cell scan: expected frames that are not resampled" in page.panel.inspector.scan.error
    assert window.project.state.plan == plan, "a half-cell scan takes frames as they are"
    page.save_plan(str(tmp_path / "plan.json"))
    assert ScanPlan.from_json((tmp_path / "plan.json").read_text()) == plan
    assert len(RedoList.read(tmp_path / "plan_positions.json").positions) == 36
    assert "plan_positions.json for Positions in Record > Rig" in said[-1]
    odd = ScanPlan.for_camera(camera_of((7.0, 12.0), 1), virtual_depths=(3.0,), cutout=31)
    window.project.update("camera", camera=odd.camera, plan=odd)
    assert (
        "half of which is not a whole number of pixels" in page.panel.inspector.refused.text()
        and not page.panel.inspector.refused.isHidden()
    )
    page.save_plan(str(tmp_path / "odd.json"))
    assert "not a whole number" in page.notice.label.text() and not (tmp_path / "odd.json").exists()
    page.panel.inspector.scan.editor("half_cell").setChecked(False)
    assert page.panel.inspector.refused.isHidden()
    page.panel.inspector.scan.editor("half_cell").setChecked(True)
    assert "not a whole number" in page.panel.inspector.scan.error
