"""Pictures: levels that stay, bars that tell the truth, values that follow the picture."""

from __future__ import annotations

import math

import numpy as np
import pytest
from PySide6.QtCore import QEvent, QPointF
from pytestqt.qtbot import QtBot

from lfcal_gui.models.display import DisplaySettings, colour_table
from lfcal_gui.widgets.colour_bar import bar_table
from lfcal_gui.widgets.image_view import ImageView
from tests.gui.waiting import GUARD_MS


@pytest.fixture
def view(qtbot: QtBot) -> ImageView:
    made = ImageView()
    qtbot.addWidget(made)
    made.resize(300, 260)
    made.show()
    qtbot.waitExposed(made, timeout=GUARD_MS)
    return made


def middle(view: ImageView) -> QPointF:
    """Return the place of pixel (1, 1) in the scene."""
    return view.plot.vb.mapViewToScene(QPointF(1.0, 1.0))


@pytest.mark.parametrize(
    "display", [DisplaySettings("log"), DisplaySettings("gamma"), DisplaySettings(colour_map="magma")]
)
def test_another_scaling_keeps_the_scale_that_pictures_share(view: ImageView, display: DisplaySettings) -> None:
    view.set_image(np.full((3, 3), 5.0), levels=(-20.0, 2437.0))
    view.set_display(display)
    assert view.bar.levels() == (-20.0, 2437.0)


@pytest.mark.parametrize("scale", ["linear", "gamma", "log"])
def test_the_bar_has_the_colours_of_the_picture(view: ImageView, scale: str) -> None:
    levels = (-20.0, 980.0)
    values = np.linspace(*levels, 256)[None]
    view.set_display(DisplaySettings(scale))
    view.set_image(values, levels=levels)
    shown = colour_table("viridis")[view.item.image[0]]
    bar = bar_table("viridis", scale, levels)
    assert np.abs(shown.astype(int) - bar.astype(int)).max() <= 4


def test_a_resting_pointer_tells_the_value_of_the_new_picture(view: ImageView, qtbot: QtBot) -> None:
    told: list[tuple[int, int, float]] = []
    view.set_image(np.zeros((3, 3)))
    view.hovered.connect(lambda *found: told.append(found))
    view._moved(middle(view))
    view.set_image(np.full((3, 3), 7.0))
    assert told == [(1, 1, 0.0), (1, 1, 7.0)]
    view.set_image(None)
    assert told[-1][0] == -1
    view.leaveEvent(QEvent(QEvent.Type.Leave))
    seen = len(told)
    view.set_image(np.ones((3, 3)))
    assert len(told) == seen and math.isnan(told[-1][2])
