"""Measure in a picture: contrast by its histogram, values along a line, numbers of a region."""

from __future__ import annotations

from typing import Any, Protocol

import pyqtgraph as pg
from numpy.typing import NDArray
from PySide6.QtCore import Qt, QTimer
from PySide6.QtGui import QCloseEvent
from PySide6.QtWidgets import QDialog, QLabel, QPushButton, QVBoxLayout, QWidget

from lfcal_gui.models import line_profile, region_numbers, value_histogram
from lfcal_gui.theme import style_sheet
from lfcal_gui.widgets.cards import heading, line
from lfcal_gui.widgets.plots import LinePlot

__all__ = ["Measurable", "Measuring"]

LINE, REGION = "#ffb000", "#56b4e9"
SIZE = (430, 640)
WAIT_MS = 30
"""Pictures that change faster are measured at this pace."""


class Measurable(Protocol):
    """A view of a picture that can be measured in."""

    plot: Any
    picture_changed: Any

    def measured(self) -> NDArray[Any] | None:
        """Return the picture ``(rows, columns)``."""
        ...

    def placed(self) -> tuple[tuple[float, float], float]:
        """Return the coordinates (row, column) of the first pixel's centre and the length of a pixel, in axis units."""
        ...

    def shown_levels(self) -> tuple[float, float]:
        """Return the values at the ends of the colours."""
        ...

    def set_contrast(self, levels: tuple[float, float] | None) -> None:
        """Show these values, whatever the page says; None: what the page says."""
        ...


class Measuring(QDialog):
    """A window beside a picture: handles for the contrast, a line and a rectangle that are dragged in the picture.

    Parameters
    ----------
    view
        The picture; contrast stays when the window is closed, line and rectangle go.
    value
        Name of the quantity with its unit.
    """

    def __init__(self, view: Any, value: str) -> None:
        assert isinstance(view, QWidget)
        super().__init__(view)
        self.setWindowTitle("Contrast, profile, region")
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self.setStyleSheet(style_sheet())
        self.resize(*SIZE)
        self.view = view
        self.histogram = LinePlot(value, "pixels")
        self.histogram.plot.setLogMode(False, True)
        self.handles = pg.LinearRegionItem(brush=pg.mkBrush(86, 180, 233, 50))
        self.handles.setZValue(10)
        self.histogram.plot.addItem(self.handles)
        self.profile = LinePlot("along the line (px)", value)
        self.profile_words, self.region_words = QLabel(), QLabel()
        for label in (self.profile_words, self.region_words):
            label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
            label.setWordWrap(True)
        self.whole = QPushButton("Automatic contrast")
        self.whole.setToolTip("Show what the page's own choice of scale shows")
        self.whole.clicked.connect(self._automatic)
        self._build()
        self._add_tools()
        self._timer = QTimer(self)
        self._timer.setSingleShot(True)
        self._timer.setInterval(WAIT_MS)
        self._timer.timeout.connect(self.measure)
        view.picture_changed.connect(self._timer.start)
        self.handles.sigRegionChanged.connect(self._contrast)
        self.measure()

    def _build(self) -> None:
        column = QVBoxLayout(self)
        column.addWidget(heading("Contrast: drag the two handles"))
        column.addWidget(self.histogram, 1)
        column.addLayout(line(self.whole, stretch=0))
        column.addWidget(heading("Profile: drag the ends of the line in the picture"))
        column.addWidget(self.profile, 1)
        column.addWidget(self.profile_words)
        column.addWidget(heading("Region: drag the rectangle in the picture"))
        column.addWidget(self.region_words)

    def _add_tools(self) -> None:
        """Put line and rectangle into the middle of what is seen of the picture."""
        (left, right), (top, bottom) = self.view.plot.vb.viewRange()
        width, height = right - left, bottom - top
        middle = (top + bottom) / 2
        self.line = pg.LineSegmentROI(
            [(left + 0.2 * width, middle), (right - 0.2 * width, middle)], pen=pg.mkPen(LINE, width=2)
        )
        self.region = pg.RectROI(
            (left + 0.4 * width, top + 0.6 * height), (0.2 * width, 0.2 * height), pen=pg.mkPen(REGION, width=2)
        )
        for tool in (self.line, self.region):
            self.view.plot.addItem(tool)
            tool.sigRegionChanged.connect(lambda *_: self._timer.start())

    # -- measuring -------------------------------------------------------------------------------------
    def measure(self) -> None:
        """Measure the picture that is shown now."""
        image = self.view.measured()
        if image is None:
            self.histogram.clear()
            self.profile.clear()
            self.profile_words.setText("no picture")
            self.region_words.setText("")
            return
        middles, counts = value_histogram(image)
        self.histogram.set_curve("pixels", middles, counts.clip(0.5))
        self._show_levels()
        (row, column), step = self.view.placed()
        ends = [self.line.mapToParent(handle.pos()) for handle in self.line.getHandles()]
        first, last = ((float((p.y() - row) / step), float((p.x() - column) / step)) for p in ends)
        found = line_profile(image, first, last)
        self.profile.set_curve("line", found.distance, found.values)
        self.profile_words.setText(found.words())
        place, size = self.region.pos(), self.region.size()
        rows = ((place.y() - row) / step, (place.y() + size.y() - row) / step)
        columns = ((place.x() - column) / step, (place.x() + size.x() - column) / step)
        numbers = region_numbers(image, rows, columns)
        self.region_words.setText("no pixel within the rectangle" if numbers is None else numbers.words())

    def _show_levels(self) -> None:
        self.handles.blockSignals(True)
        self.handles.setRegion(self.view.shown_levels())
        self.handles.blockSignals(False)

    def _contrast(self) -> None:
        low, high = self.handles.getRegion()
        if high > low:
            self.view.set_contrast((float(low), float(high)))

    def _automatic(self) -> None:
        self.view.set_contrast(None)
        self._show_levels()

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        for plot in (self.histogram, self.profile):
            plot.apply_theme()

    def closeEvent(self, event: QCloseEvent) -> None:
        """Take line and rectangle from the picture."""
        self._take_away()
        super().closeEvent(event)

    def reject(self) -> None:
        """Close by Escape."""
        self._take_away()
        super().reject()

    def _take_away(self) -> None:
        self._timer.stop()
        for tool in (self.line, self.region):
            if tool.scene() is not None:
                self.view.plot.removeItem(tool)
