"""The rail: no word below a place is cut."""

from __future__ import annotations

import pytest
from PySide6.QtCore import Qt
from pytestqt.qtbot import QtBot

from lfcal_gui._rail import BAR
from lfcal_gui.theme import DARK, LIGHT, Theme
from lfcal_gui.window import MainWindow
from tests.gui.layout import flaws

WORDS = (
    ("start here", "fair"),
    ("needs a plan", ""),
    ("cannot work", "bad"),
    ("12 assumed", ""),
    ("plane 12 of 24", ""),
    ("1,234 to redo", "fair"),
    ("complete", "good"),
    ("exported", "good"),
)


@pytest.mark.parametrize("theme", [LIGHT, DARK])
def test_no_word_of_a_place_is_cut(window: MainWindow, qtbot: QtBot, theme: Theme) -> None:
    window.set_theme(theme.name)
    rail = window.rail
    window.resize(1000, 600)
    window.show()
    for place in rail._buttons:
        for word, mark in WORDS:
            rail.say(place, word, mark)
            qtbot.wait(1)
            assert not flaws(rail), word
            label = rail._buttons[place].word
            flags = label.alignment() | Qt.TextFlag.TextWordWrap
            drawn = label.fontMetrics().boundingRect(label.contentsRect(), flags, label.text())
            assert BAR <= label.x() + drawn.left() and label.x() + drawn.right() < label.parentWidget().width() - 1, (
                word
            )
