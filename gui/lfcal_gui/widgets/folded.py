"""A card that shows its title alone until it is opened: for what is rarely needed."""

from __future__ import annotations

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QFrame, QToolButton, QVBoxLayout, QWidget

from lfcal_gui.widgets.cards import card

__all__ = ["Folded"]


class Folded(QFrame):
    """A title that opens and closes what is below it.

    Parameters
    ----------
    title
        Always seen.
    tip
        When one would open it.
    """

    def __init__(self, title: str, tip: str, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.head = QToolButton()
        self.head.setText(title)
        self.head.setToolTip(tip)
        self.head.setProperty("role", "fold")
        self.head.setCheckable(True)
        self.head.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextBesideIcon)
        self.body = QWidget()
        self.column = QVBoxLayout(self.body)
        self.column.setContentsMargins(0, 0, 0, 0)
        self.column.setSpacing(5)
        frame, inner = card()
        inner.addWidget(self.head)
        inner.addWidget(self.body)
        outer = QVBoxLayout(self)
        outer.setContentsMargins(0, 0, 0, 0)
        outer.addWidget(frame)
        self.head.toggled.connect(self._show)
        self._show(False)

    def open(self) -> None:
        """Show what is below the title."""
        self.head.setChecked(True)

    def _show(self, on: bool) -> None:
        self.head.setArrowType(Qt.ArrowType.DownArrow if on else Qt.ArrowType.RightArrow)
        self.body.setVisible(on)
