from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PySide6.QtWidgets import QApplication, QFileDialog, QMenu
from pytestqt.qtbot import QtBot

from lfcal_gui.widgets.period_map import PeriodMap


def offered(view: PeriodMap) -> dict[str, object]:
    view.customContextMenuRequested.emit(view.rect().center())
    (menu,) = (one for one in view.findChildren(QMenu) if one.isVisible())
    found = {action.text(): action for action in menu.actions()}
    menu.close()
    return found


def test_its_values_are_copied_and_saved(qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A map offered its picture alone."""
    view = PeriodMap()
    qtbot.addWidget(view)
    view.show()
    assert {"Copy values", "Save data …"} & offered(view).keys() == set(), "there are none yet"
    values = np.arange(6.0).reshape(2, 3) / 7
    view.set_values(values)
    actions = offered(view)
    actions["Copy values"].trigger()  # type: ignore[attr-defined]
    rows = [line.split("\t") for line in QApplication.clipboard().text().splitlines()]
    np.testing.assert_allclose(np.array(rows, float), values, rtol=1e-6)
    monkeypatch.setattr(QFileDialog, "getSaveFileName", lambda *_, **__: (str(tmp_path / "map.csv"), ""))
    actions["Save data …"].trigger()  # type: ignore[attr-defined]
    np.testing.assert_allclose(np.loadtxt(tmp_path / "map.csv", delimiter=","), values, rtol=1e-6)


def test_positions_without_a_value_are_grey_and_only_a_few_are_crossed_out(qtbot: QtBot) -> None:
    """Thousands of crosses covered the map of a recording that had just begun."""
    view = PeriodMap()
    qtbot.addWidget(view)
    view.show()
    recorded = np.ones((55, 95), int)
    recorded[3, 4:7] = 0
    view.set_values(np.ones((55, 95)), recorded)
    assert len(view.shot.overlays[0].points) == 3
    view.set_values(np.ones((55, 95)), 1 - recorded)
    assert len(view.shot.overlays[0].points) == 0 and np.isnan(view.values).sum() == 55 * 95 - 3
