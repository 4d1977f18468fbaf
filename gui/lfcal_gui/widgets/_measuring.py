"""Measurements in a picture: contrast, profile along a line, statistics of a region."""

from __future__ import annotations

from typing import Any

import pyqtgraph as pg
from PySide6.QtCore import Qt, QTimer
from PySide6.QtGui import QCloseEvent
from PySide6.QtWidgets import QDialog, QLabel, QVBoxLayout

from lfcal_gui.models import line_profile, minus, region_numbers
from lfcal_gui.theme import style_sheet
from lfcal_gui.widgets.cards import heading
from lfcal_gui.widgets.contrast import Contrast
from lfcal_gui.widgets.plots import LinePlot

LINE, REGION = "#ffb000", "#56b4e9"
SIZE = (430, 560)
WAIT_MS = 30
"""Shortest interval between two measurements of a changing picture (ms)."""


class Measuring(QDialog):
    """Dialog with the contrast of a picture, and with measurements along a line and in a rectangle that the user drags.

    Parameters
    ----------
    view
        The `lfcal_gui.widgets.picture.Picture` to measure. When the dialog is closed, the contrast is kept, and line
        and rectangle are removed.
    """

    def __init__(self, view: Any) -> None:
        super().__init__(view)
        self.setWindowTitle("Contrast, profile, region")
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self.setStyleSheet(style_sheet())
        self.resize(*SIZE)
        self.view = view
        self.contrast = Contrast(view)
        self.profile = LinePlot("along the line (px)", view.quantity)
        self.profile_words, self.region_words = QLabel(), QLabel()
        for label in (self.profile_words, self.region_words):
            label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
            label.setWordWrap(True)
        self._build()
        self._add_tools()
        self._timer = QTimer(self, singleShot=True, interval=WAIT_MS)
        self._timer.timeout.connect(self.measure)
        view.changed.connect(self._timer.start)
        self.measure()

    def _build(self) -> None:
        column = QVBoxLayout(self)
        column.addWidget(heading("Contrast: drag the two handles"))
        column.addWidget(self.contrast)
        column.addWidget(heading("Profile: drag the ends of the line in the image"))
        column.addWidget(self.profile, 1)
        column.addWidget(self.profile_words)
        column.addWidget(heading("Region: drag the rectangle in the image"))
        column.addWidget(self.region_words)

    def _add_tools(self) -> None:
        """Place line and rectangle in the middle of the visible part of the picture."""
        (left, right), (top, bottom) = self.view.box.viewRange()
        width, height = right - left, bottom - top
        middle = (top + bottom) / 2
        self.line = pg.LineSegmentROI(
            [(left + 0.2 * width, middle), (right - 0.2 * width, middle)], pen=pg.mkPen(LINE, width=2)
        )
        self.region = pg.RectROI(
            (left + 0.4 * width, top + 0.6 * height), (0.2 * width, 0.2 * height), pen=pg.mkPen(REGION, width=2)
        )
        for tool in (self.line, self.region):
            self.view.box.addItem(tool)
            tool.sigRegionChanged.connect(lambda *_: self._timer.start())

    # -- measuring -------------------------------------------------------------------------------------
    def measure(self) -> None:
        """Measure the current picture."""
        image = self.view.values
        if image is None:
            self.profile.clear()
            self.profile_words.setText("no image")
            self.region_words.setText("")
            return
        (row, column), step = self.view.shot.origin, self.view.shot.step
        ends = [self.line.mapToParent(handle.pos()) for handle in self.line.getHandles()]
        first, last = ((float((p.y() - row) / step), float((p.x() - column) / step)) for p in ends)
        found = line_profile(image, first, last)
        self.profile.set_curve("line", found.distance, found.values)
        self.profile_words.setText(found.words())
        place, size = self.region.pos(), self.region.size()
        rows = ((place.y() - row) / step, (place.y() + size.y() - row) / step)
        columns = ((place.x() - column) / step, (place.x() + size.x() - column) / step)
        numbers = region_numbers(image, rows, columns)
        words = "no pixel in the rectangle" if numbers is None else numbers.words(self.view.quantity)
        self.region_words.setText(minus(words))

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        self.profile.apply_theme()

    def closeEvent(self, event: QCloseEvent) -> None:
        """Remove line and rectangle from the picture."""
        self._take_away()
        super().closeEvent(event)

    def reject(self) -> None:
        """Close when Escape is pressed."""
        self._take_away()
        super().reject()

    def _take_away(self) -> None:
        self._timer.stop()
        for tool in (self.line, self.region):
            if tool.scene() is not None:
                self.view.box.removeItem(tool)
