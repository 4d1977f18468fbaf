"""A card whose head is one line: what it is, how it stands, and what can be done with it."""

from __future__ import annotations

from collections.abc import Callable

from PySide6.QtWidgets import QFrame, QHBoxLayout, QPushButton, QVBoxLayout, QWidget

from lfcal_gui.widgets.words import ElidedLabel

__all__ = ["HeadedCard"]


class HeadedCard(QFrame):
    """A low card; `column` takes what stands below the head."""

    def __init__(self, title: str, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setProperty("role", "card")
        self.column = QVBoxLayout(self)
        self.column.setContentsMargins(10, 3, 4, 3)
        self.column.setSpacing(3)
        self.head = QHBoxLayout()
        self.title = ElidedLabel(title)
        self.title.setProperty("role", "heading")
        self.status = ElidedLabel()
        self.status.setProperty("role", "hint")
        self.head.addWidget(self.title)
        self.head.addWidget(self.status, 1)
        self.column.addLayout(self.head)

    def add_button(self, text: str, tip: str, action: Callable[[], object]) -> QPushButton:
        """Add a button at the end of the head."""
        button = QPushButton(text)
        button.setToolTip(tip)
        button.clicked.connect(lambda _=False: action())
        self.head.addWidget(button)
        return button

    def leave(self) -> None:
        """Go away."""
        self.setParent(None)
        self.deleteLater()
