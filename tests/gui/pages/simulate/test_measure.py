"""Measurements that determine undescribed effects: one click plans them, as the printed commands do."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from PySide6.QtWidgets import QFileDialog
from pytestqt.qtbot import QtBot

from lfcal.acquire import RedoList
from lfcal.camera import ScanPlan
from lfcal_gui.pages.acquire.model import AcquireSettings
from lfcal_gui.pages.h.model_fit import FitSettings
from lfcal_gui.window import MainWindow
from tests.cli import conftest
from tests.gui.pages.simulate.test_model import small_plan
from tests.gui.waiting import idle

lfcal = conftest.lfcal


@pytest.fixture
def page(window: MainWindow, qtbot: QtBot, tmp_path: Path) -> Iterator[Any]:
    """Record > Compute, which shows the measurements for a small plan while positions of bead frames are chosen."""
    plan = small_plan()
    window.project.update("plan", camera=plan.camera, plan=plan)
    window.go("simulate")
    found: Any = window.page("simulate")
    idle(window.jobs, qtbot)
    found.panel.measure_button.click()
    yield found
    if found.dialog is not None:
        found.dialog.close()


def test_one_click_plans_the_bead_frames_of_the_printed_commands(
    page: Any, qtbot: QtBot, lfcal: Any, tmp_path: Path
) -> None:
    """The plan can be saved, and used: its positions for recording, its unknowns for the fit, with one undo."""
    idle(page.context.jobs, qtbot)
    beads, before = page.dialog.beads, page.context.state
    assert f"{len(beads.made.plan.held_out)} held out" in page.dialog.planned.text()
    page.save_beads(str(tmp_path / "beads.json"))
    planned, fitted = (shlex.split(command) for command in beads.measurement.commands_for("bench")[:2])
    assert planned[:3] == ["lfcal", "plan", "bench"] and fitted[:3] == ["lfcal", "plan", "fit"]
    saved = ScanPlan.from_json((tmp_path / "beads.json").read_text())
    depths = planned[3].partition("=")[2].split(",")
    assert saved.depths_um == pytest.approx(list(map(float, depths))) and saved.cutout == before.plan.cutout
    done = lfcal(*(str(tmp_path / word) if word.endswith(".json") else word for word in fitted[1:]))
    assert done.code == 0, done.err
    chosen = (tmp_path / "positions.json").read_text()
    assert json.loads((tmp_path / "beads_positions.json").read_text()) == json.loads(chosen)
    assert page.context.history.taken[-1].step.arguments[:2] == ("plan", "fit")
    page.dialog.use_button.click()
    state = page.context.state
    assert page.dialog is None and state.plan == saved != before.plan
    settings = AcquireSettings.of(state)
    settings.options()
    assert len(RedoList.read(Path(settings.positions)).positions) == beads.measurement.frames
    assert not FitSettings.of(state).auto and FitSettings.of(state).unknowns == beads.measurement.unknowns
    page.context.project.undo()
    assert (page.context.state.plan, page.context.state.settings) == (before.plan, before.settings)


def test_the_other_measurements_lead_to_where_they_are_done(
    page: Any, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    monkeypatch.setattr(QFileDialog, "getOpenFileName", lambda *given: (asked.append(given[1]), ("", ""))[1])
    page.dialog.white_button.click()
    assert asked == ["White image"] and page.dialog is None
    page.measure_effects()
    page.dialog.values_button.click()
    (stated,) = [one for one in page.verdict.missing.measurements if not one.frames]
    assert page.panel.table.selected == stated.rows[0].name and page.dialog is None
    idle(page.context.jobs, qtbot)


def test_a_dialog_of_another_plan_is_closed(page: Any, qtbot: QtBot) -> None:
    page.context.project.update("no plan", plan=None)
    assert page.dialog is None
