"""Pictures of a running session: depth-plane sum, error of H, curves in scan order."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import QSize, Qt
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QGridLayout, QLabel, QStackedWidget, QWidget

from lfcal_gui.models import Shot
from lfcal_gui.pages.acquire.model_recorder import ErrorCurve, RecordPicture
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets import (
    LINES,
    DecadeAxis,
    ElidedLabel,
    LinePlot,
    Picture,
    card,
    name_controls,
)

LEAST = 1e-3
"""Smallest error that is drawn on the logarithmic axis (%)."""

FEW = 24
"""Smallest number of positions spanned by the axis."""

STATED, ASIDE = LINES[0], LINES[1]

TITLE = (
    f"Error of H <span style='font-weight: normal'> <span style='color: {STATED}'>●</span> "
    f"estimated <span style='color: {ASIDE}'>◆</span> held out</span>"
)
"""Title of the card with the plot, which replaces a legend that would cover a narrow plot."""


class ErrorView(LinePlot):
    """Plot of the error of H per fit: its own estimate, the error at held-out positions, and the target error."""

    # before the rest is made the plot takes the theme's colours
    curve: ErrorCurve | None = None

    def __init__(self) -> None:
        super().__init__("positions recorded", "error of H (%)")
        self.plot.set_axes(DecadeAxis("left"))
        self.blank.show_blank(False)
        self.blank.show_blank(True)
        self.set_labels("positions recorded", "error of H (%)")
        self.setToolTip(
            "Estimated: error of H (relative L2) from the standard deviations of the fit. Held out: "
            "error at positions that are never fitted, ± 2 standard deviations; hollow symbols are "
            "limits. The session ends when the error is below the dashed line"
        )
        # behind the dots: both fits of one count are seen
        self.bars = pg.ErrorBarItem(x=np.zeros(0), y=np.zeros(0), beam=0.6, pen=pg.mkPen(ASIDE, width=1.4))
        self.stated = self.plot.curve(
            [],
            [],
            pen=pg.mkPen(STATED, width=1.8),
            symbol="o",
            symbolSize=7,
            symbolBrush=STATED,
            symbolPen=None,
        )
        self.aside = pg.ScatterPlotItem(size=9, symbol="d", pen=pg.mkPen(ASIDE), brush=ASIDE)
        self.wanted = pg.InfiniteLine(
            0.0,
            angle=0,
            pen=pg.mkPen(LINES[2], width=1.6, style=Qt.PenStyle.DashLine),
            label="target",
            labelOpts={"position": 0.06, "anchors": [(0, 1), (0, 1)], "color": LINES[2]},
        )
        for item in (self.bars, self.aside, self.wanted):
            self.plot.addItem(item)
        self.apply_theme()

    def show_curve(self, curve: ErrorCurve) -> None:
        """Show the error curve of the completed fits."""
        self.curve = curve
        self.blank.show_blank(False)
        x = np.array(curve.positions, float)
        stated, aside, wanted = (_log(np.array(v, float)) for v in (curve.stated, curve.aside, [curve.wanted]))
        self.stated.setData(x, stated)
        limit = np.isnan(np.array(curve.below, float))
        fill = {True: pg.mkBrush(current_theme().panel), False: pg.mkBrush(ASIDE)}
        pen = pg.mkPen(ASIDE, width=1.6)
        self.aside.setData(
            [
                {"pos": place, "pen": pen, "brush": fill[bool(only)]}
                for *place, only in zip(x.tolist(), aside.tolist(), limit.tolist(), strict=True)
            ]
        )
        known = ~limit
        values, below, above = (np.array(v, float)[known] for v in (curve.aside, curve.below, curve.above))
        self.bars.setData(
            x=x[known],
            y=aside[known],
            top=_log(values + above) - aside[known],
            bottom=aside[known] - _log(values - below),
        )
        self.wanted.setValue(float(wanted[0]))
        # before the first fit there is room above, for it begins far away
        every = np.concatenate([stated, aside, wanted, [] if len(x) else wanted + 1.0])
        low, high = float(every.min()) - 0.15, float(every.max()) + 0.15
        self.plot.vb.setYRange(min(low, high - 0.8), high, padding=0)
        self.plot.vb.setXRange(0.0, 1.08 * max([FEW, *curve.positions]), padding=0)

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        super().apply_theme()
        if self.curve is not None:
            self.show_curve(self.curve)

    def table_lines(self, between: str) -> Iterator[str]:
        """Yield the results of each fit as table lines."""
        curve = self.curve
        rows = [] if curve is None else zip(curve.positions, curve.stated, curve.aside, curve.above, strict=True)
        yield "# positions recorded, estimated error of H (%), error at held-out positions (%), ± (%); 0: a limit\n"
        for n, *errors in rows:
            yield between.join((str(n), *(f"{error:.6g}" for error in errors))) + "\n"


def _log(values: np.ndarray) -> np.ndarray:
    return np.log10(np.maximum(values, LEAST))


SUM = "Depth-plane sum"
NOTHING = "Nothing recorded in this plane yet."
NO_RESIDUAL = "Not measured with a target."
NO_SUM = "Each frame of a target shows many positions. The sum is available after assembling."

CURVES = {"energy": "Energy (counts)", "residual": "Residual (px)", "saturated": "Saturated (px)"}
LOW, GAP = 80, 8
"""Smallest height of a curve, and space between the pictures (px)."""

FLOORS = {"energy": 1.0, "residual": 0.1, "saturated": 1.0}
"""Smallest spans of the curves' axes, so that noise about zero is not enlarged."""


