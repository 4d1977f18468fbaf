"""Plots drawn with pyqtgraph, without its menus: a view box with two axes."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import pyqtgraph as pg
from PySide6.QtGui import QFont, QFontMetricsF
from PySide6.QtWidgets import QGraphicsGridLayout, QGraphicsSceneResizeEvent, QSizePolicy

from lfcal_gui.models import minus
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets.words import shortened

GRID = 38
"""Opacity of grid lines, from 0 to 255."""


def _lines(name: str, metrics: QFontMetricsF, room: float, most: int) -> list[str]:
    """Return the name of an axis wrapped into at most ``most`` lines, shortened to the available length (px)."""
    words = name.split(" ")
    if most == 1 or len(words) == 1 or metrics.horizontalAdvance(name) <= room:
        return [shortened(name, metrics, room)]
    fits = [n for n in range(1, len(words)) if metrics.horizontalAdvance(" ".join(words[:n])) <= room]
    first = max(fits, default=1)
    return [shortened(" ".join(part), metrics, room) for part in (words[:first], words[first:])]


class Axis(pg.AxisItem):
    """An axis whose tick labels are the values themselves, without SI prefixes.

    A name that is longer than a vertical axis is wrapped into two lines; a longer one is shortened before its unit.
    """

    def updateAutoSIPrefix(self) -> None:
        """Redraw the tick labels for the new range, without an SI prefix."""
        self.picture = None
        self.update()

    def tickStrings(self, values: list[float], scale: float, spacing: float) -> list[str]:
        """Return the tick labels, with minus signs."""
        return [minus(words) for words in super().tickStrings(values, scale, spacing)]

    def labelString(self) -> str:
        """Return the name as rich text, shortened to the available length."""
        name = self.labelText
        room = self.size().height() if self.orientation in ("left", "right") else self.size().width()
        lines = [name]
        if name and room:
            most = 2 if self.orientation == "left" and self.fixedWidth is None else 1
            lines = _lines(name, QFontMetricsF(self.label.font()), room, most)
        self.labelText = "<br>".join(lines)
        try:
            shown: str = super().labelString()
            self.setToolTip(name if " ".join(lines) != name else "")
        finally:
            self.labelText = name
        return shown

    def _updateWidth(self) -> None:
        """Reserve enough width for a name of two lines."""
        super()._updateWidth()
        if self.fixedWidth is None and "\n" in self.label.toPlainText():
            width = self.maximumWidth() + 4
            self.setMaximumWidth(width)
            self.setMinimumWidth(width)

    def resizeEvent(self, event: QGraphicsSceneResizeEvent | None = None) -> None:
        """Fit the name to the new size."""
        if self.label is not None and self.label.isVisible():  # None once it is closed
            self.label.setHtml(self.labelString())
            if self.orientation == "left":
                self._updateWidth()  # it may have another number of lines
        super().resizeEvent(event)


ROOM = 14.0
"""Vertical distance between tick labels (screen px)."""

DIGIT, BETWEEN = 7.0, 8.0
"""Width of a digit, and smallest gap between neighbouring tick labels (px)."""

ABOVE = 6
"""Space above an axis for the upper half of the last tick label (px)."""


class PixelAxis(Axis):
    """An axis of pixels or positions, with ticks only at whole numbers in its range."""

    span: tuple[float, float] | None = None

    def cover(self, first: float, count: int, step: float = 1.0) -> None:
        """Show ticks for ``count`` pixels from ``first``; with fractional positions, show the usual ticks."""
        whole = step == 1 and float(first).is_integer()
        span = (first, first + count - 1) if whole else None
        if span != self.span:
            self.span = span
            self.picture = None
            self.update()

    def tickValues(self, minVal: float, maxVal: float, size: float) -> list[tuple[float, list[float]]]:
        """Return the ticks as pairs of spacing and positions."""
        found: list[tuple[float, list[float]]] = super().tickValues(minVal, maxVal, size)
        if self.span is None:
            return found
        first, last = sorted((minVal, maxVal))  # rows count downwards
        low, high = max(first, self.span[0]), min(last, self.span[1])
        apart = size / max(last - first, 1e-9)
        room = ROOM
        if self.orientation in ("bottom", "top"):
            room = max(ROOM, DIGIT * max(len(f"{end:.0f}") for end in (low, high)) + BETWEEN)
        # pyqtgraph spaces numbers for the whole axis, not for many in a small part of it
        wide = [pair for pair in found if pair[0] >= 1 and pair[0] * apart >= room]
        kept = [(step, [v for v in values if low <= v <= high]) for step, values in wide]
        if any(values for _, values in kept):
            return kept
        # zoomed in until pyqtgraph has only ticks within a pixel, or out until one number fits
        each = max(1, math.ceil(room / max(apart, 1e-9)))
        return [(float(each), [float(k) for k in range(math.ceil(low), math.floor(high) + 1, each)])]


FEW, MOST = 2.5, 8
"""Largest number of decades with labels between them, and largest number of labelled decades."""


NUMBERS = ((1, 2, 5), *(tuple(k / n for k in range(n, 10 * n)) for n in (1, 2, 10)))
"""Labelled numbers of a decade; the fewer decades are visible, the more numbers are labelled."""


class DecadeAxis(Axis):
    """An axis of decimal logarithms, labelled with the numbers themselves.

    The labels are 1, 2 and 5 times powers of ten, or only powers of ten if there are many.
    """

    def tickValues(self, minVal: float, maxVal: float, size: float) -> list[tuple[float, list[float]]]:
        """Return the ticks as pairs of spacing and positions."""
        low, high = math.floor(minVal), math.ceil(maxVal)
        seen: list[float] = []
        if maxVal - minVal <= FEW:
            for numbers in NUMBERS:
                ticks = [decade + math.log10(number) for decade in range(low, high + 1) for number in numbers]
                seen = [tick for tick in ticks if minVal <= tick <= maxVal]
                if len(seen) > 1:
                    break
        else:
            ticks = [float(d) for d in range(low, high + 1, math.ceil((high - low) / MOST))]
            seen = [tick for tick in ticks if minVal <= tick <= maxVal]
        return [(1.0, seen)]

    def tickStrings(self, values: list[float], scale: float, spacing: float) -> list[str]:
        """Return the tick labels."""
        return [f"{10**value:g}" for value in values]


NUMBER_PX = 12.5
"""Vertical distance between tick labels (px)."""


class UprightAxis(Axis):
    """A vertical axis whose tick labels do not overlap, even if it is short."""

    def tickValues(self, minVal: float, maxVal: float, size: float) -> list[tuple[float, list[float]]]:
        """Return the ticks as pairs of spacing and positions."""
        found: list[tuple[float, list[float]]] = super().tickValues(minVal, maxVal, size)
        evenly = found[:1] if self.logMode else found
        places = sorted(value for _, values in evenly for value in values)
        if len(places) < 2:
            return found
        scale = size / max(abs(maxVal - minVal), 1e-300)
        half = NUMBER_PX / 2 / scale  # pyqtgraph omits a number that does not fit
        low, high = min(minVal, maxVal) + half, max(minVal, maxVal) - half

        def legible(chosen: list[float]) -> bool:
            apart = all((b - a) * scale >= NUMBER_PX for a, b in pairwise(chosen))
            return apart and sum(low <= value <= high for value in chosen) > 1

        if legible(sorted(found[0][1])):
            return found
        step = min(b - a for a, b in pairwise(places))
        for each in (1, 2, 3, 4, 5, 10, 20, 50):
            kept = [value for value in places if round(value / step) % each == 0]
            if legible(kept):
                return [(each * step, kept)]
        middle = (minVal + maxVal) / 2
        return [(step, [min(places, key=lambda value: abs(value - middle))])]


class Plot(pg.GraphicsWidget):
    """A view box with an axis on the left and one below, which is created much faster than a `pyqtgraph.PlotItem`.

    Parameters
    ----------
    box
        The view box; by default a new one.
    left, bottom
        The axes; by default axes of numbers.
    margin, top
        Room round the box and its axes, and above them (px).
    """

    def __init__(
        self,
        box: pg.ViewBox | None = None,
        *,
        left: Axis | None = None,
        bottom: Axis | None = None,
        margin: int = 1,
        top: int = 1,
    ) -> None:
        super().__init__()
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self.vb = pg.ViewBox(enableMenu=False) if box is None else box
        self.legend: pg.LegendItem | None = None
        self.items: list[Any] = []
        self._log = False, False
        self._grid = False
        self._axes: dict[str, Axis] = {}
        self._layout = QGraphicsGridLayout(self)
        self._layout.setContentsMargins(margin, max(margin, top), margin, margin)
        self._layout.setSpacing(0)
        self._layout.addItem(self.vb, 0, 1)
        self._layout.setRowStretchFactor(0, 100)
        self._layout.setColumnStretchFactor(1, 100)
        self.set_axes(left or UprightAxis("left"), bottom or Axis("bottom"))

    # -- axes ------------------------------------------------------------------------------------------
    def set_axes(self, *axes: Axis) -> None:
        """Replace the axes."""
        for axis in axes:
            side = axis.orientation
            old = self._axes.get(side)
            if old is not None:
                self._layout.removeItem(old)
                old.unlinkFromView()
                old.setParentItem(None)
                if old.scene() is not None:
                    old.scene().removeItem(old)
            self._axes[side] = axis
            self._layout.addItem(axis, *((0, 0) if side == "left" else (1, 1)))
            axis.linkToView(self.vb)
            axis.setZValue(0.5)  # above pictures, below what is drawn over them
            axis.setGrid(GRID if self._grid else False)
            # an axis that also shrinks would resize the picture, which changes its numbers, and so on without end
            axis.setStyle(autoReduceTextSpace=False, maxTickLevel=1)

    def getAxis(self, side: str) -> Axis:
        """Return the axis ``"left"`` or ``"bottom"``."""
        return self._axes[side]

    def name_axes(self, across: str, down: str) -> None:
        """Name both axes, with their units."""
        for side, text in (("bottom", across), ("left", down)):
            self._axes[side].setLabel(text)
            self._axes[side].resizeEvent()  # else the new label stays where the old one was centred

    def show_grid(self) -> None:
        """Show grid lines."""
        self._grid = True
        for axis in self._axes.values():
            axis.setGrid(GRID)

    def set_log(self, *, x: bool, y: bool) -> None:
        """Set whether decimal logarithms of the curves are drawn."""
        self._log = x, y
        for one in (*self.items, *self._axes.values()):
            if hasattr(one, "setLogMode"):
                one.setLogMode(x, y)
        self.vb.enableAutoRange()

    # -- content ---------------------------------------------------------------------------------------
    def addItem(self, item: Any, *, ignoreBounds: bool = False) -> None:
        """Add an item; with ``ignoreBounds``, it does not affect the range of the axes."""
        self.items.append(item)
        self.vb.addItem(item, ignoreBounds=ignoreBounds)
        if hasattr(item, "setLogMode"):
            item.setLogMode(*self._log)
        if self.legend is not None and isinstance(item, pg.PlotDataItem) and item.name():
            self.legend.addItem(item, item.name())

    def removeItem(self, item: Any) -> None:
        """Remove an item."""
        self.items.remove(item)
        self.vb.removeItem(item)
        if self.legend is not None:
            self.legend.removeItem(item)

    def curve(self, *values: Any, **options: Any) -> pg.PlotDataItem:
        """Add a curve with the options of `pyqtgraph.PlotDataItem`."""
        item = pg.PlotDataItem(*values, **options)
        self.addItem(item)
        return item

    def add_legend(self) -> None:
        """Add a legend for the curves added later."""
        self.legend = pg.LegendItem(offset=(-8, 8))
        self.legend.setParentItem(self.vb)

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        theme = current_theme()
        font = QFont()
        font.setPointSizeF(8.5)
        for axis in self._axes.values():
            axis.setPen(theme.line)
            axis.setTextPen(theme.text)
            axis.setTickFont(font)
            axis.label.setDefaultTextColor(pg.mkColor(theme.muted))
        if self.legend is not None:
            self.legend.setLabelTextColor(theme.text)
            for _, label in self.legend.items:  # existing texts would keep their colour
                label.setText(label.text, color=theme.text)


def count_pixels(
    plot: Plot, shape: tuple[int, ...], origin: tuple[float, float] = (0.0, 0.0), step: float = 1.0
) -> None:
    """Label the axes of ``plot`` with the pixels of a picture of a given shape whose first pixel is at ``origin``."""
    for side, first, count in (("left", origin[0], shape[0]), ("bottom", origin[1], shape[1])):
        axis = plot.getAxis(side)
        assert isinstance(axis, PixelAxis)
        axis.cover(first, count, step)
