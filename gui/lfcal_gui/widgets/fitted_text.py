"""Text that gets the room it needs: no scroll bar for its last line."""

from __future__ import annotations

from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QPlainTextEdit, QTextBrowser, QWidget

__all__ = ["FittedBrowser", "lines_px"]

BESIDE = 42
"""Margins, frame and an upright scroll bar beside lines of text (px)."""

WIDEST = 1180
"""Width of text in a window that is no wider than the smallest one of the program (px)."""


class FittedBrowser(QTextBrowser):
    """Rich text as high as it needs to be.

    Parameters
    ----------
    lowest, highest
        Bounds of its height (px); more text than that scrolls.
    """

    def __init__(self, lowest: int, highest: int, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._bounds = (lowest, highest)
        self.setFixedHeight(lowest)

    def setHtml(self, text: str) -> None:
        """Show rich text."""
        super().setHtml(text)
        self._fit()

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Be higher where lines are shorter."""
        super().resizeEvent(event)
        self._fit()

    def _fit(self) -> None:
        bar = self.verticalScrollBar()
        page = self.document().clone(self)
        page.setTextWidth(self.viewport().width() + (bar.width() if bar.isVisible() else 0))
        across = self.horizontalScrollBar()
        around = self.height() - self.viewport().height() - (across.height() if across.isVisible() else 0)
        lowest, highest = self._bounds
        self.setFixedHeight(min(highest, max(lowest, round(page.size().height() + 0.5) + around)))
        page.deleteLater()


def lines_px(view: QPlainTextEdit) -> int:
    """Return the width that ``view`` needs for its longest line, up to that of a small window (px)."""
    view.ensurePolished()
    metrics = view.fontMetrics()
    longest = max((metrics.horizontalAdvance(line) for line in view.toPlainText().splitlines()), default=0)
    return min(WIDEST, longest + BESIDE)
