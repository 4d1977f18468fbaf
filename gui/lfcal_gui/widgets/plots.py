"""Line plots in the house style: labelled axes with units, theme colours, copy and save."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyqtgraph as pg
from numpy.typing import ArrayLike
from PySide6.QtCore import Qt
from PySide6.QtGui import QFont, QGuiApplication
from PySide6.QtWidgets import QApplication, QVBoxLayout, QWidget

from lfcal_gui.saving import ask_target, write_file
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets._blank import Blank
from lfcal_gui.widgets._pixel_axis import PixelAxis
from lfcal_gui.widgets.picture_menu import offer_menu, save_picture

LINES = ("#2a8fc4", "#d9772b", "#2aa37b", "#c76aa0", "#8b97a8", "#c9a227")
"""Line colours that stay apart for colour-blind readers, on light and on dark."""

RED_LINES = ("#ff5a45", "#a83a2c", "#ff8a5c", "#c9301c", "#7d2a20", "#ff2010")
"""The same where all is red."""


def shown_tone(tone: str) -> str:
    """Return the colour in which a line of ``tone`` is drawn: one of red where all is red."""
    if not current_theme().red:
        return tone
    return RED_LINES[LINES.index(tone)] if tone in LINES else RED_LINES[0]


def line_px(width: float) -> float:
    """Return how many pixels of the screen a line of ``width`` has: pyqtgraph's pens do not grow with its scale."""
    screen = QGuiApplication.primaryScreen()
    return width * (1.0 if screen is None else screen.devicePixelRatio())


def style_axes(plot: pg.PlotItem, xlabel: str, ylabel: str) -> None:
    """Label both axes of ``plot``; SI prefixes are never made up, and the room for numbers only grows."""
    for side, text in (("bottom", xlabel), ("left", ylabel)):
        axis = plot.getAxis(side)
        # disabling alone keeps the prefix of the present range: ticks 1000 times too large or small
        axis.setSIPrefixEnableRanges(())
        axis.enableAutoSIPrefix(False)
        # an axis that also shrinks would resize the picture, which changes its numbers, and so on without end
        axis.setStyle(autoReduceTextSpace=False, maxTickLevel=1)
        axis.setLabel(text)
        axis.resizeEvent()  # else the new label stays where the old one was centred
    for side in ("right", "top"):
        # these axes are hidden, but would still update their labels at each change of the range
        plot.getAxis(side).unlinkFromView()


def theme_plot(graphics: pg.GraphicsView, *plots: pg.PlotItem) -> None:
    """Give a plot the colours of the theme in use."""
    theme = current_theme()
    graphics.setBackground(theme.panel)
    font = QFont()
    font.setPointSizeF(8.5)
    for plot in plots:
        for side in ("bottom", "left"):
            axis = plot.getAxis(side)
            axis.setPen(theme.line)
            axis.setTextPen(theme.text)
            axis.setTickFont(font)
            axis.label.setDefaultTextColor(pg.mkColor(theme.muted))
        legend = plot.legend
        if legend is not None:
            legend.setLabelTextColor(theme.text)
            for _, label in legend.items:  # existing texts would keep their colour
                label.setText(label.text, color=theme.text)


MANY = 10**9
"""More things than are ever counted."""

FEW, MOST = 2.5, 8
"""Decades up to which numbers between them are shown, and decades shown at most."""


NUMBERS = ((1, 2, 5), *(tuple(k / n for k in range(n, 10 * n)) for n in (1, 2, 10)))
"""Numbers of a decade that are shown, the more of them the less of it is seen."""


class DecadeAxis(pg.AxisItem):
    """An axis of decimal logarithms with the numbers themselves: 1, 2 and 5, or decades where there are many."""

    def tickValues(self, minVal: float, maxVal: float, size: float) -> list[tuple[float, list[float]]]:
        """Return where ticks are: pairs of their distance and their places."""
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
        """Return the numbers."""
        return [f"{10**value:g}" for value in values]


NUMBER_PX = 12.5
"""Room from one number to the next, one above the other (px)."""


class UprightAxis(pg.AxisItem):
    """An upright axis whose numbers do not lie over each other, however low it is."""

    def tickValues(self, minVal: float, maxVal: float, size: float) -> list[tuple[float, list[float]]]:
        """Return where ticks are: pairs of their distance and their places."""
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


def _axes(*, counted: bool) -> dict[str, pg.AxisItem]:
    """Return the axes of a plot; ``counted``: the lower one has whole numbers, half an iteration has no tick."""
    if not counted:
        return {"left": UprightAxis("left")}
    below = PixelAxis("bottom")
    below.cover(0, MANY)
    return {"left": UprightAxis("left"), "bottom": below}


