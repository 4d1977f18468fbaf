from __future__ import annotations

import numpy as np
import pyqtgraph as pg
import pytest
from pytestqt.qtbot import QtBot

from lfcal_gui.models.display import colour_table
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets.colour_bar import ColourBar


def shown_in(qtbot: QtBot, bar: ColourBar, *, hidden_first: bool = False) -> pg.GraphicsLayoutWidget:
    graphics = pg.GraphicsLayoutWidget()
    qtbot.addWidget(graphics)
    graphics.addItem(bar, row=0, col=0)
    graphics.setBackground("k")
    graphics.resize(160, 200)
    if hidden_first:
        bar.hide()
        bar.set_label("another name")
        bar.show()
    graphics.show()
    qtbot.waitExposed(graphics)
    return graphics


@pytest.mark.parametrize("below", [False, True])
def test_the_first_colour_is_at_the_lowest_value(qtbot: QtBot, below: bool) -> None:
    bar = ColourBar((0.0, 10.0), label="light", below=below)
    table = colour_table("viridis")
    bar.set_colours(table)
    graphics = shown_in(qtbot, bar)
    picture = graphics.grab().toImage()
    strip = bar._strip.sceneBoundingRect().toRect()
    first = (strip.left() + 2, strip.center().y()) if below else (strip.center().x(), strip.bottom() - 2)
    last = (strip.right() - 2, strip.center().y()) if below else (strip.center().x(), strip.top() + 2)
    for place, wanted in ((first, table[0]), (last, table[-1])):
        found = picture.pixelColor(*place).getRgb()[:3]
        assert np.abs(np.subtract(found, wanted[:3].astype(int))).max() < 12


@pytest.mark.parametrize("below", [False, True])
def test_a_bar_that_was_hidden_has_room_for_its_name(qtbot: QtBot, below: bool) -> None:
    """Axes take no room while they are hidden, and ask for none when they are shown."""
    bar = ColourBar(label="light (counts)", below=below)
    graphics = shown_in(qtbot, bar, hidden_first=True)
    size = bar.name_axis.size()
    assert graphics.isVisible()
    assert bar.label() == "another name" and (size.height() if below else size.width()) > 10


def test_the_name_has_the_colour_of_text(qtbot: QtBot) -> None:
    bar = ColourBar(label="light")
    bar.apply_theme()
    assert bar.name_axis.labelStyle["color"] == pg.mkColor(current_theme().text).name()
    bar.set_levels((1000.0, 1e6))
    assert bar.levels() == (1000.0, 1e6) and bar.axis.autoSIPrefixScale == 1.0
