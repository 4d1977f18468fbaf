"""Record > Compute: H and its cost, the verdict on effects, measurements that determine them."""

from __future__ import annotations

import json
import shlex
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QFileDialog
from pytestqt.qtbot import QtBot

import lfcal_gui.pages.simulate.page as simulate_page
from lfcal.accuracy import PARTS, AccuracyStep, CostPoint, Truth
from lfcal.acquire import RedoList
from lfcal.base import format_seconds
from lfcal.camera import ScanPlan
from lfcal.psf import open_psf
from lfcal.simulate import simulate_psf
from lfcal_gui.context import Context
from lfcal_gui.jobs import JobState
from lfcal_gui.pages.acquire.model import AcquireSettings
from lfcal_gui.pages.h.model_fit import FitSettings
from lfcal_gui.pages.simulate._effects_table import SETTING
from lfcal_gui.pages.simulate.model import SimulateSettings, pattern_of
from lfcal_gui.pages.simulate.model_effects import EffectsVerdict, verdict_of
from lfcal_gui.window import MainWindow
from tests.cli import conftest
from tests.gui.pages.simulate.test_model import small_plan
from tests.gui.waiting import GUARD_MS, idle


def click(table: Any, name: str, qtbot: QtBot) -> None:
    """Click with the mouse on the setting of an effect."""
    item = table._items[name]
    item.parent().setExpanded(True)
    table.scrollToItem(item)
    at = table.visualItemRect(item).center()
    at.setX(table.columnViewportPosition(SETTING) + 10)
    qtbot.mouseClick(table.viewport(), Qt.MouseButton.LeftButton, pos=at)


@pytest.fixture
def answer(context: Context) -> Iterator[threading.Event]:
    """Return what a slow planner waits for; jobs cannot close before."""
    event = threading.Event()
    yield event
    event.set()


def test_before_the_planner_answers_nothing_uses_its_last_answer(
    open_page: Any,
    context: Context,
    qtbot: QtBot,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    answer: threading.Event,
) -> None:
    context.project.update("plan", plan=replace(small_plan(), resample=False))
    page = open_page("simulate")
    level = page.panel.forms[1].editor("level")
    level.setCurrentIndex(level.findData("geometric"))
    idle(context.jobs, qtbot)
    asked: list[tuple[tuple[str, ...], str]] = []

    def slow_planner(plan: ScanPlan, settings: SimulateSettings) -> EffectsVerdict:
        answer.wait()
        return verdict_of(plan, settings)

    def watched(plan: ScanPlan, place: Any, effects: tuple[Any, ...], level: str, tolerance: float) -> Any:
        asked.append((tuple(e.name for e in effects), level))
        return pattern_of(plan, place, effects, level, tolerance)

    monkeypatch.setattr(simulate_page, "verdict_of", slow_planner)
    monkeypatch.setattr("lfcal_gui.pages.simulate.model.pattern_of", watched)
    assert "vignetting" not in {e.name for e in page.verdict.found}
    page.panel.table.choice_asked.emit("vignetting", "on")
    with qtbot.waitSignal(context.jobs.finished, timeout=GUARD_MS) as end:
        page.simulate(str(tmp_path / "sim.h5"))
    assert end.args[0].state is JobState.DONE, end.args[0].error
    with open_psf(tmp_path / "sim.h5") as H:
        assert "vignetting" in {effect["name"] for effect in H.provenance["simulated"]["effects"]}
    page.panel.place.column_box.setValue(0)
    qtbot.waitUntil(lambda: bool(asked), timeout=GUARD_MS)
    answer.set()
    idle(context.jobs, qtbot)
    assert asked[0] == ((), "geometric"), "rays, which need no planner"
    assert all("vignetting" in names for names, _ in asked[1:]) and len(asked) > 1


def test_without_a_plan_no_button_is_dead(open_page: Any, context: Context) -> None:
    page = open_page("simulate")
    for press in (page.simulate, page.simulate_frames, page.measure):
        page.notice.clear()
        press()
        assert "no scan plan" in page.notice.label.text()


