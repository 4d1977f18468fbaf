"""The log of one job beside the window: read while it grows, copied, saved."""

from __future__ import annotations

import re

from PySide6.QtCore import QTimer
from PySide6.QtGui import QFontDatabase, QHideEvent, QShowEvent
from PySide6.QtWidgets import QApplication, QDialog, QPlainTextEdit, QPushButton, QVBoxLayout, QWidget

from lfcal_gui.models import JobLog
from lfcal_gui.saving import ask_target, write_file
from lfcal_gui.theme import style_sheet
from lfcal_gui.widgets import line, lines_px

__all__ = ["EVERY_MS", "JobLogView"]

EVERY_MS = 500
"""Between two looks at a log that may grow (ms)."""

SIZE = (820, 460)


class JobLogView(QDialog):
    """Shows a `JobLog` as it is, and goes on to do so until it is closed."""

    def __init__(self, log: JobLog, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._log, self._shown = log, ""
        self.setWindowTitle(f"Log of {log.title}")
        self.resize(*SIZE)
        self.view = QPlainTextEdit()
        self.view.setReadOnly(True)
        self.view.setLineWrapMode(QPlainTextEdit.LineWrapMode.NoWrap)
        self.view.setAccessibleName(f"log of {log.title}")
        self.view.setToolTip("What the job did and when, what it warned of; it grows while the job runs")
        self.view.setFont(QFontDatabase.systemFont(QFontDatabase.SystemFont.FixedFont))
        self.copy, self.keep, close = QPushButton("Copy text"), QPushButton("Save …"), QPushButton("Close")
        self.copy.setToolTip("Put the log on the clipboard, for a report of a problem")
        self.keep.setToolTip("Keep the log as a text file: the window forgets it when it is closed")
        close.setToolTip("Close this window; the job goes on, and keeps its log")
        self.copy.clicked.connect(lambda: QApplication.clipboard().setText(self._log.text()))
        self.keep.clicked.connect(lambda: self.save())
        close.clicked.connect(self.close)
        column = QVBoxLayout(self)
        column.addWidget(self.view, 1)
        column.addLayout(line(QWidget(), self.copy, self.keep, close, stretch=0))
        self._timer = QTimer(self)
        self._timer.setInterval(EVERY_MS)
        self._timer.timeout.connect(self.refresh)

    def showEvent(self, event: QShowEvent) -> None:
        """Follow the job while the log is seen."""
        self.setStyleSheet(style_sheet())
        first = not self._shown
        self.refresh()
        if first:  # later it is as wide as the user made it
            margins = self.layout().contentsMargins()
            self.resize(max(self.width(), lines_px(self.view) + margins.left() + margins.right()), self.height())
        self._timer.start()
        super().showEvent(event)

    def hideEvent(self, event: QHideEvent) -> None:
        """Look no more."""
        self._timer.stop()
        super().hideEvent(event)

    def refresh(self) -> None:
        """Show what was said since the last look; the place that is read stays, unless that is the end."""
        text = self._log.text()
        if text == self._shown:
            return
        self._shown = text
        bar = self.view.verticalScrollBar()
        place, at_end = bar.value(), bar.value() >= bar.maximum()
        self.view.setPlainText(text)
        bar.setValue(bar.maximum() if at_end else place)

    def save(self, path: str = "") -> None:
        """Write the log; asks for the file unless it is given."""
        name = re.sub(r"[^\w.-]+", "_", self._log.title).strip("_")
        path = path or ask_target(self, "Save log", f"{name}.txt", "text (*.txt)")
        if path:
            write_file(self, path, lambda part: part.write_text(self._log.text(), encoding="utf-8"))