class RecordPictures(QWidget):
    """The depth-plane sum or the error of H, above three curves, which are hidden in a low window."""

    def __init__(self) -> None:
        super().__init__()
        self._reading = ""
        self.depth_sum = Picture("10³ counts")
        self.depth_sum.blank.words = NOTHING
        self.depth_sum.setToolTip("Sum of the plane's cutouts so far. It approaches the shape of the aperture")
        self.third = QStackedWidget()
        self.third.addWidget(self.depth_sum)
        self.curves = {
            key: LinePlot("position in scan order", words.lower(), counted=True) for key, words in CURVES.items()
        }
        tips = (
            "Light of each position above the background. It should be constant, except for the variation that the "
            "optics cause",
            "Lateral difference between measured and target position, in image pixels. Below 0.1 px is good",
            "Saturated pixels in each cutout. There should be none",
        )
        for plot, tip in zip(self.curves.values(), tips, strict=True):
            plot.setToolTip(tip)
        self._arrange()

    def _arrange(self) -> None:
        self.grid = grid = QGridLayout(self)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setSpacing(GAP)
        self.third_title = QLabel(SUM)
        self.depth_sum.graphics.setMinimumSize(120, 90)
        self.upper, column = card(self.third_title)
        column.addWidget(self.third, 1)
        grid.addWidget(self.upper, 0, 0, 1, 3)
        self.below = []
        for k, (key, plot) in enumerate(self.curves.items()):
            panel, column = card(ElidedLabel(CURVES[key]))
            self.below.append(panel)
            plot.graphics.setMinimumSize(120, LOW)
            for side in ("left", "bottom"):  # in a low window names at the axes would be cut
                plot.plot.getAxis(side).showLabel(False)
            column.addWidget(plot)
            grid.addWidget(panel, 1, k)
            grid.setColumnStretch(k, 1)
        grid.setRowStretch(0, 5)

    def minimumSizeHint(self) -> QSize:
        """Return the size without the curves."""
        return QSize(super().minimumSizeHint().width(), self.upper.minimumSizeHint().height())

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Show the curves if there is enough space."""
        least = self.upper.minimumSizeHint().height() + GAP + self.below[0].minimumSizeHint().height()
        room = event.size().height() >= least
        for panel in self.below:
            panel.setVisible(room)
        self.grid.setRowStretch(1, 3 if room else 0)  # an empty row keeps its share
        super().resizeEvent(event)

    @cached_property
    def error(self) -> ErrorView:
        """Plot of the error of H, for a session that ends at a target error."""
        view = ErrorView()
        name_controls(view)
        view.graphics.setMinimumSize(120, 90)
        self.third.addWidget(view)
        return view

    def show_picture(self, picture: RecordPicture) -> None:
        """Show sum and curves."""
        self._reading = picture.reading
        self._title_sum()
        self.depth_sum.blank.words = NO_SUM if picture.covered else picture.reading.capitalize() or NOTHING
        self.curves["residual"].blank.words = NO_RESIDUAL if picture.covered else "Nothing recorded yet."
        seen = picture.depth_sum / 1e3 if picture.depth_sum.any() else None
        self.depth_sum.set_shot(Shot(seen, name="depth_sum"))
        for k, (key, (x, y)) in enumerate(picture.curves.items()):
            self.curves[key].set_curve(key, x, y, colour=LINES[k])
            top = float(y.max(initial=0.0))
            self.curves[key].plot.vb.setYRange(0.0, 1.05 * max(top, FLOORS[key]), padding=0)

    def show_error(self, curve: ErrorCurve | None) -> None:
        """Show the error of H instead of the depth-plane sum; None: show the sum."""
        self.third.setCurrentWidget(self.depth_sum if curve is None else self.error)
        self._title_sum()
        if curve is not None and curve != self.error.curve:
            self.error.show_curve(curve)

    def _title_sum(self) -> None:
        """State in the title how much of the sum was read, if it is incomplete."""
        summed = f"{SUM}: {self._reading}" if self._reading else SUM
        self.third_title.setText(summed if self.third.currentWidget() is self.depth_sum else TITLE)

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        for view in (self.depth_sum, *self.curves.values()):
            view.apply_theme()
        if "error" in vars(self):
            self.error.apply_theme()
