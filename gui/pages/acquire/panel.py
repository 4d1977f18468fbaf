"""Acquire: the two tabs."""

from __future__ import annotations

from PySide6.QtWidgets import QTabWidget

from gui.jobs import Jobs
from gui.pages.acquire.record_panel import RecordPanel
from gui.pages.acquire.setup_panel import SetupPanel

__all__ = ["AcquirePanel"]


class AcquirePanel(QTabWidget):
    """Set up, then record."""

    def __init__(self, jobs: Jobs) -> None:
        super().__init__()
        self.setup, self.record = SetupPanel(jobs), RecordPanel(jobs)
        self.setDocumentMode(True)
        self.addTab(self.setup, "Set up")
        self.addTab(self.record, "Record")

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        self.setup.apply_theme()
        self.record.apply_theme()
