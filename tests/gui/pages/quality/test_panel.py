from __future__ import annotations

from pytestqt.qtbot import QtBot

from gui.pages.quality.model import MetricRow
from gui.pages.quality.panel import QualityPanel


def test_the_first_metric_of_a_second_report_is_explained_too(qtbot: QtBot) -> None:
    """The row chosen stays the same, but it shows another report."""
    panel = QualityPanel()
    qtbot.addWidget(panel)
    chosen: list[int] = []
    panel.metric_chosen.connect(chosen.append)
    rows = tuple(MetricRow(k, k, "1", "< 2", "good", "–") for k in ("first", "second"))
    panel.show_rows("good", rows, 2)
    panel.show_rows("bad", rows[::-1], 1)
    assert chosen == [0, 0] and panel.table.currentRow() == 0
    panel.table.selectRow(1)
    assert chosen == [0, 0, 1]
