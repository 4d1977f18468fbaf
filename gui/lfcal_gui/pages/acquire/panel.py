"""Record > Rig: what the camera sees, or the session as it grows; next to it stage, devices and the recording."""

from __future__ import annotations

from PySide6.QtWidgets import QHBoxLayout, QPushButton, QStackedWidget, QVBoxLayout, QWidget

from lfcal_gui.jobs import Jobs
from lfcal_gui.pages.acquire.record_panel import RecordPanel
from lfcal_gui.pages.acquire.setup_panel import SetupPanel
from lfcal_gui.widgets import Folded, column_area, line

__all__ = ["AcquirePanel"]

INSPECTOR = 304
"""Width of what stands right of the pictures (px)."""

SESSION = "The session as it grows: positions, depth-plane sum, curves"


class AcquirePanel(QWidget):
    """The picture, and next to it all that is set."""

    def __init__(self, jobs: Jobs) -> None:
        super().__init__()
        self.setup, self.record = SetupPanel(jobs), RecordPanel()
        self.session = QPushButton("Session")
        self.session.setToolTip(SESSION)
        self.views, self.bars = QStackedWidget(), QStackedWidget()
        for view in (self.setup, self.record):
            self.views.addWidget(view)
            self.bars.addWidget(view.tools)
        choices = (self.setup.near, self.setup.whole, self.session)
        for button in choices:
            button.setCheckable(True)
            button.setAutoExclusive(True)
        self.setup.whole.setChecked(True)
        self.session.toggled.connect(lambda on: self._show(int(on)))
        self.devices = Folded("Devices", "Choose camera and stage, and their settings")
        self.adjust = Folded("Adjust the rig", "Scale and axis of the stage, exposures, white and dark frames")
        self.recording = Folded("Recording", "What is recorded, in which order, and what happens at a fault")
        for fold, widgets in (
            (self.devices, (self.setup.devices, self.setup.faults)),
            (self.adjust, (self.setup.adjust,)),
            (self.recording, (self.record.how,)),
        ):
            for widget in widgets:
                fold.column.addWidget(widget)
        left = QVBoxLayout()
        left.setSpacing(4)
        left.addLayout(line(*choices, self.bars, stretch=3))
        left.addWidget(self.views, 1)
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        row.setSpacing(8)
        row.addLayout(left, 1)
        parts = (self.record.status_card, self.setup.pair, self.setup.stage, self.devices, self.adjust, self.recording)
        row.addWidget(column_area(INSPECTOR, *parts, dense=True))

    def setCurrentWidget(self, view: QWidget) -> None:
        """Show the live view (``setup``) or the session (``record``)."""
        (self.session if view is self.record else self.setup.looked_at).setChecked(True)

    def _show(self, k: int) -> None:
        for stack in (self.views, self.bars):
            stack.setCurrentIndex(k)

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        self.setup.apply_theme()
        self.record.apply_theme()
