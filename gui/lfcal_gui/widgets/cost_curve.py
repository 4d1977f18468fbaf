"""Chart of error against cost: measured points, a curve through the efficient ones, and a draggable target error."""

from __future__ import annotations

import math
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

MOST_NAMED = 60
"""Number of points above which only the chosen and the used point are labelled: placing more labels takes seconds."""

SIZE, RING = 10, 20
"""Diameter of a point, and of the ring around the one in use (px)."""

NUMBERS = 42
"""Fixed width of the tick labels of errors (px), so that the chart does not move during the measurement."""

LEAST, MOST = -2.0, 2.0
"""Decimal logarithms of the errors (%) between which the line is dragged."""

STEP = 0.05
"""Decades by which a key moves the line."""

NOT_MEASURED = "Measure to see error and cost of each setting."

SIDES = ((1, -1), (-1, 1), (1, 1), (-1, -1), (1, 0), (-1, 0), (0, -1), (0, 1))
"""Directions from a point to its label, best first: right above, left below, right below, left above, and between."""

MARGIN = 4
"""Space around the text of a label (px)."""

CROSSED = 10.0
"""Covered area of another label or point that is as bad as covering the curve (px²)."""

BOUNDED = QLineF.IntersectionType.BoundedIntersection
PLACES = ((0.02, (0.0, 1.0)), (0.98, (1.0, 1.0)), (0.02, (0.0, 0.0)), (0.98, (1.0, 0.0)))
"""Positions along the line of its label, and the label's corner there, best first: left and right above, then below."""


def _rank(point: ChartPoint) -> tuple[bool, bool, bool]:
    """Return the sort key of the order in which points are labelled."""
    return not point.picked, not point.in_use, not point.efficient


def _areas(at: QPointF, wide: float, high: float, reach: float) -> Iterator[QRectF]:
    """Yield possible areas of a label, best first; ``reach`` is the radius of the point or its ring (px)."""
    for across, down in SIDES:
        x = at.x() + across * (max(SIZE / 2, reach - MARGIN / 2) if down else reach) + (across - 1) / 2 * wide
        y = at.y() + down * (2 if across else reach - MARGIN) + (down - 1) / 2 * high
        yield QRectF(x, y, wide, high)


def _distance(area: QRectF, point: QPointF) -> float:
    """Return the distance of a point from the text in an area (px)."""
    words = area.adjusted(MARGIN, MARGIN, -MARGIN, -MARGIN)
    across = max(words.left() - point.x(), 0.0, point.x() - words.right())
    return math.hypot(across, max(words.top() - point.y(), 0.0, point.y() - words.bottom()))


def _crossed(area: QRectF, lines: Sequence[QLineF]) -> bool:
    """Return whether a line crosses or ends in the text of an area, and thus crosses a diagonal of the area."""
    words = area.adjusted(MARGIN, MARGIN, -MARGIN, -MARGIN)
    diagonals = QLineF(words.topLeft(), words.bottomRight()), QLineF(words.topRight(), words.bottomLeft())
    return any(one.intersects(other)[0] == BOUNDED for one, other in product(lines, diagonals))


