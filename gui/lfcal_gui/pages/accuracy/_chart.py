"""Error against cost of one place, both logarithmic: a point for each rung, the Pareto front as a line."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import pyqtgraph as pg
from PySide6.QtCore import Qt, Signal

from lfcal_gui.pages.accuracy.model import ChartPoint
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets import DecadeAxis, LinePlot, line_px

__all__ = ["ParetoChart"]

SIZE, PICKED_SIZE = 10, 22
LEFT = 64
"""Width of the axis of errors (px): its numbers change while it is measured, the chart is not to jump."""


class ParetoChart(LinePlot):
    """Points that are clicked.

    Signals
    -------
    chosen(number)
        A point was clicked, by its number.
    """

    chosen = Signal(int)

    def __init__(self) -> None:
        super().__init__("cost", "error (%)")
        self.plot.setAxisItems({side: DecadeAxis(side) for side in ("bottom", "left")})
        self.plot.getAxis("left").setWidth(LEFT)
        self.plot.showGrid(x=True, y=True, alpha=0.15)
        self.blank.show_blank(False)
        self.blank.show_blank(True)
        self._points: tuple[ChartPoint, ...] = ()
        self.blank.words = "Press Measure."
        self.front = pg.PlotDataItem()
        self.limit = pg.InfiniteLine(angle=0, movable=False)
        self.scatter = pg.ScatterPlotItem(hoverable=True, tip=lambda x, y, data: self._points[data].words)
        self.scatter.sigClicked.connect(self._clicked)
        for item in (self.front, self.limit, self.scatter):
            self.plot.addItem(item)
        self.set_labels("cost", "error (%)")
        self.graphics.setCursor(Qt.CursorShape.ArrowCursor)

    def show_points(self, points: Sequence[ChartPoint], log_percent: float) -> None:
        """Show points, and the error asked about as a line at ``log_percent``, its decimal logarithm in per cent."""
        self._points = tuple(points)
        self.blank.show_blank(not self._points)
        self.limit.setValue(log_percent)
        front = [point for point in points if point.efficient]
        self.front.setData([p.x for p in front], [p.y for p in front])
        theme = current_theme()
        # what matters is drawn last: points of the same numbers hide each other
        order = sorted(range(len(points)), key=lambda k: (points[k].picked, points[k].efficient))
        self.scatter.setData(
            [
                {
                    "pos": (point.x, point.y),
                    "data": number,
                    "size": PICKED_SIZE if point.picked else SIZE,
                    "symbol": "star" if point.picked else "o",
                    "brush": pg.mkBrush(self._colour(point)),
                    "pen": pg.mkPen(theme.panel, width=line_px(0.8)),
                }
                for number, point in ((k, points[k]) for k in order)
            ]
        )
        self.limit.setVisible(bool(points))
        if points:
            self._fit(log_percent)

    def _fit(self, log_percent: float) -> None:
        """Show all points and the line, with at least a decade along each axis: one point alone has no range."""
        xs, ys = [p.x for p in self._points], [*(p.y for p in self._points), log_percent]
        for values, name in ((xs, "x"), (ys, "y")):
            middle, half = (min(values) + max(values)) / 2, max(0.5, (max(values) - min(values)) / 2)
            bounds = (middle - 1.08 * half, middle + 1.08 * half)
            self.plot.getViewBox().setRange(**{f"{name}Range": bounds}, padding=0.02)

    def _colour(self, point: ChartPoint) -> str:
        theme = current_theme()
        if point.picked:
            return theme.good
        return theme.accent if point.efficient else theme.muted

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        super().apply_theme()
        theme = current_theme()
        if hasattr(self, "front"):
            self.front.setPen(pg.mkPen(theme.accent, width=line_px(1.6)))
            self.limit.setPen(pg.mkPen(theme.fair, width=line_px(1.2), style=Qt.PenStyle.DashLine))

    def _clicked(self, _: Any, spots: Any, *__: Any) -> None:
        if len(spots):
            self.chosen.emit(int(spots[0].data()))

    def table_lines(self, between: str) -> Iterator[str]:
        """Yield every point."""
        yield "# cost, error (%), efficient, rung\n"
        for point in self._points:
            cells = (f"{10**point.x:.9g}", f"{10**point.y:.9g}", f"{int(point.efficient)}", point.words.splitlines()[0])
            yield between.join(cells) + "\n"
