from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from pytestqt.qtbot import QtBot

import lfcal_gui.pages.simulate.page as simulate_page
from lfcal.base.progress import Progress
from lfcal.camera import ScanPlan
from lfcal.psf import open_psf
from lfcal.simulate.accuracy._ladder import Ladder, LadderProgress, LadderRung
from lfcal_gui.context import Context
from lfcal_gui.jobs import JobState
from lfcal_gui.pages.simulate._share_bar import TEXT
from lfcal_gui.pages.simulate.model import SimulateSettings, preview, tolerance_of
from lfcal_gui.pages.simulate.model_effects import EffectsVerdict, verdict_of
from lfcal_gui.window import MainWindow
from tests.gui.pages.simulate.test_model import small_plan
from tests.gui.waiting import GUARD_MS, idle


def test_simulate_both_ways(window: MainWindow, qtbot: QtBot, tmp_path: Path) -> None:
    small = replace(small_plan(), period=(3, 4))
    window.project.update("plan", plan=small)
    window.go("simulate")
    page: Any = window.page("simulate")
    idle(window.jobs, qtbot)
    table = page.panel.table
    assert sum(table.topLevelItem(k).childCount() for k in range(table.topLevelItemCount())) == len(page.verdict.rows)
    assert len(page.verdict.rows) > 20
    assert page.panel.view.values is None, "nobody looks at the response"
    page.panel.tabs.setCurrentIndex(1)
    idle(window.jobs, qtbot)
    assert page.panel.view.values is not None and page.panel.view.values.shape == (41, 41)
    box = table.setting_box("bandwidth")
    box.setCurrentIndex(box.findData("on"))
    box.activated.emit(box.currentIndex())
    assert dict(SimulateSettings.of(window.project.state).overrides)["bandwidth"] == "on"
    idle(window.jobs, qtbot)
    assert page.verdict.row("bandwidth").on and table.setting_box("bandwidth") is box and box.currentData() == "on"
    table.select("bandwidth")
    assert page.panel.effect.title.text() == "bandwidth" and "asked for" in page.panel.effect.why.text()
    window.project.undo()
    idle(window.jobs, qtbot)
    assert not page.verdict.row("bandwidth").on
    page.panel.tolerance_slider.setValue(page.panel.tolerance_slider.minimum())
    assert SimulateSettings.of(window.project.state).tolerance == tolerance_of(0)
    page.panel.tolerance_slider.setValue(page.panel.tolerance_slider.maximum())
    idle(window.jobs, qtbot)
    level = page.panel.forms[0].editor("level")
    level.setCurrentIndex(level.findData("geometric"))
    idle(window.jobs, qtbot)
    with qtbot.waitSignal(window.jobs.finished, timeout=GUARD_MS) as end:
        page.simulate(str(tmp_path / "sim.h5"))
    assert end.args[0].state is JobState.DONE, end.args[0].error
    assert window.project.state.psf == str(tmp_path / "sim.h5")
    with open_psf(tmp_path / "sim.h5") as H:
        assert H.shape == small.shape


@pytest.fixture
def answer(window: MainWindow) -> Iterator[threading.Event]:
    """Return what a slow planner waits for; the window cannot close before."""
    event = threading.Event()
    yield event
    event.set()


def test_before_the_planner_answers_nothing_uses_its_last_answer(
    window: MainWindow, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, answer: threading.Event
) -> None:
    window.project.update("plan", plan=replace(small_plan(), resample=False))
    window.go("simulate")
    page: Any = window.page("simulate")
    level = page.panel.forms[0].editor("level")
    level.setCurrentIndex(level.findData("geometric"))
    page.panel.tabs.setCurrentIndex(1)
    idle(window.jobs, qtbot)
    asked: list[tuple[tuple[str, ...], str]] = []

    def slow_planner(plan: ScanPlan, settings: SimulateSettings) -> EffectsVerdict:
        answer.wait()
        return verdict_of(plan, settings)

    def watched(plan: ScanPlan, z: float, effects: tuple[Any, ...], level: str, tolerance: float) -> Any:
        asked.append((tuple(e.name for e in effects), level))
        return preview(plan, z, effects, level, tolerance)

    monkeypatch.setattr(simulate_page, "verdict_of", slow_planner)
    monkeypatch.setattr(simulate_page, "preview", watched)
    assert "vignetting" not in {e.name for e in page.verdict.found}
    page.panel.choice_asked.emit("vignetting", "on")
    with qtbot.waitSignal(window.jobs.finished, timeout=GUARD_MS) as end:
        page.simulate(str(tmp_path / "sim.h5"))
    assert end.args[0].state is JobState.DONE, end.args[0].error
    with open_psf(tmp_path / "sim.h5") as H:
        assert "vignetting" in {effect["name"] for effect in H.provenance["simulated"]["effects"]}
    page.panel.z_slider.setValue(30)
    qtbot.waitUntil(lambda: bool(asked), timeout=GUARD_MS)
    answer.set()
    idle(window.jobs, qtbot)
    assert asked[0] == ((), "geometric"), "rays, which need no planner"
    assert all("vignetting" in names for names, _ in asked[1:]) and len(asked) > 1


