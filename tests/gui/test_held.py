"""While a session is recorded camera, plan and devices stay; who is refused sees why, and hears no false success."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pytestqt.qtbot import QtBot

from lfcal.camera import Marks, ScanPlan, preset
from lfcal_gui.context import Context
from lfcal_gui.models.project import Hold, Project, ProjectState
from lfcal_gui.pages.setup.model import confirmed
from lfcal_gui.window import MainWindow
from tests.gui.recorded import write_recorded
from tests.gui.waiting import idle

WHY = "a session is being recorded"


@pytest.fixture
def held(window: MainWindow) -> MainWindow:
    """Return a window whose camera and plan are held as by a recording."""
    plan = ScanPlan.for_camera(preset("bench"), virtual_depths=(3.0,))
    window.project.start(ProjectState(camera=plan.camera, plan=plan))
    hold = Hold(WHY, ("camera", "plan", "recording"), ("acquire",), window.context.refused.emit)
    window.project.hold(hold)
    return window


def test_every_way_to_another_camera_or_plan_is_refused_where_one_looks(
    held: MainWindow, tmp_path: Path, qtbot: QtBot
) -> None:
    """The page showed nothing, and the log said that the camera had been taken."""
    (tmp_path / "camera.json").write_text(preset("r29").to_json())
    (tmp_path / "plan.json").write_text(ScanPlan.for_camera(preset("r29"), virtual_depths=(3.0,)).to_json())
    frames = write_recorded(tmp_path / "recorded")
    before = held.project.state
    pages: dict[str, Any] = {key: held.page(key) for key in ("setup", "frames")}
    ways: tuple[tuple[str, Callable[[], object]], ...] = (
        ("setup", lambda: pages["setup"].import_file(str(tmp_path / "camera.json"))),
        ("setup", lambda: pages["setup"].panel.inspector.preset_chosen.emit("r29")),
        ("setup", lambda: pages["setup"].open_plan(str(tmp_path / "plan.json"))),
        ("setup", lambda: held.take_files([str(tmp_path / "plan.json")])),
        ("frames", lambda: pages["frames"].open_folder(str(frames))),
    )
    for key, way in ways:
        held.go(key)
        pages[key].notice.clear()
        way()
        idle(held.jobs, qtbot)
        assert held.project.state == before, key
        assert pages[key].notice.isVisible() and WHY in pages[key].notice.label.text(), key
    assert "taken from" not in held.log_view.toPlainText() and held.log_view.toPlainText().count(WHY) == len(ways)
    assert pages["frames"]._ready is None, "frames that are not wanted are closed"


def test_where_values_come_from_is_held_too() -> None:
    path = "optics.f_number"
    found = replace(preset("bench"), marks=Marks.of({path: "assumed"}))
    project, told = Project(ProjectState(camera=found)), list[str]()
    project.hold(Hold(WHY, ("camera",), report=told.append))
    assert not project.update("confirm", camera=confirmed(found, [path])) and told == [WHY]
    assert project.state.camera.marks == found.marks


def test_what_is_refused_is_not_called_done(held: MainWindow, qtbot: QtBot) -> None:
    """A point of Accuracy, a stage that was measured, a lattice, a sensor: each said that it had been taken."""
    context: Context = held.context
    plan = context.state.plan
    assert plan is not None
    held.go("acquire")
    setup: Any = held.page("acquire").setup  # type: ignore[attr-defined]
    turned = replace(plan, stage=plan.stage.__class__("-x", "+y", "+z"))
    assert setup.measuring._take("stage axes as measured", turned) == ""
    held.go("setup")
    camera: Any = held.page("setup")
    camera.measure_sensor()
    taken = preset("r29")
    assert not camera.dialog._take_over(taken, "measured sensor")
    camera.dialog.close()
    assert context.state.plan == plan and context.state.camera == plan.camera
