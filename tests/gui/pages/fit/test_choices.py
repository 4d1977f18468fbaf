"""The column of choices."""

from __future__ import annotations

from pytestqt.qtbot import QtBot

from lfcal_gui.pages.fit._choices_panel import ChoicesPanel


def test_a_low_column_scrolls_and_squashes_nothing(qtbot: QtBot) -> None:
    """As on a small screen with large fonts."""
    panel = ChoicesPanel()
    qtbot.addWidget(panel)
    panel.resize(panel.width(), 150)
    panel.show()
    for key in panel.form.fields:
        editor = panel.form.editor(key)
        assert editor.height() >= editor.minimumSizeHint().height(), key
    assert panel.minimumSizeHint().height() < 150