POINTS = ((0.3, "wave", 0.15, 1.0), (0.1, "wave", 0.05, 2.0), (0.03, "grid", 0.01, 1.5), (0.01, "grid", 0.004, 3.0))
"""Tolerance, level, error and seconds as a measurement finds them."""


def course(go_on: threading.Event | None = None) -> Iterator[Any]:
    """Yield what measuring the simulation yields; half of it before the event."""
    yield Truth("the reference")
    for k, (tolerance, level, error, seconds) in enumerate(POINTS):
        if k == 2 and go_on is not None:
            yield AccuracyStep("next", 0.0)
            go_on.wait(GUARD_MS / 1e3)
        label = f"tolerance {100 * tolerance:g} %, {level}, 6 effects"
        yield CostPoint(label, {"tolerance": tolerance, "level": level}, error, seconds, "seconds")


def measured_by(monkeypatch: pytest.MonkeyPatch, course: Any) -> None:
    told = replace(PARTS.get("simulation"), measure=lambda subject, seconds: course())
    monkeypatch.setattr("lfcal.accuracy.PARTS", SimpleNamespace(get=lambda name: told))


@pytest.fixture
def page(open_page: Any, context: Context, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> Any:
    measured_by(monkeypatch, course)
    context.project.update("plan", plan=small_plan())
    made = open_page("simulate", 640)
    idle(context.jobs, qtbot)
    return made


def test_the_curve_says_what_the_tolerance_in_force_costs(page: Any, context: Context, qtbot: QtBot) -> None:
    panel = page.panel
    assert panel.seconds_words.text() == "for all of H" and panel.error.text() == "3 %"
    assert panel.seconds.text() == format_seconds(context.reported["simulate"]["compute_s"])
    panel.curve.measure_button.click()
    assert not panel.curve.measure_button.isEnabled()
    idle(context.jobs, qtbot)
    assert len(panel.curve.scatter.data) == len(POINTS) and panel.curve.status.text().startswith("measured in ")
    assert (panel.seconds.text(), panel.error.text(), panel.error_words.text()) == ("1.5 s", "1 %", "error, measured")
    panel.curve.moved.emit(0.2)
    assert SimulateSettings.of(context.state).tolerance == 0.2
    assert (panel.seconds.text(), panel.error.text()) == ("2.0 s", "5 %"), "of the tolerance that was measured below it"
    context.paces.take("compute", forecast=1.0, seconds=4.0)
    page._show_curve()
    told = context.paces.corrected(context.reported["simulate"])
    assert panel.seconds.text() == format_seconds(told["compute_s"]) == "8.0 s", "that of the line of the next step"
    assert panel.better.text() == "Tolerance 3 % is faster and no less exact: 6.0 s, error 1 %."
    context.paces.runs.clear()
    page._show_curve()
    assert panel.better.text() == "Tolerance 3 % is faster and no less exact: 1.5 s, error 1 %."
    page._set("level", "wave")
    idle(context.jobs, qtbot)
    assert panel.error_words.text() == "error requested", "it was measured at level auto"
    panel.curve.chosen.emit(next(k for k, point in enumerate(page._curve.points) if point.error == 0.15))
    settings = SimulateSettings.of(context.state)
    assert (settings.tolerance, settings.level, panel.seconds.text()) == (0.3, "auto", "1.0 s")
    context.project.undo()
    assert SimulateSettings.of(context.state).level == "wave"


def test_a_curve_is_kept_for_its_plan(page: Any, context: Context, qtbot: QtBot) -> None:
    page.measure()
    idle(context.jobs, qtbot)
    context.project.update("planes", plan=replace(small_plan(), depths_um=small_plan().depths_um[:1], exposure_s=0.01))
    idle(context.jobs, qtbot)
    assert not len(page.panel.curve.scatter.data) and page.panel.curve.measure_button.text() == "Measure"
    context.project.undo()
    idle(context.jobs, qtbot)
    assert len(page.panel.curve.scatter.data) == len(POINTS)
    assert page.panel.curve.measure_button.text() == "Measure again"


def test_measured_points_stay(page: Any, context: Context, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> None:
    go_on = threading.Event()
    measured_by(monkeypatch, lambda: course(go_on))
    page.measure()
    qtbot.waitUntil(lambda: len(page.panel.curve.scatter.data) == 2, timeout=GUARD_MS)
    number = context.jobs.jobs()[0].number
    context.jobs.cancel(number)
    assert context.jobs.jobs()[0].state is JobState.CANCELLED, "it writes nothing: no point is waited for"
    go_on.set()
    idle(context.jobs, qtbot)
    assert len(page.panel.curve.scatter.data) == 2 and page.panel.curve.measure_button.isEnabled()


def test_a_long_measurement_is_asked_for_twice(page: Any, context: Context, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulate_page, "asked_seconds", lambda plan: 100.0)
    page.measure()
    assert not context.jobs.busy and page.panel.curve.status.text() == "This takes about 1 min 40 s."
    page.panel.curve.measure_button.click()
    assert context.jobs.busy


def test_the_pattern_says_which_engine_computed_it(page: Any, context: Context, qtbot: QtBot) -> None:
    page._set("tolerance", 0.02)
    idle(context.jobs, qtbot)
    z, y, x = page.panel.place.place
    found = pattern_of(small_plan(), (z, y, x), page.verdict.found, "auto", 0.02)
    assert page.panel.view.shot.pixel_um == 5.5
    assert page.panel.view.shot.caption == found.caption and f"y {y}, x {x}: grid, 5 samples/px" in found.caption
    whole = simulate_psf(small_plan(), page.verdict.found, tolerance=0.02)
    np.testing.assert_allclose(page.panel.view.values, whole[z, y, x], atol=1e-7)
    assert whole.provenance["simulated"]["planes"][z]["engine"] == "grid"


def test_effects_say_what_they_cost_and_the_largest_unknown_ones_are_named(page: Any) -> None:
    """Time of H with and without it; the share of the image without it is in its row."""
    row = page.verdict.row("lenslet_diffraction")
    planned = page.verdict.found.row("lenslet_diffraction")
    assert row.on and planned.seconds_with > planned.seconds_without > 0
    tip = page.panel.table._items[row.name].toolTip(0)
    before, after = format_seconds(planned.seconds_without), format_seconds(planned.seconds_with)
    assert f"Processor time of H: {after} with it, {before} without it" in tip
    assert "Processor time of H: free" in page.panel.table._items["lens_types"].toolTip(0)
    rows = sorted((row for row in page.verdict.rows if row.group == "unknown"), key=lambda row: -row.share)
    text = page.panel.unknown.text()
    first, second = (f"{row.title}, up to {row.share_text()}" for row in rows[:2])
    assert text.startswith(f"Not described: {first} of the image; {second}; ")
    tip = page.panel.unknown.toolTip()
    assert rows[0].title in tip and "lfcal plan camera.json --depths=" in tip and "lfcal white white.tif" in tip
    assert page.panel.table.groups["unknown"].text(0) == f"Off, not described: {len(rows)}"


lfcal = conftest.lfcal


@pytest.fixture
def measuring(window: MainWindow, qtbot: QtBot, tmp_path: Path) -> Iterator[Any]:
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


def test_one_click_plans_the_printed_bead_frames(measuring: Any, qtbot: QtBot, lfcal: Any, tmp_path: Path) -> None:
    """The plan can be saved, and used: its positions for recording, its unknowns for the fit, with one undo."""
    idle(measuring.context.jobs, qtbot)
    beads, before = measuring.dialog.beads, measuring.context.state
    assert f"{len(beads.made.plan.held_out)} held out" in measuring.dialog.planned.text()
    measuring.save_beads(str(tmp_path / "beads.json"))
    planned, fitted = (shlex.split(command) for command in beads.measurement.commands_for("bench")[:2])
    assert planned[:3] == ["lfcal", "plan", "bench"] and fitted[:3] == ["lfcal", "plan", "fit"]
    saved = ScanPlan.from_json((tmp_path / "beads.json").read_text())
    depths = planned[3].partition("=")[2].split(",")
    assert saved.depths_um == pytest.approx(list(map(float, depths))) and saved.cutout == before.plan.cutout
    done = lfcal(*(str(tmp_path / word) if word.endswith(".json") else word for word in fitted[1:]))
    assert done.code == 0, done.err
    chosen = (tmp_path / "positions.json").read_text()
    assert json.loads((tmp_path / "beads_positions.json").read_text()) == json.loads(chosen)
    assert measuring.context.history.taken[-1].step.arguments[:2] == ("plan", "fit")
    measuring.dialog.use_button.click()
    state = measuring.context.state
    assert measuring.dialog is None and state.plan == saved != before.plan
    settings = AcquireSettings.of(state)
    settings.options()
    assert len(RedoList.read(Path(settings.positions)).positions) == beads.measurement.frames
    assert not FitSettings.of(state).auto and FitSettings.of(state).unknowns == beads.measurement.unknowns
    measuring.context.project.undo()
    assert (measuring.context.state.plan, measuring.context.state.settings) == (before.plan, before.settings)


def test_other_measurements_lead_to_their_place(measuring: Any, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    monkeypatch.setattr(QFileDialog, "getOpenFileName", lambda *given: (asked.append(given[1]), ("", ""))[1])
    measuring.dialog.white_button.click()
    assert asked == ["White image"] and measuring.dialog is None
    measuring.measure_effects()
    measuring.dialog.values_button.click()
    (stated,) = [one for one in measuring.verdict.missing.measurements if not one.frames]
    assert measuring.panel.table.selected == stated.rows[0].name and measuring.dialog is None
    idle(measuring.context.jobs, qtbot)


def test_a_dialog_of_another_plan_is_closed(measuring: Any, qtbot: QtBot) -> None:
    measuring.context.project.update("no plan", plan=None)
    assert measuring.dialog is None


def test_chosen_effects_are_simulated(open_page: Any, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    small = replace(small_plan(), period=(3, 4))
    context.project.update("plan", plan=small)
    page, said = open_page("simulate", 640), list[str]()
    idle(context.jobs, qtbot)
    panel, table = page.panel, page.panel.table
    assert sum(group.childCount() for group in table.groups.values()) == len(page.verdict.rows) > 20
    assert panel.view.values.shape == (41, 41)
    click(table, "bandwidth", qtbot)
    assert dict(SimulateSettings.of(context.state).overrides)["bandwidth"] == "on"
    idle(context.jobs, qtbot)
    assert page.verdict.row("bandwidth").on and table._items["bandwidth"].parent() is table.groups["on"]
    table.select("bandwidth")
    assert panel.tabs.currentWidget() is panel.effect
    assert panel.effect.title.text() == "bandwidth" and "switched on" in panel.effect.why.text()
    context.project.undo()
    idle(context.jobs, qtbot)
    assert not page.verdict.row("bandwidth").on and table.selected == "bandwidth"
    page._set("tolerance", 0.5)
    idle(context.jobs, qtbot)
    level = panel.forms[1].editor("level")
    level.setCurrentIndex(level.findData("geometric"))
    idle(context.jobs, qtbot)
    context.message.connect(said.append)
    with qtbot.waitSignal(context.jobs.finished, timeout=GUARD_MS) as end:
        page.simulate(str(tmp_path / "sim.h5"))
    assert end.args[0].state is JobState.DONE, end.args[0].error
    assert context.state.psf == str(tmp_path / "sim.h5")
    (told,) = (words for words in said if "sim.h5" in words and words.startswith("simulated"))
    assert "planes 0 to 1: geometric, rays integrated over the pixels; " in told
    assert "of processor time; error at most" in told
    with open_psf(tmp_path / "sim.h5") as H:
        assert H.shape == small.shape