class LinePlot(QWidget):
    """Curves over a common x; clicking and saving are built in. With ``counted`` x is a number of things, from 0."""

    def __init__(
        self, xlabel: str, ylabel: str, *, legend: bool = False, counted: bool = False, parent: QWidget | None = None
    ) -> None:
        super().__init__(parent)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        self.graphics = pg.GraphicsLayoutWidget()
        self.graphics.setMinimumSize(120, 110)
        layout.addWidget(self.graphics)
        self.plot: pg.PlotItem = self.graphics.addPlot(enableMenu=False, axisItems=_axes(counted=counted))
        self.plot.hideButtons()
        self.plot.showGrid(x=True, y=True, alpha=0.15)
        if legend:
            self.plot.addLegend(offset=(-8, 8))
        style_axes(self.plot, xlabel, ylabel)
        self._labels = (xlabel, ylabel)
        self._curves: dict[str, pg.PlotDataItem] = {}
        self._known: set[str] = set()
        self._tones: dict[str, str] = {}
        self._red = current_theme().red
        self.blank = Blank(self.graphics, self.plot.vb, self.plot)
        self.blank.show_blank(True)
        offer_menu(self, lambda: "plot", self._entries)
        self.apply_theme()

    def set_curve(
        self,
        name: str,
        x: ArrayLike,
        y: ArrayLike,
        *,
        colour: str = "",
        symbol: str | None = None,
        dashed: bool = False,
        line: bool = True,
    ) -> None:
        """Draw or replace a curve, of what is known of it; without ``line`` only its symbols."""
        values = np.asarray(x, float), np.asarray(y, float)
        known = bool((np.isfinite(values[0]) & np.isfinite(values[1])).any())
        if not known:  # pyqtgraph fails on data without finite values
            values = np.zeros(0), np.zeros(0)
        (self._known.add if known else self._known.discard)(name)
        self.blank.show_blank(not self._known)
        if name in self._curves:
            self._curves[name].setData(*values)
            return
        tone = colour or LINES[len(self._curves) % len(LINES)]
        style = Qt.PenStyle.DashLine if dashed else Qt.PenStyle.SolidLine
        pen = pg.mkPen(tone, width=line_px(1.8), style=style) if line else None
        self._tones[name] = tone
        self._curves[name] = self.plot.plot(
            *values,
            pen=pen,
            name=name,
            symbol=symbol,
            symbolSize=16 if symbol == "star" else 6 if line else 9,
            symbolBrush=tone,
            symbolPen=None,
        )
        if current_theme().red:
            self._paint(name)

    def set_decades(self, *, x: bool = False, y: bool = False) -> None:
        """Make axes logarithmic, with the numbers themselves."""
        sides = [side for side, decades in (("bottom", x), ("left", y)) if decades]
        self.plot.setAxisItems({side: DecadeAxis(side) for side in sides})
        self.plot.setLogMode(x=x, y=y)
        self.plot.showGrid(x=True, y=True, alpha=0.15)
        self.set_labels(*self._labels)

    def set_labels(self, xlabel: str, ylabel: str) -> None:
        """Name both quantities, with their units."""
        self._labels = (xlabel, ylabel)
        style_axes(self.plot, xlabel, ylabel)
        self.apply_theme()

    def remove_curve(self, name: str) -> None:
        """Take a curve away."""
        curve = self._curves.pop(name, None)
        if curve is not None:
            self.plot.removeItem(curve)
            self._known.discard(name)
            self.blank.show_blank(not self._known)

    def clear(self) -> None:
        """Take all curves away."""
        for name in list(self._curves):
            self.remove_curve(name)

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        theme_plot(self.graphics, self.plot)
        self.blank.apply_theme()
        if self._red != current_theme().red:
            self._red = current_theme().red
            for name in self._curves:
                self._paint(name)

    def _paint(self, name: str) -> None:
        """Give a curve the tone it was asked for, or one of red where all is red."""
        tone, curve = shown_tone(self._tones[name]), self._curves[name]
        if curve.opts["pen"] is not None:
            pen = pg.mkPen(curve.opts["pen"])
            pen.setColor(pg.mkColor(tone))
            curve.setPen(pen)
        curve.setSymbolBrush(tone)

    def _entries(self) -> list[tuple[str, Any]]:
        return [
            ("Show all", lambda: self.plot.autoRange()),
            ("Copy values", self.copy_data),
            ("Save data …", lambda: self.save_data()),
        ]

    def save_picture(self, path: str = "") -> None:
        """Write the plot as PNG or SVG."""
        save_picture(self, "plot", path)

    def copy_data(self) -> None:
        """Put all curves on the clipboard, for a spreadsheet."""
        QApplication.clipboard().setText("".join(self.table_lines("\t")))

    def save_data(self, path: str = "") -> None:
        """Write all curves as text: columns x and y of each."""
        path = path or ask_target(self, "Save data", "plot.csv", "Text (*.csv)")
        if path:
            write_file(self, path, self._write_curves)

    def _write_curves(self, part: Path) -> None:
        part.write_text("".join(self.table_lines(",")), encoding="utf-8")

    def table_lines(self, between: str) -> Iterator[str]:
        """Yield every curve as lines of x and y, with what stands ``between`` columns."""
        for name, curve in self._curves.items():
            yield f"# {name}: {self._labels[0]}, {self._labels[1]}\n"
            # the values, not their logarithms on a logarithmic axis
            x, y = curve.getOriginalDataset()
            if x is not None:
                yield from (f"{a:.9g}{between}{b:.9g}\n" for a, b in zip(x, y, strict=True))
