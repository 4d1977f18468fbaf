"""Titles that open and close what is below them: for what is rarely needed."""

from __future__ import annotations

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QFrame, QHBoxLayout, QLabel, QPushButton, QVBoxLayout, QWidget

from lfcal_gui.widgets.cards import card

CLOSED, OPENED = "▸", "▾"


class FoldHead(QPushButton):
    """A title on the left, and a few words on what is folded on the right.

    Parameters
    ----------
    title
        Name of what is folded.
    tip
        What is folded.

    Attributes
    ----------
    words
        The few words.
    """

    def __init__(self, title: str, tip: str, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setToolTip(tip)
        self.setProperty("role", "fold")
        self.setCheckable(True)
        self.words = ""
        self._right = QLabel()
        self._right.setProperty("role", "hint")
        self._right.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 2, 0)
        row.addWidget(self._right, 0, Qt.AlignmentFlag.AlignRight)
        self.toggled.connect(lambda _: self.say(self.words))
        self.name(title)

    def name(self, title: str) -> None:
        """Change the title."""
        self.setText(title)
        self.say(self.words)

    def say(self, words: str) -> None:
        """Say something of what is folded."""
        self.words = words
        self._right.setText(f"{words} {OPENED if self.isChecked() else CLOSED}")
        self.setAccessibleName(f"{self.text()}: {words}" if words else self.text())


class Folded(QFrame):
    """A card that shows its title alone until it is opened.

    Parameters
    ----------
    title
        Always seen.
    tip
        When one would open it.
    """

    def __init__(self, title: str, tip: str, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.head = FoldHead(title, tip)
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
        self.head.toggled.connect(self.body.setVisible)
        self.body.hide()

    def open(self) -> None:
        """Show what is below the title."""
        self.head.setChecked(True)
