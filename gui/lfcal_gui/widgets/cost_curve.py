"""What accuracy costs: measured points, the efficient ones joined, and the error asked for as a line to drag."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise, product
from typing import Any

import pyqtgraph as pg
from PySide6.QtCore import QLineF, QPointF, QRectF, Qt, Signal
from PySide6.QtGui import QFocusEvent, QKeyEvent
from PySide6.QtWidgets import QHBoxLayout, QVBoxLayout

from lfcal_gui.models import ChartPoint
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets._axes import DecadeAxis
from lfcal_gui.widgets.cards import button
from lfcal_gui.widgets.plots import LinePlot, line_px
from lfcal_gui.widgets.words import ElidedLabel

SIZE, RING = 10, 20
"""Diameter of a point, and of the ring around the one in use (px)."""

LEFT = 64
"""Width of the axis of errors (px): its numbers change while it is measured, the chart is not to jump."""

LEAST, MOST = -2.0, 2.0
"""Decimal logarithms of the errors (%) between which the line is dragged."""

STEP = 0.05
"""Decades that the line moves by a key."""

NOT_MEASURED = "Measure to see error and cost of each setting."

ANCHORS = ((0.0, 1.0), (1.0, 0.0), (0.0, 0.0), (1.0, 1.0))
"""Corner of a name that lies at its point, best first: right above, left below, right below, left above."""

BOUNDED = QLineF.IntersectionType.BoundedIntersection
PLACES = ((0.02, (0.0, 1.0)), (0.98, (1.0, 1.0)), (0.02, (0.0, 0.0)), (0.98, (1.0, 0.0)))
"""Positions along the line of its label, and the label's corner there, best first: left and right above, then below."""


def _rank(point: ChartPoint) -> tuple[bool, bool, bool]:
    """Return the order in which points are named."""
    return not point.picked, not point.in_use, not point.efficient


