"""A verdict in a word and a sentence, with what leads to its reasons."""

from __future__ import annotations

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QFrame, QHBoxLayout, QPushButton, QVBoxLayout, QWidget

from lfcal_gui.widgets.words import ElidedLabel, WrappedLabel, set_look, set_role

HEADS = {"good": "✓ Good", "fair": "▲ Fair", "bad": "▲ Bad", "unknown": "Not fully judged", "": "Not judged yet"}
"""Headline for a merit; its mark repeats what the colour says."""


class VerdictCard(QFrame):
    """Whether something is good: mark, colour and sentence.

    Signals
    -------
    why_asked()
        The reasons are wanted.
    """

    why_asked = Signal()

    def __init__(self, why: str, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setProperty("role", "verdict")
        self.head, self.sentence, self.why = ElidedLabel(), WrappedLabel(), QPushButton("Why")
        self.why.setProperty("role", "tight")
        self.why.setToolTip(why)
        self.why.clicked.connect(lambda: self.why_asked.emit())
        top = QHBoxLayout()
        top.addWidget(self.head, 1)
        top.addWidget(self.why)
        column = QVBoxLayout(self)
        column.setContentsMargins(12, 6, 8, 8)
        column.setSpacing(3)
        column.addLayout(top)
        column.addWidget(self.sentence)
        self.show_verdict("", "")

    def show_verdict(self, merit: str, sentence: str, head: str = "") -> None:
        """Show a verdict of merit ``"good"``, ``"fair"``, ``"bad"``, ``"unknown"``, or that there is none (empty)."""
        self.head.setText(head or HEADS[merit])
        self.sentence.setText(sentence)
        self.sentence.setVisible(bool(sentence))
        set_role(self.head, merit if merit in ("good", "fair", "bad") else "hint")
        set_look(self, "merit", merit)
