"""The dock of the window: the log with all that was done and refused since the start."""

from __future__ import annotations

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QDockWidget, QMainWindow, QPlainTextEdit, QWidget

__all__ = ["LogView", "add_dock"]

LINES = 2000
"""The last lines that are kept."""


class LogView(QPlainTextEdit):
    """Lines that are read, and copied, but not changed."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setReadOnly(True)
        self.setAccessibleName("log")
        self.setToolTip("All that was done and refused since the start; the file of it is in the log folder (Help)")
        self.setMaximumBlockCount(LINES)


def add_dock(window: QMainWindow, title: str, content: QWidget) -> QDockWidget:
    """Add a dock with ``content`` at the bottom of a window; it is kept between starts by its title."""
    dock = QDockWidget(title, window)
    dock.setObjectName(title.lower())
    dock.setWidget(content)
    window.addDockWidget(Qt.DockWidgetArea.BottomDockWidgetArea, dock)
    return dock
