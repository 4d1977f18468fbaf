"""The drawing of main optics and array."""

from __future__ import annotations

from typing import Any

import pytest
from PySide6.QtCore import QRectF
from PySide6.QtGui import QImage, QPainter
from pytestqt.qtbot import QtBot

from lfcal.camera import PRESETS, preset
from lfcal_gui.pages.setup._optics_view import OpticsView


class Listening(QPainter):
    """A painter that remembers where texts went."""

    def __init__(self, image: QImage) -> None:
        super().__init__(image)
        self.texts: list[tuple[QRectF, str]] = []

    def drawText(self, *args: Any) -> None:
        if isinstance(args[0], QRectF):
            self.texts.append((args[0], args[-1]))


@pytest.mark.parametrize("name", PRESETS)
def test_words_are_whole_and_do_not_meet(qtbot: QtBot, name: str) -> None:
    view = OpticsView()
    qtbot.addWidget(view)
    view.set_camera(preset(name))
    view.resize(view.minimumSize())
    image = QImage(view.size(), QImage.Format.Format_RGB32)
    painter = Listening(image)
    split = view.width() * 0.58
    view._draw_camera(painter, QRectF(8, 8, split - 24, view.height() - 16))
    painter.end()
    assert painter.texts
    for k, (rect, text) in enumerate(painter.texts):
        assert rect.left() >= 0 and rect.top() >= 0 and rect.right() <= view.width(), text
        assert not [other for at, other in painter.texts[:k] if at.intersects(rect) and text and other], text
