"""Large buttons below the tabs, with their keys, for a dark lab: found by eyes and fingers that cannot see much."""

from __future__ import annotations

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QHBoxLayout, QLabel, QPushButton, QSizePolicy, QVBoxLayout, QWidget

from lfcal_gui.pages.acquire.model_lab import KEYS
from lfcal_gui.widgets import card

__all__ = ["LabPanel"]

TIPS = {
    "next": "What comes next in a sitting: connect, measure, record, dark and white frames, assemble",
    "start": "Record every position, or go on with the session",
    "pause": "Finish the current position, then wait; again: go on",
    "stop": "Finish the current position, then stop; the session can be resumed",
    "abort": "Stop the stage now; what is recorded is safe",
}


class LabPanel(QWidget):
    """The tabs of the page, and below them, where it is wanted, status and buttons in large.

    Signals
    -------
    pressed(key)
        A button of `lfcal_gui.pages.acquire.model_lab.KEYS`.
    """

    pressed = Signal(str)

    def __init__(self, tabs: QWidget) -> None:
        super().__init__()
        self.bar, column = card()
        self.status = QLabel("")
        self.status.setProperty("role", "big")
        self.status.setWordWrap(True)
        self.status.setAccessibleName("status of the recording")
        # long words go on in the next line, and never make the window wider
        self.status.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)
        column.addWidget(self.status)
        row = QHBoxLayout()
        row.setSpacing(8)
        self.buttons: dict[str, QPushButton] = {}
        for key, shortcut in KEYS:
            button = QPushButton()
            button.setProperty("role", "big")
            button.setToolTip(f"{TIPS[key]} ({shortcut})")
            button.clicked.connect(lambda _=False, key=key: self.pressed.emit(key))
            # the words change, the place does not
            button.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
            self.buttons[key] = button
            row.addWidget(button, 2 if key == "next" else 1)
        column.addLayout(row)
        outer = QVBoxLayout(self)
        outer.setContentsMargins(0, 0, 0, 0)
        outer.setSpacing(8)
        outer.addWidget(tabs, 1)
        outer.addWidget(self.bar)
        self.bar.hide()

    def show_button(self, key: str, words: str, *, enabled: bool) -> None:
        """Show what a button does, with its key."""
        button = self.buttons[key]
        button.setText(f"{words}\n{dict(KEYS)[key]}")
        button.setAccessibleName(f"{words} ({key})")
        button.setEnabled(enabled)

    def show_status(self, words: str) -> None:
        """Show how the recording is."""
        self.status.setText(words)

    def press(self, key: str) -> None:
        """Press a button by its key, where it is shown and can be pressed."""
        if self.bar.isVisible():
            self.buttons[key].click()
