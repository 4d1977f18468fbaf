"""The choices of a fit."""

from __future__ import annotations

from pytestqt.qtbot import QtBot

from lfcal_gui.pages.h.fit_view import ChoicesPanel


def test_all_unknowns_are_seen_without_a_scroll_bar_of_their_own(qtbot: QtBot) -> None:
    panel = ChoicesPanel()
    qtbot.addWidget(panel)
    panel.resize(290, 900)
    panel.show()
    panel.unknowns.open()
    qtbot.wait(0)
    assert panel.groups.isVisible() and panel.groups.verticalScrollBar().maximum() == 0
