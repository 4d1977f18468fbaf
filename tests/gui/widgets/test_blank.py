"""Nothing is shown as nothing: no made-up numbers at axes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pytestqt.qtbot import QtBot

from lfcal_gui.models.shot import Shot
from lfcal_gui.pages.acquire._pictures import ErrorView
from lfcal_gui.pages.h.fit_view import DecadePlot
from lfcal_gui.widgets._blank import NOTHING
from lfcal_gui.widgets.cost_curve import CostCurve
from lfcal_gui.widgets.picture import Picture
from lfcal_gui.widgets.plots import LinePlot


def numbers(view: Any) -> list[str]:
    """Return the numbers at the axes."""
    found = []
    for side in ("bottom", "left"):
        axis = view.plot.getAxis(side)
        low, high = axis.range
        if axis._tickLevels is not None:  # what is to stand there whatever the range
            found += [text for level in axis._tickLevels for _, text in level]
            continue
        for spacing, values in axis.tickValues(low, high, 300):
            found += axis.tickStrings(values, 1.0, spacing)
    return found


def with_axes() -> Picture:
    return Picture(axes=("column (px)", "row (px)"))


@pytest.mark.parametrize("made", [with_axes, lambda: LinePlot("x", "y"), ErrorView, CostCurve])
def test_an_empty_view_says_so(made: Any, qtbot: QtBot) -> None:
    view = made()
    qtbot.addWidget(view)
    view.show()
    assert view.blank.isVisible() and numbers(view) == []


def test_numbers_come_with_the_data_and_go_with_them(qtbot: QtBot) -> None:
    image, plot, rounds = with_axes(), LinePlot("x", "y"), DecadePlot("χ²", "#000000")
    for view in (image, plot, rounds):
        qtbot.addWidget(view)
        view.show()
        assert view.blank.text() == NOTHING and numbers(view) == []
    image.set_shot(Shot(np.eye(5)))
    plot.set_curve("line", [1, 2, 3], [4, 5, 6])
    rounds.show_values([1.0, 0.1], [False, False])
    for view in (image, plot, rounds):
        assert not view.blank.isVisible() and numbers(view)
    image.set_shot(None)
    plot.clear()
    assert image.blank.isVisible() and plot.blank.isVisible()
    assert numbers(image) == [] == numbers(plot)


def test_it_says_what_is_under_way_until_there_is_a_picture(qtbot: QtBot) -> None:
    """Four pictures said "Nothing to show yet." while a plane was read for them."""
    view = Picture()
    qtbot.addWidget(view)
    view.show()
    view.blank.words = "Open a light field."
    view.blank.wait("Making lf.tif …")
    assert view.blank.text() == "Making lf.tif …"
    view.blank.wait("")
    assert view.blank.text() == "Open a light field."
    view.blank.wait("Making lf.tif …")
    view.set_shot(Shot(np.eye(5)))
    view.set_shot(None)
    assert view.blank.text() == "Open a light field."
    view.blank.wait("Making lf.tif …")
    view.blank.words = "It failed."
    assert view.blank.text() == "It failed."
