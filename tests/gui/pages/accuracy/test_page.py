"""The Accuracy page: the chart fills, is stopped and keeps what it has; a click uses a point."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import QPointF, Qt
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from lfcal.accuracy import PARTS, AccuracyPart, AccuracyStep, CostPoint, Subject, Truth
from lfcal.psf import PSFMatrix, save
from lfcal_gui.context import Context
from lfcal_gui.models.page import PageState
from lfcal_gui.models.project import ProjectState
from lfcal_gui.pages.accuracy import PAGE
from lfcal_gui.pages.accuracy.page import Page
from lfcal_gui.theme import DARK, apply_theme
from tests.acquire.rigs import small_plan
from tests.gui.conftest import OpenPage
from tests.gui.waiting import GUARD_MS, idle


@pytest.fixture
def state() -> ProjectState:
    return replace(ProjectState(), plan=small_plan())


@pytest.fixture
def page(open_page: OpenPage) -> Page:
    made: Page = open_page("accuracy", height=640)
    return made


MEASURED: list[Any] = []
"""What measuring the part `bases` yields, once it was measured."""


@pytest.fixture(autouse=True)
def _measured_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the first test that needs the part `bases` measure it; the others see the same course again."""
    real = PARTS.get("bases")

    def measure(subject: Subject, tolerance: float) -> Iterator[Any]:
        if MEASURED:
            yield from MEASURED
            return
        course = []
        for record in real.measure(subject, tolerance):
            course.append(record)
            yield record
        MEASURED[:] = course

    told = replace(real, measure=measure)
    parts = SimpleNamespace(get=lambda name: told if name == "bases" else PARTS.get(name))
    monkeypatch.setattr("lfcal.accuracy.PARTS", parts)


def look_at(page: Page, name: str) -> None:
    parts = page.panel.parts
    row = next(k for k in range(parts.count()) if parts.item(k).data(Qt.ItemDataRole.UserRole) == name)
    parts.setCurrentRow(row)


def points(page: Page) -> list[tuple[float, float]]:
    found = page.panel.chart.scatter.data
    # in the order of the points, whatever is drawn first
    rows = sorted(zip(found["data"].tolist(), found["x"].tolist(), found["y"].tolist(), strict=True))
    return [(x, y) for _, x, y in rows]


def click(page: Page, number: int, qtbot: QtBot) -> None:
    """Click with the mouse on a point."""
    chart = page.panel.chart
    QApplication.processEvents()  # the view takes its range when it is laid out
    x, y = points(page)[number]
    at = chart.graphics.mapFromScene(chart.plot.vb.mapViewToScene(QPointF(x, y)))
    qtbot.mouseClick(chart.graphics.viewport(), Qt.MouseButton.LeftButton, pos=at)


def test_a_part_is_measured_drawn_and_answered(page: Page, qtbot: QtBot) -> None:
    look_at(page, "bases")
    assert page.panel.answer.text() == "Not measured yet: press Measure." and not points(page)
    page.measure_button.click()
    assert page.stop_button.isEnabled() and not page.measure_button.isEnabled()
    idle(page.context.jobs, qtbot)
    assert page.curve is not None and len(points(page)) == len(page.curve.points) == 16
    x, y = np.array(points(page)).T
    np.testing.assert_allclose(10**x, [r.cost for r in page.curve.points])
    np.testing.assert_allclose(10**y, [100 * r.error for r in page.curve.points])
    front = np.transpose(page.panel.chart.front.getData())
    np.testing.assert_allclose(10 ** front[:, 1], [100 * r.error for r in page.curve.front])
    assert page.panel.answer.text() == page.curve.answer(0.01)
    assert page.measure_button.isEnabled() and not page.stop_button.isEnabled()
    axis = page.panel.chart.plot.getAxis("left")
    ((_, ticks),) = axis.tickValues(0.0, 2.0, 400)
    assert axis.tickStrings(ticks, 1, 1) == ["1", "2", "5", "10", "20", "50", "100"]
    ((_, ticks),) = axis.tickValues(-7.2, 1.0, 400)
    assert axis.tickStrings(ticks, 1, 1)[-1] == "1" and 4 <= len(ticks) <= 8
    look_at(page, "storage")
    assert not points(page) and page.panel.answer.text().startswith("Not measured yet")
    look_at(page, "bases")
    assert len(points(page)) == 16, "what was measured stays"


def test_another_error_is_answered_at_once(page: Page, qtbot: QtBot) -> None:
    look_at(page, "bases")
    page.measure()
    idle(page.context.jobs, qtbot)
    editor: Any = page.panel.form.editor("error")
    editor.setText("30")
    editor.textEdited.emit("30")
    assert page.settings.error == 0.3 and page.curve is not None
    assert page.panel.answer.text() == page.curve.answer(0.3)
    assert page.panel.chart.limit.value() == pytest.approx(np.log10(30))
    editor.editingFinished.emit()
    editor.setText("0")
    editor.textEdited.emit("0")
    assert editor.property("invalid") and page.settings.error == 0.3


def endless() -> Iterator[Any]:
    yield Truth("exact")
    k = 0
    while True:
        k += 1
        yield AccuracyStep("next", 0.0)
        yield CostPoint(f"point {k}", {"k": k}, 1 / k, float(k), "seconds")


