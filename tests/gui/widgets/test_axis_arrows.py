"""Arrows over a picture: drawn where they say, out of the mouse's way."""

from __future__ import annotations

import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtGui import QImage
from PySide6.QtWidgets import QWidget
from pytestqt.qtbot import QtBot

from lfcal_gui.widgets.axis_arrows import HEIGHT, MIDDLE, STAGE, WIDTH, AxisArrows


def drawn(arrows: AxisArrows) -> np.ndarray:
    """Return where the stage's colour was drawn, ``(rows, columns)``."""
    image = arrows.grab().toImage().convertToFormat(QImage.Format.Format_RGB32)
    colour = STAGE.rgb()
    return np.array([[image.pixel(c, r) == colour for c in range(WIDTH)] for r in range(HEIGHT)])


@pytest.mark.parametrize(
    ("down", "right", "word"), [(0.0, 1.0, "right"), (0.0, -1.0, "left"), (1.0, 0.0, "down"), (-1.0, 0.0, "up")]
)
def test_the_arrow_is_on_its_side_and_in_words(qtbot: QtBot, down: float, right: float, word: str) -> None:
    parent = QWidget()
    qtbot.addWidget(parent)
    parent.resize(400, 300)
    parent.show()
    arrows = AxisArrows(parent)
    arrows.set_arrows((("+x", down, right),))
    rows, columns = np.nonzero(drawn(arrows))
    assert len(rows) > 20
    away = (rows.mean() - MIDDLE.y()) * down + (columns.mean() - MIDDLE.x()) * right
    assert away > 5
    assert arrows.accessibleDescription() == f"stage +x moves the image {word}"


def test_it_keeps_to_the_corner_and_leaves_the_mouse_alone(qtbot: QtBot) -> None:
    parent = QWidget()
    qtbot.addWidget(parent)
    arrows = AxisArrows(parent)
    parent.resize(500, 300)
    parent.show()
    parent.resize(640, 300)
    qtbot.waitUntil(lambda: arrows.geometry().right() > 600)
    assert arrows.geometry().right() < 640
    assert arrows.testAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)


@pytest.mark.parametrize("name", ["+x", "-y"])
@pytest.mark.parametrize(("down", "right"), [(0.0, 1.0), (0.0, -1.0), (1.0, 0.0), (-1.0, 0.0)])
def test_words_keep_off_the_edge(qtbot: QtBot, name: str, down: float, right: float) -> None:
    """The words at the right touched their box."""
    parent = QWidget()
    qtbot.addWidget(parent)
    parent.resize(400, 300)
    parent.show()
    arrows = AxisArrows(parent)
    arrows.set_arrows(((name, down, right),))
    seen = drawn(arrows)
    assert not seen[:2].any() and not seen[-2:].any() and not seen[:, -4:].any() and not seen[:, :2].any()
