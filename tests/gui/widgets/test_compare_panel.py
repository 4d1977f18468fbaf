"""Two H side by side, in pictures that show one position of both."""

from __future__ import annotations

import numpy as np
import pytest
from pytestqt.qtbot import QtBot

from lfcal.judge import pair
from lfcal_gui.models.comparison import both_at
from lfcal_gui.widgets.compare_panel import ComparePanel
from tests.gui.waiting import GUARD_MS
from tests.judge.test_comparison import moved


@pytest.fixture
def panel(qtbot: QtBot) -> ComparePanel:
    """Return the panel with a position of two H."""
    made = ComparePanel()
    qtbot.addWidget(made)
    made.resize(1000, 700)
    made.show()
    made.show_numbers(("H.h5", "earlier.h5"), ("", ""), [], [], [])
    made.show_both(both_at(pair(3 * moved(), moved()), (1, 2, 3)), "at (1, 2, 3)")
    return made


def test_both_are_shown_at_the_same_light(panel: ComparePanel) -> None:
    first, second, apart = (view.values for view in panel.views)
    assert first is not None and second is not None and apart is not None
    assert panel.titles[0].text() == "H.h5 at (1, 2, 3)" and first.sum() == pytest.approx(second.sum())
    assert np.array_equal(apart, first - second)


def test_pictures_are_zoomed_together(panel: ComparePanel) -> None:
    views = panel.views
    views[0].box.setRange(xRange=(5, 9), yRange=(5, 9), padding=0)
    views[0].box.sigRangeChangedManually.emit([True, True])
    seen = [view.box.viewRect() for view in views]
    assert seen[1].center() == seen[0].center() == seen[2].center()
    assert seen[1].width() == pytest.approx(seen[0].width(), rel=0.3)


@pytest.mark.long
def test_blink_shows_both_in_one_place(panel: ComparePanel, qtbot: QtBot) -> None:
    panel.mode.setCurrentIndex(panel.mode.findData("blink"))
    before = panel.views[0].values
    assert panel.views[1].isHidden() or not panel.views[1].isVisible()
    qtbot.waitUntil(lambda: panel.titles[0].text() == "earlier.h5", timeout=GUARD_MS)
    assert panel.views[0].values is not before
    qtbot.waitUntil(lambda: panel.titles[0].text() == "H.h5 at (1, 2, 3)", timeout=GUARD_MS)
    panel.mode.setCurrentIndex(panel.mode.findData("difference"))
    assert panel.views[2].isVisible() and not panel.views[0].isVisible() and not panel._timer.isActive()


def test_nothing_of_an_earlier_pair_stays_while_the_next_is_read(panel: ComparePanel) -> None:
    panel.show_numbers(("H.h5", "earlier.h5"), ("", ""), [], [], [])
    assert all(view.values is None for view in (*panel.views, panel.map))
    assert all(title.text() == " " for title in (*panel.titles, panel.map_title))


def test_positions_that_were_not_compared_have_no_number(panel: ComparePanel) -> None:
    error = np.ones((4, 6))
    error[1, 2] = np.nan
    panel.show_map(0, "Difference", error, (0.0, 2.0))
    assert panel.map.values is not None and not panel.map.blank.shown
    assert panel.map.overlays[0].points.tolist() == [[1, 2]], "crossed out"
    panel.show_map(1, "Difference", np.full((4, 6), np.nan), (0.0, 2.0))
    assert panel.map.values is None and panel.map.blank.words.startswith("Not compared")
    assert panel.map.shot.cross is None and not panel.map.overlays