def test_it_fills_while_it_is_measured_and_keeps_what_it_has(
    page: Page, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = AccuracyPart("bases", "Bases", "error", "cost", "seconds", lambda s, t: endless())  # type: ignore[arg-type]
    monkeypatch.setattr("lfcal.accuracy.PARTS", SimpleNamespace(get=lambda name: made))
    look_at(page, "bases")
    page.activateWindow()
    qtbot.waitUntil(page.isActiveWindow, timeout=GUARD_MS)
    qtbot.mouseClick(page.measure_button, Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: len(points(page)) > 3, timeout=GUARD_MS)
    assert "measuring …" in page.panel.how.text()
    focus = QApplication.focusWidget()  # the button that was pressed is grey by now
    assert focus is not None
    qtbot.keyClick(focus, Qt.Key.Key_Escape)
    idle(page.context.jobs, qtbot)
    count = len(points(page))
    assert page.curve is not None and count == len(page.curve.points) > 3
    assert "measuring" not in page.panel.how.text() and page.panel.answer.text() == page.curve.answer(0.01)


def test_stop_says_that_it_stops(page: Page, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> None:
    made = AccuracyPart("bases", "Bases", "error", "cost", "seconds", lambda s, t: endless())  # type: ignore[arg-type]
    monkeypatch.setattr("lfcal.accuracy.PARTS", SimpleNamespace(get=lambda name: made))
    look_at(page, "bases")
    page.measure()
    qtbot.waitUntil(lambda: len(points(page)) > 1, timeout=GUARD_MS)
    page.stop()
    assert page.stop_button.text() == "Stopping …"
    idle(page.context.jobs, qtbot)
    assert page.stop_button.text() == "Stop" and not page.stop_button.isEnabled()


def test_a_click_uses_a_point_and_undo_takes_it_back(page: Page, context: Context, qtbot: QtBot) -> None:
    look_at(page, "averaging")
    page.measure()
    idle(page.context.jobs, qtbot)
    assert page.curve is not None
    before = context.state.plan
    number = next(k for k, r in enumerate(page.curve.points) if r.settings["frames_averaged"] == 8)
    wanted = page.curve.points[number].settings
    click(page, number, qtbot)
    plan = context.state.plan
    assert plan is not None and (plan.frames_averaged, list(plan.exposures)) == (8, wanted["exposure_s"])
    assert "Plan: 8 frames averaged" in page.panel.used.text() and page.panel.used.isVisible()
    assert points(page), "the curve that it was chosen from stays"
    context.project.undo()
    assert context.state.plan == before


def test_a_point_that_cannot_be_used_says_so_and_changes_nothing(page: Page, context: Context, qtbot: QtBot) -> None:
    look_at(page, "storage")
    page.measure()
    idle(page.context.jobs, qtbot)
    before = context.state
    assert page.curve is not None
    unusable = next(k for k, point in enumerate(page.curve.points) if point.settings["dtype"] in ("float16", "float64"))
    click(page, unusable, qtbot)
    assert context.state == before and "Nothing was changed" in page.panel.used.text()
    page.use(999)
    look_at(page, "bases")
    assert not page.panel.used.isVisible()


def test_another_plan_forgets_the_curves(page: Page, context: Context, qtbot: QtBot) -> None:
    look_at(page, "bases")
    page.measure()
    idle(page.context.jobs, qtbot)
    context.project.update("plan", plan=small_plan(planes=1))
    assert not points(page) and page.curve is None


def test_h_is_measured_where_there_is_no_plan(page: Page, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    save(PSFMatrix(np.random.default_rng(0).random((1, 2, 2, 3, 3)).astype(np.float32)), tmp_path / "H.h5")
    context.project.update("H", plan=None, psf=str(tmp_path / "H.h5"))
    assert page.settings.subject == "psf"
    box: Any = page.panel.form.editor("subject")
    assert not box.model().item(box.findData("plan")).isEnabled()
    look_at(page, "lattice")
    page.measure()
    idle(page.context.jobs, qtbot)
    assert page.panel.answer.text().startswith(
        "Not measured: scan of the measurement: expected a scan plan with its camera"
    )


def test_nothing_to_measure_says_what_to_do(page: Page, context: Context) -> None:
    context.project.update("no plan", plan=None)
    assert page.empty is not None and "Make a plan first, or open an H file" in page.empty.label.text()
    page.measure()
    assert not context.jobs.jobs()
    assert PAGE.state(context.state) is PageState.NOTHING
    assert PAGE.state(replace(context.state, plan=small_plan())) is PageState.READY


def test_a_damaged_h_is_said(page: Page, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    (tmp_path / "H.h5").write_bytes(b"no hdf5")
    context.project.update("H", plan=None, psf=str(tmp_path / "H.h5"))
    page.measure()
    idle(page.context.jobs, qtbot)
    assert "HDF5" in page.notice.label.text() and page.measure_button.isEnabled()


def test_both_themes_and_a_saved_table(page: Page, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    look_at(page, "bases")
    page.measure()
    idle(page.context.jobs, qtbot)
    app = QApplication.instance()
    assert isinstance(app, QApplication)
    apply_theme(app, DARK)
    context.theme_changed.emit()
    assert page.panel.chart.front.opts["pen"].color().name() == DARK.accent
    page.panel.chart.save_data(str(tmp_path / "a.csv"))
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert page.curve is not None and len(lines) == 1 + len(page.curve.points)
    cost, error = (float(v) for v in lines[1].split(",")[:2])
    assert (cost, error) == (
        pytest.approx(page.curve.points[0].cost),
        pytest.approx(100 * page.curve.points[0].error),
    )
