"""The quality reports of the gallery over time: what got worse, and its curve."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pytestqt.qtbot import QtBot

from lfcal.base._plain import plain
from lfcal.judge.quality import inspect
from lfcal_gui.pages.sessions.model_trend import TrendCurve
from lfcal_gui.pages.sessions.page import Page
from tests.cli.test_trend_quality import dated, write
from tests.gui.conftest import OpenPage
from tests.gui.waiting import idle
from tests.judge.test_report import matrix


@pytest.fixture(scope="module")
def record() -> dict[str, Any]:
    """Return an inspection as its file holds it."""
    found: dict[str, Any] = json.loads(json.dumps(plain(inspect(matrix()).to_dict())))
    return found


@pytest.fixture
def reports(tmp_path: Path, record: dict[str, Any]) -> Path:
    """Write three inspections, the newest with a lamp that drifts and a fault."""
    for month, lamp in ((5, (1.0, "good")), (6, (2.0, "good")), (7, (3.5, "fair"))):
        write(tmp_path / f"m{month}", record, month, lamp, {"ghost image": 0.02} if month == 7 else {})
    return tmp_path


def looked(page: Page, folder: Path, qtbot: QtBot) -> None:
    page.choose(str(folder))
    page.panel.setCurrentWidget(page.panel.trend)
    idle(page.context.jobs, qtbot)


def test_what_got_worse_comes_first_with_its_course(open_page: OpenPage, qtbot: QtBot, reports: Path) -> None:
    page: Page = open_page("sessions")
    panel, trending = page.panel.trend, page.trending
    assert not panel.picture_button.isEnabled()
    looked(page, reports, qtbot)
    assert panel.verdict.text().startswith("Worse than before: ghost image") and "3 sessions" in panel.notes.text()
    first = [panel.table.item(0, k).text() for k in range(5)]  # type: ignore[union-attr]
    assert first[0].lower().startswith("ghost image") and first[-1] == "worse"
    row = next(k for k in range(panel.table.rowCount()) if "Lamp" in panel.table.item(k, 0).text())  # type: ignore[union-attr]
    panel.table.selectRow(row)
    x, y = panel.curve._curves["value"].getData()
    np.testing.assert_allclose(x, [0, 31, 61])
    np.testing.assert_allclose(y, [1, 2, 3.5])
    assert not any(panel.table.isColumnHidden(k) for k in range(5))
    assert panel.curve.plot.vb.viewRange()[1][0] == pytest.approx(0, abs=0.2)
    limits = {"limit of good values", "limit of bad values"}
    assert "Lamp" in panel.title.text() and panel.curve._curves.keys() == {*limits, "value"}
    assert panel.curve.plot.legend is not None and panel.curve._labels[0] == "days since the first session"
    trending.save_picture(str(reports / "trend.png"))
    idle(page.context.jobs, qtbot)
    assert (reports / "trend.png").stat().st_size > 1000


def test_the_filter_of_the_gallery_chooses_the_reports(open_page: OpenPage, qtbot: QtBot, reports: Path) -> None:
    page: Page = open_page("sessions")
    looked(page, reports, qtbot)
    page.panel.words.setText("m7")
    idle(page.context.jobs, qtbot)
    assert (
        "expected two or more, got 1" in page.panel.trend.message.text() and page.panel.trend.stack.currentIndex() == 0
    )
    page.panel.words.setText("")
    idle(page.context.jobs, qtbot)
    assert page.panel.trend.stack.currentIndex() == 1


def test_values_of_one_day_have_no_change_per_month(
    open_page: OpenPage, qtbot: QtBot, tmp_path: Path, record: dict[str, Any]
) -> None:
    write(tmp_path / "a", record, 5, (1.0, "good"))
    dated(write(tmp_path / "b", record, 5, (None, "fair")), "2026-05-01T00:00:02+00:00")  # type: ignore[arg-type]
    dated(write(tmp_path / "c", record, 5, (3.5, "fair")), "2026-05-01T00:00:04+00:00")
    page: Page = open_page("sessions")
    looked(page, tmp_path, qtbot)
    panel = page.panel.trend
    texts = [[panel.table.item(row, k).text() for k in range(4)] for row in range(panel.table.rowCount())]  # type: ignore[union-attr]
    assert next(row for row in texts if "Lamp" in row[0])[1:] == ["fair", "3.5 fair", "within 4.0 s"]
    assert {row[3] for row in texts if "Lamp" not in row[0]} == {""}, "what did not change"
    panel.table.selectRow(next(k for k, row in enumerate(texts) if "Lamp" not in row[0]))
    np.testing.assert_allclose(panel.curve._curves["value"].getData()[0], [0, 2, 4])
    assert panel.curve._labels[0] == "seconds since the first session", "all were at day 0"
    assert (
        "3 sessions, 2026-05-01." in panel.notes.text() and "A change per month is not estimated" in panel.notes.text()
    )


def test_columns_without_values_are_hidden_and_a_count_of_none_begins_at_zero(
    open_page: OpenPage, qtbot: QtBot, tmp_path: Path, record: dict[str, Any]
) -> None:
    for month in (5, 6):
        write(tmp_path / f"m{month}", record, month, (1.0, "good"))
    page: Page = open_page("sessions")
    looked(page, tmp_path, qtbot)
    panel = page.panel.trend
    assert [panel.table.isColumnHidden(k) for k in range(5)] == [False, False, False, True, True]
    panel.show_curve(TrendCurve("Missing frames (frames)", np.array([0.0, 31.0]), np.zeros(2), 0.0, 0.0))
    assert panel.curve._curves.keys() == {"limit of good and bad values", "value"}
    low, high = panel.curve.plot.vb.viewRange()[1]
    assert low == pytest.approx(0, abs=0.05) and high == pytest.approx(1, abs=0.05)
