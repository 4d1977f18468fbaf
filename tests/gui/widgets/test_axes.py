"""Axes of pictures count pixels: there is no half one, and none beyond the last."""

from __future__ import annotations

import numpy as np
import pytest
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from lfcal_gui.models.shot import Shot
from lfcal_gui.widgets._axes import PixelAxis
from lfcal_gui.widgets.period_map import PeriodMap
from lfcal_gui.widgets.picture import Picture
from tests.gui.layout_plots import _drawn
from tests.gui.waiting import GUARD_MS


def with_axes(unit: str = "px") -> Picture:
    return Picture(axes=(f"column ({unit})", f"row ({unit})"))


def ticks(axis: PixelAxis, low: float, high: float, size: float = 300.0) -> list[float]:
    return sorted(value for _, values in axis.tickValues(low, high, size) for value in values)


def test_whole_numbers_of_what_is_there(qtbot: QtBot) -> None:
    """A matrix of 4 rows had ticks at 0.5, and the map of a period at -1 and beyond its end."""
    view, period = with_axes(), PeriodMap()
    for widget in (view, period):
        qtbot.addWidget(widget)
    view.set_shot(Shot(np.ones((4, 7)), origin=(-2.0, 0.0)))
    period.set_values(np.ones((3, 5)))
    assert ticks(view.plot.getAxis("left"), -2.6, 1.6) == [-2, -1, 0, 1]
    assert ticks(view.plot.getAxis("left"), 1.6, -2.6) == [-2, -1, 0, 1], "rows count downwards"
    assert ticks(period.plot.getAxis("bottom"), -1.4, 6.2) == [0, 1, 2, 3, 4]
    assert ticks(period.plot.getAxis("left"), 0.8, 1.3) == [1], "however near it is seen"


def test_numbers_keep_apart_where_the_picture_is_small_on_its_axis(qtbot: QtBot) -> None:
    period = PeriodMap()
    qtbot.addWidget(period)
    period.set_values(np.ones((19, 33)))
    found = ticks(period.plot.getAxis("left"), -15.0, 35.0, 100.0)
    assert len(found) >= 2 and min(np.diff(found)) * 100 / 50 >= 14


def test_an_axis_too_short_for_two_numbers_is_no_smear(qtbot: QtBot) -> None:
    """A picture of 110 rows on 30 screen pixels had 110 numbers, one over the other."""
    view = with_axes()
    qtbot.addWidget(view)
    view.set_shot(Shot(np.ones((110, 132))))
    for size in (10.0, 30.0):
        found = ticks(view.plot.getAxis("left"), -60.0, 170.0, size)
        assert found and all(gap * size / 230 >= 14 for gap in np.diff(found))


def test_both_axes_of_a_picture_have_numbers(qtbot: QtBot) -> None:
    """Drawn as they are, not asked for."""
    view = with_axes()
    qtbot.addWidget(view)
    view.resize(400, 300)
    view.show()
    view.set_shot(Shot(np.ones((40, 70))))
    QApplication.processEvents()
    for side, last in (("left", 39), ("bottom", 69)):
        axis = view.plot.getAxis(side)
        found = sorted(value for _, values in axis.tickValues(*axis.range, 300.0) for value in values)
        assert len(found) > 2 and found[0] >= 0 and found[-1] <= last


@pytest.mark.parametrize(("origin", "step"), [((0.5, 0.5), 1.0), ((0.0, 0.0), 0.25)])
def test_pictures_of_other_units_have_the_usual_axes(qtbot: QtBot, origin: tuple[float, float], step: float) -> None:
    view = with_axes("µm")
    qtbot.addWidget(view)
    view.set_shot(Shot(np.ones((4, 4)), origin=origin, step=step))
    assert any(value % 1 for value in ticks(view.plot.getAxis("left"), 0.0, 1.0))


def test_numbers_beside_each_other_keep_apart(qapp: QApplication) -> None:
    """Two digits stood 15 px apart, which is their own width."""
    for last, size in ((94, 190.0), (6575, 400.0), (9, 120.0)):
        axis = PixelAxis("bottom")
        axis.cover(0, last + 1)
        for spread in (1.0, 1.5, 3.0):  # a picture that fills a part of its view
            middle = last / 2
            low, high = middle - spread * middle, middle + spread * middle
            pairs = [pair for pair in axis.tickValues(low, high, size) if len(pair[1]) > 1]
            apart = min(np.diff(sorted(v for _, values in pairs for v in values)), default=np.inf)
            assert apart * size / (high - low) >= 7 * len(str(last)) + 8 - 1e-9


@pytest.mark.parametrize("size", [(150, 84), (300, 84), (400, 300)])
def test_numbers_and_names_of_axes_are_whole_or_say_so(qtbot: QtBot, size: tuple[int, int]) -> None:
    """The upper half of the 0 was cut where rows are low, and a long name ran out of its plot."""
    view = Picture(axes=("χ² = photon / additive noise variance", "row (px)"))
    qtbot.addWidget(view)
    view.resize(*size)
    view.show()
    view.set_shot(Shot(np.ones((19, 33))))
    qtbot.waitUntil(lambda: "0" in [text for _, text in _drawn(view.plot.getAxis("left"))], timeout=GUARD_MS)
    seen = view.graphics.sceneRect()
    for side in ("left", "bottom"):
        axis = view.plot.getAxis(side)
        assert all(seen.contains(axis.mapRectToScene(box.adjusted(1, 1, -1, -1))) for box, _ in _drawn(axis))
    below = view.plot.getAxis("bottom")
    assert below.label.boundingRect().width() <= below.size().width() + 12
    cut = "…" in below.label.toPlainText()
    assert cut == (size[0] == 150) and bool(below.toolTip()) == cut
