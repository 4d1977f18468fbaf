"""What is assumed of the camera, each value with a button that confirms it."""

from __future__ import annotations

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QGridLayout, QLabel, QPushButton, QScrollArea, QVBoxLayout, QWidget

from lfcal_gui.pages.camera.model_marks import Assumed
from lfcal_gui.widgets import clear, line

__all__ = ["AssumedList"]

NONE = "Nothing is assumed of this camera: every value is stated, measured, or follows from such values."
SOME = (
    "Nobody stated these values; figures that rest on them are no better than they are. Type the true value in its "
    "field, or confirm what is right."
)


class AssumedList(QWidget):
    """A list of values with buttons.

    Signals
    -------
    confirmed(paths)
        The user says that the values at these paths are right.
    """

    confirmed = Signal(tuple)

    def __init__(self) -> None:
        super().__init__()
        column = QVBoxLayout(self)
        column.setContentsMargins(4, 6, 4, 4)
        self.words = QLabel()
        self.words.setProperty("role", "hint")
        self.words.setWordWrap(True)
        self.all = QPushButton("Confirm all")
        self.all.setToolTip(
            "You know that all of these values are right: figures that rest on them are no longer doubted"
        )
        self.all.clicked.connect(lambda: self.confirmed.emit(tuple(value.path for value in self.values)))
        column.addLayout(line(self.words, self.all, stretch=0))
        self._area = QScrollArea()
        self._area.setWidgetResizable(True)
        column.addWidget(self._area, 1)
        self.values: tuple[Assumed, ...] = ()
        self.buttons: dict[str, QPushButton] = {}

    def show_values(self, values: tuple[Assumed, ...]) -> None:
        """Show what is assumed."""
        self.values, self.buttons = values, {}
        self.words.setText(SOME if values else NONE)
        self.all.setVisible(bool(values))
        self._area.setVisible(bool(values))
        inner = QWidget()
        grid = QGridLayout(inner)
        grid.setContentsMargins(0, 0, 8, 0)
        grid.setVerticalSpacing(3)
        for k, value in enumerate(values):
            # two columns of values: there are about twenty
            row, side = k // 2, 4 * (k % 2)
            grid.addWidget(QLabel(value.label), row, side)
            shown = QLabel(value.text)
            shown.setProperty("role", "value")
            grid.addWidget(shown, row, side + 1)
            button = QPushButton("Confirm")
            button.setAccessibleName(f"Confirm {value.label}")
            button.setToolTip(f"You know that {value.label} is {value.text}: it counts as stated from now on")
            button.clicked.connect(lambda _=False, path=value.path: self.confirmed.emit((path,)))
            grid.addWidget(button, row, side + 2)
            self.buttons[value.path] = button
        for column in (1, 5):
            grid.setColumnStretch(column, 1)
        grid.setColumnMinimumWidth(3, 24)
        grid.setRowStretch(len(values), 1)
        self._area.setWidget(inner)
        clear(self._area)