class CostCurve(LinePlot):
    """Error against cost, both logarithmic. A ring marks the chosen point, and a square the one in use.

    A click on a point uses its setting; the line is the target error. By keyboard: Left and Right go from point to
    point, Return uses the one reached, Up and Down move the line.
    """

    chosen = Signal(int, arguments=["number"])
    """The user chose the point with this number."""
    moved = Signal(float, arguments=["error"])
    """The user moved the target error (a fraction)."""
    measure_asked = Signal()
    """The user asks for a measurement."""

    def __init__(self) -> None:
        super().__init__("cost", "error (%)")
        self.plot.set_axes(DecadeAxis("bottom"), DecadeAxis("left"))
        self.plot.getAxis("left").setStyle(autoExpandTextSpace=False, tickTextWidth=NUMBERS)
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
        self.setAccessibleName("Error over cost")
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
        """Show points, and the target error as a line.

        ``log_percent`` is the decimal logarithm of the target error in per cent, and ``asked`` its name in the label.
        """
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
        """Show how the curve was measured; ``button`` is the text of the button, empty during the measurement."""
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
        """Fit the axes to all points and the line, with at least one decade along each axis."""
        xs, ys = [p.x for p in self._points], [*(p.y for p in self._points), log_percent]
        for values, name in ((xs, "x"), (ys, "y")):
            middle, half = (min(values) + max(values)) / 2, max(0.5, (max(values) - min(values)) / 2)
            bounds = (middle - 1.15 * half, middle + 1.15 * half)
            self.plot.vb.setRange(**{f"{name}Range": bounds}, padding=0.02)

    def _place_names(self) -> None:
        """Place labels next to their points where they cover nothing; the chosen and the used point always have one."""
        for item in self.names:
            self.plot.removeItem(item)
        self.names = []
        box, points = self.plot.vb, self._points
        at = [box.mapViewToScene(QPointF(point.x, point.y)) for point in points]
        reach = [(RING if point.picked or point.in_use else SIZE) / 2 for point in points]
        taken = [QRectF(p.x() - r, p.y() - r, 2 * r, 2 * r) for p, r in zip(at, reach, strict=True)]
        curve = [QLineF(*ends) for ends in pairwise(p for p, point in zip(at, points, strict=True) if point.efficient)]
        inside = box.sceneBoundingRect()
        height = box.mapViewToScene(QPointF(0, self.limit.value())).y()
        line = [QRectF(inside.left(), height - 1, inside.width(), 2)] if self.limit.isVisible() else []
        order = sorted(range(len(at)), key=lambda k: (*_rank(points[k]), k))
        marked = [k for k in order if points[k].picked or points[k].in_use]
        for k in marked:
            area = self._area_of(k, at, reach[k], taken + line, curve)[1]
            taken.append(area)
            self._write_name(points[k], area)
        if self.limit.isVisible():
            taken.append(self._place_label(taken, curve))
        for k in order[len(marked) :] if len(points) <= MOST_NAMED else ():
            cost, area = self._area_of(k, at, reach[k], taken + line, curve)
            if cost < 1e-3:  # sums of areas are rounded
                taken.append(area)
                self._write_name(points[k], area)

    def _area_of(
        self, k: int, at: Sequence[QPointF], reach: float, taken: Sequence[QRectF], curve: Sequence[QLineF]
    ) -> tuple[float, QRectF]:
        """Return the cost of the best area for the label of a point (px²: covered area and penalties), and the area."""
        metrics, inside = self.fontMetrics(), self.plot.vb.sceneBoundingRect()
        wide = metrics.horizontalAdvance(self._points[k].name) + 2 * MARGIN
        found = []
        for area in _areas(at[k], wide, metrics.height() + 2 * MARGIN, reach):
            overlaps = [area.intersected(other) for n, other in enumerate(taken) if n != k]
            cost = sum(one.width() * one.height() for one in overlaps)
            cost += CROSSED * _crossed(area, curve)
            clear = _distance(area, at[k]) + SIZE / 2
            cost += CROSSED * any(_distance(area, other) < clear for n, other in enumerate(at) if n != k)
            shown = area.intersected(inside)
            cost += 10 * (area.width() * area.height() - shown.width() * shown.height())
            found.append((cost, area))
        return min(found, key=lambda one: one[0])

    def _write_name(self, point: ChartPoint, area: QRectF) -> None:
        tone = current_theme().text if any(not low for low in _rank(point)) else current_theme().muted
        item = pg.TextItem(point.name, color=tone)
        item.setPos(self.plot.vb.mapSceneToView(area.topLeft()))
        self.plot.addItem(item, ignoreBounds=True)
        self.names.append(item)

    def _place_label(self, taken: Sequence[QRectF], curve: Sequence[QLineF]) -> QRectF:
        """Place the label of the line where it overlaps no other label, no point and no curve; return its area.

        If there is not enough space, only the number is shown.
        """
        label, area = self.limit.label, QRectF()
        self.limit.boundingRect()  # computes the ends of the line, which place its label
        for words, (position, corner) in product((self._asked, self._asked.partition(" ")[2]), PLACES):
            label.setFormat(words)
            label.anchors = [corner, corner]
            label.setPosition(position)
            area = label.mapRectToScene(label.boundingRect())
            if not _crossed(area, curve) and not any(area.intersects(one) for one in taken):
                break
        return area

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
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
        """Mark the point selected by keyboard."""
        super().focusInEvent(event)
        self._draw()

    def focusOutEvent(self, event: QFocusEvent) -> None:
        """Remove the mark of the point selected by keyboard."""
        super().focusOutEvent(event)
        self._draw()

    def table_lines(self, between: str) -> Iterator[str]:
        """Yield all points as table lines."""
        yield "# cost, error (%), chosen, in use, efficient, point\n"
        for point in self._points:
            marks = (f"{int(mark)}" for mark in (point.picked, point.in_use, point.efficient))
            cells = (f"{10**point.x:.9g}", f"{10**point.y:.9g}", *marks, point.words.splitlines()[0])
            yield between.join(cells) + "\n"
