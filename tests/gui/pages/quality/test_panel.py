from __future__ import annotations

import numpy as np
from pytestqt.qtbot import QtBot

from lfcal_gui.pages.quality.inspect_panel import InspectPanel
from lfcal_gui.pages.quality.model import FaultRow, MetricRow


def test_the_first_metric_of_a_second_report_is_explained_too(qtbot: QtBot) -> None:
    """The row chosen stays the same, but it shows another report."""
    panel = InspectPanel()
    qtbot.addWidget(panel)
    chosen: list[int] = []
    panel.metric_chosen.connect(chosen.append)
    rows = tuple(MetricRow(k, k, "1", "< 2", "> 3", "good", "good", "–") for k in ("first", "second"))
    panel.show_all("good", "good", "", (), rows)
    panel.show_all("bad", "bad", "", (), rows[::-1])
    assert chosen == [0, 0] and panel.table.currentRow() == 0
    panel.table.selectRow(1)
    assert chosen == [0, 0, 1]


def test_one_thing_is_looked_at_at_a_time(qtbot: QtBot) -> None:
    """A fault is chosen first; choosing a metric lets go of it, and the other way round."""
    panel = InspectPanel()
    qtbot.addWidget(panel)
    seen: list[tuple[str, int]] = []
    panel.fault_chosen.connect(lambda row: seen.append(("fault", row)))
    panel.metric_chosen.connect(lambda row: seen.append(("metric", row)))
    faults = tuple(FaultRow(k, "what", "8 %", "> 99.9 %", "bad") for k in "ab")
    panel.show_all("bad", "bad", "", faults, (MetricRow("m", "m", "1", "", "", "good", "good", "–"),))
    panel.table.selectRow(0)
    assert not panel.faults.selectedIndexes()
    panel.faults.selectRow(1)
    assert not panel.table.selectedIndexes() and seen == [("fault", 0), ("metric", 0), ("fault", 1)]


def test_faults_sorted_by_hand_still_show_their_own(qtbot: QtBot) -> None:
    panel = InspectPanel()
    qtbot.addWidget(panel)
    seen: list[int] = []
    panel.fault_chosen.connect(seen.append)
    faults = tuple(FaultRow(k, "what", "8 %", "> 99.9 %", "bad") for k in "ba")
    panel.show_all("bad", "bad", "", faults, ())
    panel.faults.clearSelection()
    panel.faults.sortItems(0)
    panel.faults.selectRow(0)
    assert seen == [0, 1], "'a' was given as the second"


def test_a_map_of_displacements_is_numbered_from_its_origin(qtbot: QtBot) -> None:
    panel = InspectPanel()
    qtbot.addWidget(panel)
    evidence = panel.evidence
    evidence.show_image("Left", ("down (px)", "across (px)"), "%", np.eye(5), origin=(-2, -2))
    assert evidence.image.shot.origin == (-2, -2)
    evidence.show_image("Sensor", ("row (px)", "column (px)"), "counts", np.eye(5))
    assert evidence.image.shot.origin == (0, 0), "the next one starts at 0 again"
