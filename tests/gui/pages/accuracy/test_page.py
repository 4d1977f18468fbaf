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

from lfcal.accuracy import PARTS, AccuracyPart, AccuracyStep, CostPoint, Curve, Subject, Truth
from lfcal.psf import PSFMatrix, save
from lfcal_gui.context import Context
from lfcal_gui.models import PageState, ProjectState
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


def test_another_error_is_answered_at_once(page: Page, qtbot: QtBot) -> None:
    found, editor = measure(page, "bases", qtbot), page.panel.form.editor("error")
    for text, taken in (("30", 0.3), ("0", 0.3)):
        editor.setText(text)
        editor.textEdited.emit(text)
        assert page.settings.error == taken and bool(editor.property("invalid")) is (text == "0")
        editor.editingFinished.emit()
    assert page.panel.answer.text() == found.answer(0.3)
    assert page.panel.chart.limit.value() == pytest.approx(np.log10(30))


def endless() -> Iterator[Any]:
    yield Truth("exact")
    k = 0
    while True:
        k += 1
        yield AccuracyStep("next", 0.0)
        yield CostPoint(f"point {k}", {"k": k}, 1 / k, float(k), "seconds")


def test_a_click_uses_a_point_and_undo_takes_it_back(page: Page, context: Context, qtbot: QtBot) -> None:
    found, before = measure(page, "averaging", qtbot), context.state.plan
    number = next(k for k, r in enumerate(found.points) if r.settings["frames_averaged"] == 8)
    click(page, number, qtbot)
    plan = context.state.plan
    assert plan.frames_averaged == 8
    assert list(plan.exposures) == found.points[number].settings["exposure_s"]
    assert "Plan: 8 frames averaged" in page.panel.used.text() and page.panel.used.isVisible()
    assert points(page), "the curve that it was chosen from stays"
    context.project.undo()
    assert context.state.plan == before


def test_a_point_that_cannot_be_used_says_so_and_changes_nothing(page: Page, context: Context, qtbot: QtBot) -> None:
    found, before = measure(page, "storage", qtbot), context.state
    click(page, next(k for k, r in enumerate(found.points) if r.settings["dtype"] in ("float16", "float64")), qtbot)
    assert context.state == before and "Nothing was changed" in page.panel.used.text()
    page.use(999)
    look_at(page, "bases")
    assert not page.panel.used.isVisible()


def test_nothing_to_measure_says_what_to_do(page: Page, context: Context) -> None:
    context.project.update("no plan", plan=None)
    assert page.empty is not None and "Make a plan first, or open an H file" in page.empty.label.text()
    page.measure()
    assert not context.jobs.jobs()
    assert PAGE.state(context.state) is PageState.NOTHING
    assert PAGE.state(replace(context.state, plan=small_plan())) is PageState.READY


def measure(page: Page, name: str, qtbot: QtBot) -> Curve:
    look_at(page, name)
    page.measure()
    idle(page.context.jobs, qtbot)
    assert page.curve is not None
    return page.curve


def test_a_part_is_measured_and_drawn(
    page: Page, context: Context, qtbot: QtBot, qapp: QApplication, tmp_path: Path
) -> None:
    panel, chart = page.panel, page.panel.chart
    look_at(page, "bases")
    assert panel.answer.text() == "Not measured yet: press Measure." and not points(page)
    page.measure_button.click()
    assert page.stop_button.isEnabled() and not page.measure_button.isEnabled()
    idle(context.jobs, qtbot)
    found = page.curve
    assert len(points(page)) == len(found.points) == 16
    x, y = np.array(points(page)).T
    np.testing.assert_allclose(10**x, [r.cost for r in found.points])
    np.testing.assert_allclose(10**y, [100 * r.error for r in found.points])
    np.testing.assert_allclose(10 ** np.transpose(chart.front.getData())[:, 1], [100 * r.error for r in found.front])
    assert panel.answer.text() == found.answer(0.01)
    assert page.measure_button.isEnabled() and not page.stop_button.isEnabled()
    axis = chart.plot.getAxis("left")
    ((_, ticks),) = axis.tickValues(0.0, 2.0, 400)
    assert axis.tickStrings(ticks, 1, 1) == ["1", "2", "5", "10", "20", "50", "100"]
    ((_, ticks),) = axis.tickValues(-7.2, 1.0, 400)
    assert axis.tickStrings(ticks, 1, 1)[-1] == "1" and 4 <= len(ticks) <= 8
    apply_theme(qapp, DARK)
    page.take_theme()
    assert chart.front.opts["pen"].color().name() == DARK.accent
    chart.save_data(str(tmp_path / "a.csv"))
    lines = (tmp_path / "a.csv").read_text().splitlines()
    cost, error = (float(v) for v in lines[1].split(",")[:2])
    assert len(lines) == 1 + len(found.points)
    assert (cost, error) == (pytest.approx(found.points[0].cost), pytest.approx(100 * found.points[0].error))
    look_at(page, "storage")
    assert not points(page) and panel.answer.text().startswith("Not measured yet")
    look_at(page, "bases")
    assert len(points(page)) == 16, "what was measured stays"
    context.project.update("plan", plan=small_plan(planes=1))
    assert not points(page) and page.curve is None, "it is of another plan"


def test_it_fills_while_it_is_measured_and_keeps_what_it_has_when_it_is_stopped(
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
    qtbot.keyClick(focus, Qt.Key.Key_Escape)
    assert page.stop_button.text() == "Stopping …"
    idle(page.context.jobs, qtbot)
    assert page.stop_button.text() == "Stop" and not page.stop_button.isEnabled()
    count = len(points(page))
    assert count == len(page.curve.points) > 3
    assert "measuring" not in page.panel.how.text() and page.panel.answer.text() == page.curve.answer(0.01)


def test_h_is_measured_where_there_is_no_plan_unless_it_is_damaged(page: Page, qtbot: QtBot, tmp_path: Path) -> None:
    save(PSFMatrix(np.random.default_rng(0).random((1, 2, 2, 3, 3)).astype(np.float32)), tmp_path / "H.h5")
    page.context.project.update("H", plan=None, psf=str(tmp_path / "H.h5"))
    assert page.settings.subject == "psf"
    box: Any = page.panel.form.editor("subject")
    assert not box.model().item(box.findData("plan")).isEnabled()
    measure(page, "lattice", qtbot)
    words = "Not measured: scan of the measurement: expected a scan plan with its camera"
    assert page.panel.answer.text().startswith(words)
    (tmp_path / "bad.h5").write_bytes(b"no hdf5")
    page.context.project.update("H", psf=str(tmp_path / "bad.h5"))
    page.measure()
    idle(page.context.jobs, qtbot)
    assert "HDF5" in page.notice.label.text() and page.measure_button.isEnabled()