def test_without_a_plan_no_button_is_dead(open_page: Any, context: Context) -> None:
    page = open_page("simulate")
    for press in (page.simulate, page.simulate_frames, page.ladder):
        page.notice.clear()
        press()
        assert "no scan plan" in page.notice.label.text()


def test_the_curve_of_accuracy_has_points_and_no_line_between_engines(open_page: Any, context: Context) -> None:
    context.project.update("plan", plan=small_plan())
    page = open_page("simulate")
    rung = SimpleNamespace(label="wave, 2 nodes", whole_seconds=4.0, error=0.02)
    others = [SimpleNamespace(label="rays", whole_seconds=0.2, error=0.4), SimpleNamespace(whole_seconds=9.0, error=0)]
    page.panel.show_ladder(SimpleNamespace(rungs=[rung, *others], chosen=rung))
    curve = page.panel.curve
    assert all(item.opts["pen"] is None for item in curve._curves.values()) and len(curve._curves) == 2
    x, y = curve._curves["measured"].getOriginalDataset()
    assert x.tolist() == [4.0, 0.2] and y.tolist() == [2.0, 40.0]
    axis = curve.plot.getAxis("bottom")
    (_, ticks), *_ = axis.tickValues(-1.0, 1.0, 300)
    assert "0.1" in axis.tickStrings(ticks, 1.0, 1.0) and "page Accuracy" in page.panel.curve_hint.text()


def test_rungs_that_were_measured_stay_when_measuring_is_stopped(
    open_page: Any, context: Context, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The curve was empty until all were done, and those that were done were lost."""
    plan = small_plan()
    rung = LadderRung("geometric", None, "geometric", 0.4, 0.0, 0.1, 0.2)
    found = Ladder((rung,), (), 0.05, "reference", 10.0, 4.0, 1)
    go_on = threading.Event()

    def measuring(*_: Any) -> Any:
        yield Progress(0, 3, "reference")
        yield LadderProgress(1, 3, "geometric", 1.0, ladder=replace(found, rungs=()))
        yield LadderProgress(2, 3, "wave", 2.0, ladder=found)
        go_on.wait(GUARD_MS / 1e3)
        yield LadderProgress(3, 3, "wave", 3.0, ladder=found)

    monkeypatch.setattr("lfcal.simulate.iter_ladder", measuring)
    context.project.update("plan", plan=plan)
    page = open_page("simulate")
    page.ladder()
    curve = page.panel.curve
    qtbot.waitUntil(lambda: "measured" in curve._curves, timeout=GUARD_MS)
    number = context.jobs.jobs()[0].number
    context.jobs.cancel(number)
    assert context.jobs.jobs()[0].state is JobState.CANCELLED, "it writes nothing: no rung is waited for"
    qtbot.waitUntil(lambda: not context.jobs.busy, timeout=GUARD_MS)
    go_on.set()
    assert curve._curves["measured"].getOriginalDataset()[0].tolist() == [0.2]
    assert "geometric: 40 % error" in page.panel.curve_hint.text()


def test_nothing_is_cut_in_the_table_of_effects_in_a_small_window(window: MainWindow, qtbot: QtBot) -> None:
    """Verdicts ended in an ellipsis: they repeated the column beside them."""
    window.resize(1280, 800)
    window.project.update("plan", plan=small_plan())
    window.go("simulate")
    page: Any = window.page("simulate")
    idle(window.jobs, qtbot)
    table = page.panel.table
    metrics, header = table.fontMetrics(), table.header()
    for name in (row.name for row in page.verdict.rows):
        item = table._items[name]
        for column in (0, 2, 4):
            indent = 2 * table.indentation() if column == 0 else 0
            assert metrics.horizontalAdvance(item.text(column)) + indent + 6 <= table.columnWidth(column), item.text(
                column
            )
        assert metrics.horizontalAdvance(item.text(3)) <= TEXT
    for column in range(table.columnCount()):
        assert header.sectionSizeHint(column) <= header.sectionSize(column), table.headerItem().text(column)
    longest = max((row.brief_text() for row in page.verdict.rows), key=len)
    assert len(longest) < 20 and "%" not in longest
