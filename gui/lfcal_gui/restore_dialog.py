"""Ask whether to restore unsaved work of a window that ended."""

from __future__ import annotations

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QCloseEvent
from PySide6.QtWidgets import QDialog, QHBoxLayout, QLabel, QPushButton, QVBoxLayout, QWidget

from lfcal_gui.models import UnsavedCopy
from lfcal_gui.theme import style_sheet

WIDTH = 540


class RestoreDialog(QDialog):
    """Names the project, the copy's time and what it holds; closing it means later.

    Signals
    -------
    restore_asked(), discard_asked(), later_asked()
        One of them, once.
    """

    restore_asked = Signal()
    discard_asked = Signal()
    later_asked = Signal()

    def __init__(self, kept: UnsavedCopy, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setStyleSheet(style_sheet())
        self.setWindowTitle("Unsaved work was found")
        self._answered = False
        column = QVBoxLayout(self)
        column.setContentsMargins(18, 16, 18, 14)
        column.setSpacing(10)
        heading = QLabel(f"Restore {kept.name()}?")
        heading.setProperty("role", "title")
        heading.setTextFormat(Qt.TextFormat.PlainText)
        heading.setWordWrap(True)
        why = QLabel("A window ended without being closed. Its last changes are in no project file.")
        self.words = QLabel("\n".join(kept.words()))
        self.words.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        for label in (why, self.words):
            label.setWordWrap(True)
            label.setTextFormat(Qt.TextFormat.PlainText)
        for widget in (heading, why, self.words):
            column.addWidget(widget)
        if not kept.newer:
            hint = QLabel("The restored work does not replace that file. Saving asks for a name.")
            hint.setProperty("role", "hint")
            column.addWidget(hint)
        column.addLayout(self._buttons())
        self.setMinimumWidth(WIDTH)
        self.resize(WIDTH, column.heightForWidth(WIDTH))  # the size hint of a wrapping label is too high

    def _buttons(self) -> QHBoxLayout:
        row = QHBoxLayout()
        self.restore, self.discard, self.later = QPushButton("Restore"), QPushButton("Discard"), QPushButton("Later")
        self.restore.setProperty("role", "primary")
        self.restore.setDefault(True)
        self.restore.setToolTip("Continue with the unsaved copy. Save it under a name afterwards")
        self.discard.setToolTip("Delete the copy permanently")
        self.later.setToolTip("Keep the copy and ask at the next start")
        self.discard.setAutoDefault(False)
        for button, signal in (
            (self.restore, self.restore_asked),
            (self.discard, self.discard_asked),
            (self.later, self.later_asked),
        ):
            button.clicked.connect(lambda _=False, signal=signal: self._answer(signal))
        row.addWidget(self.discard)
        row.addStretch()
        row.addWidget(self.later)
        row.addWidget(self.restore)
        return row

    def _answer(self, signal: object) -> None:
        if not self._answered:
            self._answered = True
            self.close()
            signal.emit()  # type: ignore[attr-defined]

    def reject(self) -> None:
        """Leave it for later when Escape is pressed."""
        self._answer(self.later_asked)

    def closeEvent(self, event: QCloseEvent) -> None:
        """Leave it for later."""
        event.accept()
        self._answer(self.later_asked)