class CostCurve(LinePlot):
    """Error against cost, both logarithmic. A ring marks the chosen point, and a square the one in use.

    A click on a point uses its setting; the line is the error asked for. By keyboard: Left and Right go from point to
    point, Return uses the one reached, Up and Down move the line.
    """

    chosen = Signal(int, arguments=["number"])
    """Use the point of this number."""
    moved = Signal(float, arguments=["error"])
    """Another error is asked for (a share)."""
    measure_asked = Signal()
    """Measure, or measure again."""

    def __init__(self) -> None:
        super().__init__("cost", "error (%)")
        self.plot.set_axes(DecadeAxis("bottom"), DecadeAxis("left"))
        self.plot.getAxis("left").setWidth(LEFT)
        self.plot.vb.setMouseEnabled(x=False, y=False)
        self.blank.show_blank(False)
        self.blank.show_blank(True)
        self.blank.words = NOT_MEASURED
        self._points: tuple[ChartPoint, ...] = ()
        self._reached: int | None = None
        self._asked = ""
        self.front = pg.PlotDataItem(antialias=True)
        self.limit = pg.InfiniteLine(angle=0, movable=True, bounds=(LEAST, MOST), label="")
        self.limit.sigDragged.connect(lambda line: self._move(line.value()))
        self.ring = pg.ScatterPlotItem(symbol="o", size=RING, brush=None)
        self.scatter = pg.ScatterPlotItem(hoverable=True, tip=lambda x, y, data: self._points[data].words)
        self.scatter.sigClicked.connect(self._clicked)
        for item in (self.front, self.limit, self.ring, self.scatter):
            self.plot.addItem(item)
        self.names: list[pg.TextItem] = []
        for signal in (self.plot.vb.sigRangeChanged, self.plot.vb.sigResized):
            signal.connect(lambda *_: self._place_names())
        self.set_labels("cost", "error (%)")
        self.graphics.setCursor(Qt.CursorShape.ArrowCursor)
        self.graphics.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setToolTip("Click a point to use its setting. Drag the dashed line to change the target error")
        self._add_foot()

    def _add_foot(self) -> None:
        self.status = ElidedLabel(role="hint")
        self.measure_button = button(
            "Measure",
            "Measure error and cost of each setting for this camera and plan (F5)",
            self.measure_asked.emit,
            "tight",
        )
        foot = QHBoxLayout()
        foot.addWidget(self.status, 1)
        foot.addWidget(self.measure_button)
        column = self.layout()
        assert isinstance(column, QVBoxLayout)
        column.addLayout(foot)

    # -- showing ---------------------------------------------------------------------------------------
    def show_points(self, points: Sequence[ChartPoint], log_percent: float, asked: str = "tolerance") -> None:
        """Show points, and what is ``asked`` for as a line at the decimal logarithm of an error in per cent."""
        if len(points) != len(self._points):
            self._reached = None
        self._points = tuple(points)
        self.blank.show_blank(not points)
        if not self.limit.moving:
            self.limit.setValue(log_percent)
        self._asked = f"{asked} {10**log_percent:.2g} %"
        self.limit.setVisible(bool(points))
        front = [point for point in points if point.efficient]
        self.front.setData([p.x for p in front], [p.y for p in front])
        self._draw()
        if points and not self.limit.moving:
            self._fit(log_percent)
        self._place_names()

    def show_status(self, words: str, button: str = "Measure") -> None:
        """Say how it was measured, and what the button does; empty: it is being measured."""
        self.status.setText(words)
        self.measure_button.setText(button or "Measuring …")
        self.measure_button.setEnabled(bool(button))

    def _draw(self) -> None:
        theme, points = current_theme(), self._points
        # draw important points last, since equal points hide each other
        order = sorted(range(len(points)), key=lambda k: (points[k].picked, points[k].efficient))
        self.scatter.setData(
            [
                {
                    "pos": (points[k].x, points[k].y),
                    "data": k,
                    "size": SIZE,
                    "brush": pg.mkBrush(theme.accent if points[k].efficient else theme.panel),
                    "pen": pg.mkPen(theme.accent if points[k].efficient else theme.muted, width=line_px(1.2)),
                }
                for k in order
            ]
        )
        ringed = [k for k, point in enumerate(points) if point.picked]
        used = [k for k, point in enumerate(points) if point.in_use]
        reached = [k for k in (self._reached,) if k is not None and self.hasFocus()]
        spots = [(k, theme.text, "o") for k in ringed] + [(k, theme.accent, "o") for k in reached]
        spots += [(k, theme.text, "s") for k in used]
        self.ring.setData(
            [
                {"pos": (points[k].x, points[k].y), "pen": pg.mkPen(tone, width=line_px(2)), "symbol": symbol}
                for k, tone, symbol in spots
            ]
        )

    def _fit(self, log_percent: float) -> None:
        """Show all points and the line, with at least a decade along each axis: one point alone has no range."""
        xs, ys = [p.x for p in self._points], [*(p.y for p in self._points), log_percent]
        for values, name in ((xs, "x"), (ys, "y")):
            middle, half = (min(values) + max(values)) / 2, max(0.5, (max(values) - min(values)) / 2)
            bounds = (middle - 1.15 * half, middle + 1.15 * half)
            self.plot.vb.setRange(**{f"{name}Range": bounds}, padding=0.02)

    def _place_names(self) -> None:
        """Write names where they cover neither points nor each other; those that matter come first."""
        for item in self.names:
            self.plot.removeItem(item)
        self.names = []
        box, theme, metrics = self.plot.vb, current_theme(), self.fontMetrics()
        inside = box.sceneBoundingRect()
        at = [box.mapViewToScene(QPointF(point.x, point.y)) for point in self._points]
        taken = [QRectF(p.x() - SIZE / 2, p.y() - SIZE / 2, SIZE, SIZE) for p in at]
        if self.limit.isVisible():
            taken.append(self._place_label(taken))
            height = box.mapViewToScene(QPointF(0, self.limit.value())).y()
            taken.append(QRectF(inside.left(), height - 1, inside.width(), 2))
        for k in sorted(range(len(at)), key=lambda k: (*_rank(self._points[k]), k)):
            point = self._points[k]
            wide, high = metrics.horizontalAdvance(point.name) + 8, metrics.height() + 8
            for across, down in ANCHORS:
                x, y = at[k].x() + (SIZE / 2 if across == 0 else -SIZE / 2), at[k].y() + (-2 if down else 2)
                area = QRectF(x - across * wide, y - down * high, wide, high)
                if inside.contains(area) and not any(area.intersects(other) for other in taken):
                    break
            else:
                continue
            taken.append(area)
            tone = theme.text if any(not low for low in _rank(point)) else theme.muted
            item = pg.TextItem(point.name, color=tone, anchor=(across, down))
            item.setPos(box.mapSceneToView(QPointF(x, y)))
            self.plot.addItem(item, ignoreBounds=True)
            self.names.append(item)

    def _place_label(self, points: Sequence[QRectF]) -> QRectF:
        """Write the label of the line where neither points nor the curve cross it, and return its area.

        Where there is no room for its words, the number alone is shown.
        """
        label, area = self.limit.label, QRectF()
        front = [self.plot.vb.mapViewToScene(QPointF(p.x, p.y)) for p in self._points if p.efficient]
        curve = [QLineF(*ends) for ends in pairwise(front)]
        self.limit.boundingRect()  # computes the ends of the line, which place its label
        for words, (position, corner) in product((self._asked, self._asked.partition(" ")[2]), PLACES):
            label.setFormat(words)
            label.anchors = [corner, corner]
            label.setPosition(position)
            area = label.mapRectToScene(label.boundingRect())
            # a line that crosses the area crosses a diagonal
            across = QLineF(area.topLeft(), area.bottomRight()), QLineF(area.topRight(), area.bottomLeft())
            crossed = any(a.intersects(b)[0] == BOUNDED for a, b in product(curve, across))
            if not crossed and not any(area.intersects(point) for point in points):
                break
        return area

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        super().apply_theme()
        theme = current_theme()
        if hasattr(self, "names"):
            self.front.setPen(pg.mkPen(theme.accent, width=line_px(1.6)))
            self.limit.setPen(pg.mkPen(theme.fair, width=line_px(1.4), style=Qt.PenStyle.DashLine))
            self.limit.setHoverPen(pg.mkPen(theme.fair, width=line_px(2.4)))
            self.limit.label.setColor(theme.fair)
            self._draw()
            self._place_names()

    # -- choosing --------------------------------------------------------------------------------------
    def _move(self, log_percent: float) -> None:
        log_percent = min(max(log_percent, LEAST), MOST)
        self.moved.emit(float(f"{10**log_percent:.2g}") / 100)

    def _clicked(self, _: Any, spots: Any, *__: Any) -> None:
        if len(spots):
            self.chosen.emit(int(spots[0].data()))

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Go from point to point, use one, or move the line."""
        key, points = event.key(), self._points
        if not points:
            super().keyPressEvent(event)
        elif key in (Qt.Key.Key_Left, Qt.Key.Key_Right):
            step = 1 if key == Qt.Key.Key_Right else -1
            picked = next((k for k, point in enumerate(points) if point.picked), -1)
            begun = picked if self._reached is None else self._reached
            self._reached = min(max(begun + step, 0), len(points) - 1)
            self.status.setText(points[self._reached].words.replace("\n", "; "))
            self._draw()
        elif key in (Qt.Key.Key_Return, Qt.Key.Key_Enter, Qt.Key.Key_Space) and self._reached is not None:
            self.chosen.emit(self._reached)
        elif key in (Qt.Key.Key_Up, Qt.Key.Key_Down):
            self._move(self.limit.value() + (STEP if key == Qt.Key.Key_Up else -STEP))
        else:
            super().keyPressEvent(event)

    def focusInEvent(self, event: QFocusEvent) -> None:
        """Show the point that the keyboard reached."""
        super().focusInEvent(event)
        self._draw()

    def focusOutEvent(self, event: QFocusEvent) -> None:
        """Show it no longer."""
        super().focusOutEvent(event)
        self._draw()

    def table_lines(self, between: str) -> Iterator[str]:
        """Yield every point."""
        yield "# cost, error (%), chosen, in use, efficient, point\n"
        for point in self._points:
            marks = (f"{int(mark)}" for mark in (point.picked, point.in_use, point.efficient))
            cells = (f"{10**point.x:.9g}", f"{10**point.y:.9g}", *marks, point.words.splitlines()[0])
            yield between.join(cells) + "\n"
