"""The question how H is to be exported: a kind of file, its options, and what its readers take otherwise."""

from __future__ import annotations

from dataclasses import replace

from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtGui import QShowEvent
from PySide6.QtWidgets import QCheckBox, QDialog, QHBoxLayout, QLabel, QPushButton, QVBoxLayout, QWidget

from lfcal.psf import PSFMatrix
from lfcal_gui.models import said_in_window, typeset
from lfcal_gui.pages.psf.export_model import CHOICES, KINDS, ExportIntent
from lfcal_gui.widgets import card, choice_box

__all__ = ["ExportDialog"]

WIDTH = 520


class ExportDialog(QDialog):
    """Shows an `ExportIntent` and changes it.

    Signals
    -------
    asked(intent)
        The file is to be named, and written so.
    """

    asked = Signal(object)

    def __init__(self, matrix: PSFMatrix, intent: ExportIntent, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Export H")
        self._matrix, self.intent = matrix, intent
        column = QVBoxLayout(self)
        column.setContentsMargins(16, 14, 16, 14)
        column.setSpacing(8)
        self.kind_box = choice_box(
            [(suffix, f"{text} ({suffix})") for suffix, text in KINDS],
            "By the code that will read the file: MATLAB and Octave, Python, ImageJ",
        )
        self.kind_box.setAccessibleName("Kind of file")
        self.kind_box.currentIndexChanged.connect(
            lambda _: self._show(replace(self.intent, suffix=self.kind_box.currentData()))
        )
        column.addWidget(self.kind_box)
        self.boxes: dict[str, QCheckBox] = {}
        self._rows: dict[str, QWidget] = {}
        for choice in CHOICES:
            column.addWidget(self._row(choice.name, choice.text, choice.hint))
        self.notes_card, notes = card("What to know of this file")
        self.notes = QLabel()
        self.notes.setWordWrap(True)
        self.notes.setTextFormat(Qt.TextFormat.PlainText)
        notes.addWidget(self.notes)
        column.addWidget(self.notes_card)
        column.addLayout(self._buttons())
        self.setFixedWidth(WIDTH)
        self._show(intent)

    def _row(self, name: str, text: str, hint: str) -> QWidget:
        row = QWidget()
        column = QVBoxLayout(row)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(0)
        box, label = QCheckBox(text), QLabel(hint)
        label.setProperty("role", "hint")
        label.setWordWrap(True)
        label.setContentsMargins(24, 0, 0, 0)
        box.setToolTip(hint)
        box.toggled.connect(lambda on, name=name: self._show(self.intent.with_choice(name, on)))
        column.addWidget(box)
        column.addWidget(label)
        self.boxes[name], self._rows[name] = box, row
        return row

    def _buttons(self) -> QHBoxLayout:
        row = QHBoxLayout()
        cancel, self.go = QPushButton("Cancel"), QPushButton("Choose a file …")
        self.go.setProperty("role", "primary")
        self.go.setDefault(True)
        cancel.setToolTip("Write nothing")
        self.go.setToolTip("Say where, then it is written as a job")
        cancel.setAutoDefault(False)
        cancel.clicked.connect(self.reject)
        self.go.clicked.connect(self._ask)
        row.addStretch()
        row.addWidget(cancel)
        row.addWidget(self.go)
        return row

    def _ask(self) -> None:
        self.accept()
        self.asked.emit(self.intent)

    def _show(self, intent: ExportIntent) -> None:
        """Show an intent: the choices of its kind of file, and what is to be known of it."""
        self.intent = intent
        concerned, free = {choice.name for choice in intent.choices()}, intent.open_to(self._matrix)
        for name, box in self.boxes.items():
            blocker = QSignalBlocker(box)
            box.setChecked(getattr(intent, name))
            blocker.unblock()
            self._rows[name].setVisible(name in concerned)
            self._rows[name].setEnabled(name in free)
        blocker = QSignalBlocker(self.kind_box)
        self.kind_box.setCurrentIndex(self.kind_box.findData(intent.suffix))
        blocker.unblock()
        notes = intent.notes(self._matrix)
        lines = (typeset(said_in_window(note)) for note in notes)
        self.notes.setText("\n\n".join(f"{line[:1].upper()}{line[1:]}." for line in lines))
        self.notes_card.setVisible(bool(notes))
        self.go.setEnabled(not intent.refusal(self._matrix))
        self._fit()

    def _fit(self) -> None:
        """Be as high as all words need: Qt's own size stops at two thirds of the screen, and cuts them."""
        layout = self.layout()
        layout.activate()
        self.resize(WIDTH, layout.totalHeightForWidth(WIDTH))

    def showEvent(self, event: QShowEvent) -> None:
        """Fit anew: fonts are known only now."""
        super().showEvent(event)
        self._fit()
