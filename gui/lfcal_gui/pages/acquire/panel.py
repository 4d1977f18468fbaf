"""Record > Rig: live view or recording, above the planes; the inspector at the right."""

from __future__ import annotations

from PySide6.QtCore import QSize
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QStackedWidget, QVBoxLayout, QWidget

from lfcal_gui.pages.acquire.record_panel import RecordPanel
from lfcal_gui.pages.acquire.setup_panel import SetupPanel
from lfcal_gui.widgets import Folded, button, column_area, column_of, inspector_width, line, row_of

SESSION = "Progress of the session: depth-plane sum, error of H, curves"


class AcquirePanel(QWidget):
    """Panel with a picture, the planes below it, and the inspector."""

    def __init__(self, setup: SetupPanel) -> None:
        super().__init__()
        self.setup, self.record = setup, RecordPanel()
        self.session = button("Session", SESSION)
        self.views, self.bars = QStackedWidget(), QStackedWidget()
        for view in (self.setup, self.record):
            self.views.addWidget(view)
            self.bars.addWidget(view.tools)
        choices = (self.setup.near, self.setup.whole, self.session)
        for one in choices:
            one.setCheckable(True)
            one.setAutoExclusive(True)
        self.setup.whole.setChecked(True)
        self.session.toggled.connect(lambda on: self._show(int(on)))
        above = line(*choices, self.bars, stretch=len(choices))
        left = column_of(above, self.views, self.record.strip, spacing=4, stretch=1)
        row = row_of(left, of=self, spacing=8, stretch=0)
        parts = (self.setup.pair, self.setup.stage, self.record.progress, self.record.map_box)
        self.inspector = inspector = column_area(inspector_width(0), *parts, *self._folds(), dense=True)
        column = inspector.widget().layout()
        assert isinstance(column, QVBoxLayout)
        column.insertStretch(len(parts), 1)  # what is folded is at the foot
        row.addWidget(inspector)
        self.setup.results_changed.connect(self._say)
        self.setup.devices_asked.connect(self.devices.open)
        self.record.noted.connect(self._say)

    def minimumSizeHint(self) -> QSize:
        """Return the size with a narrow inspector, so that a wide window can be made narrow in one step."""
        least = super().minimumSizeHint()
        less = 0 if self.inspector.isHidden() else self.inspector.width() - inspector_width(0)
        return QSize(least.width() - less, least.height())

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Widen the inspector in a large window."""
        super().resizeEvent(event)
        self.inspector.setFixedWidth(inspector_width(self.width()))

    def _folds(self) -> tuple[Folded, ...]:
        self.devices = Folded("Devices", "Choose camera and stage, and their settings")
        self.adjust = Folded("Adjust the rig", "Scale and axis of the stage, exposures, white and dark frames")
        self.recording = Folded("Recording", "Folder, source, order, reaction to faults, and all buttons")
        for fold, widgets in (
            (self.devices, (self.setup.devices, self.setup.faults)),
            (self.adjust, (self.setup.adjust,)),
            (self.recording, (self.record.how,)),
        ):
            for widget in widgets:
                fold.column.addWidget(widget)
        self._say()
        return self.devices, self.adjust, self.recording

    def _say(self) -> None:
        """Show on the folded sections the connected devices, the adjusted items, and settings not at their defaults."""
        self.devices.head.say(self.setup.devices.backend.currentText() if self.setup.connected else "not connected")
        self.adjust.head.say(f"{len(self.setup.done)} of {len(self.setup.find_buttons)} done")
        changed = sum(len(form.changed) for form in self.record.forms)
        self.recording.head.say(f"{changed} changed" if changed else "defaults")

    def setCurrentWidget(self, view: QWidget) -> None:
        """Show the live view (``setup``) or the session (``record``)."""
        (self.session if view is self.record else self.setup.looked_at).setChecked(True)

    def _show(self, k: int) -> None:
        for stack in (self.views, self.bars):
            stack.setCurrentIndex(k)

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        self.setup.apply_theme()
        self.record.apply_theme()
