"""The dialog of an unexpected error: what happened, what is safe, where the log is."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from PySide6.QtCore import Qt, QUrl
from PySide6.QtGui import QDesktopServices
from PySide6.QtWidgets import (
    QApplication,
    QDialog,
    QHBoxLayout,
    QLabel,
    QPlainTextEdit,
    QPushButton,
    QVBoxLayout,
    QWidget,
)

from lfcal_gui.log import system_line
from lfcal_gui.models import Mishap
from lfcal_gui.theme import style_sheet
from lfcal_gui.widgets import lines_px

WIDTH = 560


def open_folder(folder: Path) -> None:
    """Show a folder in the system's file manager."""
    QDesktopServices.openUrl(QUrl.fromLocalFile(str(folder)))


class CrashDialog(QDialog):
    """One for all errors; it does not block the window."""

    def __init__(self, log: Path | None, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setStyleSheet(style_sheet())
        self.setWindowTitle("Unexpected error")
        self._log = log
        self._mishaps: list[Mishap] = []
        column = QVBoxLayout(self)
        column.setContentsMargins(18, 16, 18, 14)
        column.setSpacing(10)
        heading = QLabel("Something unexpected happened")
        heading.setProperty("role", "title")
        self.words = _wrapped("error")
        self.safe = _wrapped("")
        where = f"Log: {log}" if log is not None else "There is no log file: its folder cannot be written to."
        self.where = _wrapped("hint")
        self.where.setText(where)
        for widget in (heading, self.words, self.safe, self.where):
            column.addWidget(widget)
        self.details = QPlainTextEdit()
        self.details.setReadOnly(True)
        self.details.setAccessibleName("details")
        self.details.setToolTip("Traceback; include it in a bug report")
        self.details.setLineWrapMode(QPlainTextEdit.LineWrapMode.NoWrap)
        self.details.setMinimumHeight(180)
        self.details.hide()
        column.addWidget(self.details, 1)
        column.addLayout(self._buttons())
        self.setMinimumWidth(WIDTH)

    def _buttons(self) -> QHBoxLayout:
        row = QHBoxLayout()
        self.more = QPushButton("Details")
        self.more.setToolTip("Show the traceback, for a bug report")
        self.more.setCheckable(True)
        self.more.toggled.connect(self._show_details)
        self.copy = QPushButton("Copy text")
        self.copy.setToolTip("Copy all of it, for a bug report")
        self.copy.clicked.connect(self.copy_text)
        self.folder = QPushButton("Open log folder")
        self.folder.setToolTip("The log of this session shows what happened before the error")
        self.folder.setEnabled(self._log is not None)
        self.folder.clicked.connect(lambda _=False: self._log is not None and open_folder(self._log.parent))
        close = QPushButton("Close")
        close.setToolTip("Continue to work. The text above says what is safe")
        close.setProperty("role", "primary")
        close.setDefault(True)
        close.clicked.connect(self.close)
        for button in (self.more, self.copy, self.folder):
            row.addWidget(button)
        row.addStretch()
        row.addWidget(close)
        return row

    def show_mishaps(self, mishaps: Sequence[Mishap], safe: Sequence[str] | None) -> None:
        """Show these errors, the newest last, and what is safe (None: as before)."""
        self._mishaps = list(mishaps)
        self.words.setText("\n".join(mishap.title() for mishap in self._mishaps[-3:]))
        if safe is not None:
            self.safe.setText("\n".join(safe))
        self.details.setPlainText(self.text())
        if not self.isVisible():
            self.adjustSize()
            self.show()

    def text(self) -> str:
        """Return what a report of the error should hold."""
        parts = [system_line(), *(f"{m.title()}\nin {m.thread}\n{m.trace}" for m in self._mishaps)]
        return "\n\n".join(parts)

    def copy_text(self) -> None:
        """Put it on the clipboard."""
        QApplication.clipboard().setText(self.text())
        self.copy.setText("Copied")

    def _show_details(self, on: bool) -> None:
        self.details.setVisible(on)
        margins = self.layout().contentsMargins()
        needs = lines_px(self.details) + margins.left() + margins.right() if on else 0
        self.setMinimumWidth(max(WIDTH, needs))
        self.adjustSize()
        # Qt stops at two thirds of the screen, and the buttons would cover the text
        self.resize(self.width(), max(self.height(), self.layout().totalHeightForWidth(self.width())))


def _wrapped(role: str) -> QLabel:
    label = QLabel()
    label.setWordWrap(True)
    label.setTextFormat(Qt.TextFormat.PlainText)
    label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
    label.setProperty("role", role)
    return label
