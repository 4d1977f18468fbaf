"""Text has the room it needs, and no more than it may have."""

from __future__ import annotations

from PySide6.QtWidgets import QApplication, QPlainTextEdit, QVBoxLayout, QWidget
from pytestqt.qtbot import QtBot

from lfcal_gui.widgets.fitted_text import WIDEST, FittedBrowser, lines_px
from tests.gui.layout import flaws

LINE = "words of a fault, of which there are as many as it takes. "


def test_a_browser_is_as_high_as_its_words(qtbot: QtBot) -> None:
    root, words = QWidget(), FittedBrowser(60, 160)
    column = QVBoxLayout(root)
    column.addWidget(words)
    column.addStretch()
    qtbot.addWidget(root)
    root.show()
    root.resize(400, 300)
    heights = []
    for count in (1, 5, 7, 60, 1):
        words.setHtml(f"<b>Fault</b>: {LINE * count}")
        QApplication.processEvents()
        heights.append(words.height())
        bar = words.verticalScrollBar()
        assert bar.isVisible() == (count == 60) and not flaws(root)
    assert heights[0] == heights[4] == 60 < heights[1] < heights[2] < heights[3] == 160
    words.setHtml(LINE * 5)
    root.resize(320, 300)
    QApplication.processEvents()
    assert words.height() > heights[1] and not words.verticalScrollBar().isVisible()


def test_the_width_of_lines_is_that_of_the_longest(qtbot: QtBot) -> None:
    view = QPlainTextEdit()
    qtbot.addWidget(view)
    view.setLineWrapMode(QPlainTextEdit.LineWrapMode.NoWrap)
    view.setPlainText(f"short\n{LINE * 2}\nshort")
    view.show()
    view.resize(lines_px(view), 200)
    QApplication.processEvents()
    assert not view.horizontalScrollBar().isVisible()
    view.setPlainText(LINE * 100)
    assert lines_px(view) == WIDEST
    view.clear()
    assert 0 < lines_px(view) < 60
