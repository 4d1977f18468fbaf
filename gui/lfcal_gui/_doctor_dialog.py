"""Doctor: what this machine has, and the reason for what is absent."""

from __future__ import annotations

from typing import Any

from PySide6.QtWidgets import QApplication, QDialog, QPushButton, QTextBrowser, QVBoxLayout, QWidget

from lfcal_gui.jobs import Jobs
from lfcal_gui.models import doctor_html, doctor_text
from lfcal_gui.theme import style_sheet
from lfcal_gui.widgets import line

__all__ = ["DoctorDialog"]

SIZE = (640, 620)


class DoctorDialog(QDialog):
    """Shows what ``lfcal doctor`` tells; looked up in the background, so it lives as long as its window."""

    def __init__(self, jobs: Jobs, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Doctor")
        self.setStyleSheet(style_sheet())
        self.resize(*SIZE)
        self._found: dict[str, Any] = {}
        self.view = QTextBrowser()
        self.view.setAccessibleName("what this machine has")
        self.view.setPlainText("looking …")
        self.copy, close = QPushButton("Copy text"), QPushButton("Close")
        self.copy.setToolTip("Put it on the clipboard, for a report of a problem")
        close.setToolTip("Close this window; menu Help opens it again")
        self.copy.setEnabled(False)
        self.copy.clicked.connect(lambda: QApplication.clipboard().setText(doctor_text(self._found)))
        close.clicked.connect(self.close)
        column = QVBoxLayout(self)
        column.addWidget(self.view, 1)
        column.addLayout(line(QWidget(), self.copy, close, stretch=0))
        self._jobs = jobs

    def look(self) -> None:
        """Look what is there now."""
        from lfcal.cli import examine

        self.setStyleSheet(style_sheet())
        self._jobs.compute("doctor", examine, self._show, self.view.setPlainText)

    def _show(self, found: dict[str, Any]) -> None:
        self._found = found
        self.view.setHtml(doctor_html(found))
        self.copy.setEnabled(True)
