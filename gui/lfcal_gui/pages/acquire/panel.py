"""Acquire: the two tabs."""

from __future__ import annotations

from PySide6.QtWidgets import QTabWidget

from lfcal_gui.jobs import Jobs
from lfcal_gui.pages.acquire.record_panel import RecordPanel
from lfcal_gui.pages.acquire.setup_panel import SetupPanel

__all__ = ["AcquirePanel"]


SETUP = "Connect camera and stage, focus, find scale and exposure, take white and dark frames"
RECORD = "Record the positions of the plan, follow them, go on with an interrupted session"


class AcquirePanel(QTabWidget):
    """Set up, then record."""

    def __init__(self, jobs: Jobs) -> None:
        super().__init__()
        self.setup, self.record = SetupPanel(jobs), RecordPanel(jobs)
        self.setDocumentMode(True)
        for tab, title, tip in ((self.setup, "Set up", SETUP), (self.record, "Record", RECORD)):
            self.setTabToolTip(self.addTab(tab, title), tip)

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        self.setup.apply_theme()
        self.record.apply_theme()
