"""Line plots with a common style: labelled axes with units, theme colours, copy and save."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pyqtgraph as pg
from numpy.typing import ArrayLike
from PySide6.QtCore import Qt
from PySide6.QtGui import QGuiApplication
from PySide6.QtWidgets import QApplication, QVBoxLayout, QWidget

from lfcal_gui.saving import ask_target, write_file
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets._axes import DecadeAxis, PixelAxis, Plot
from lfcal_gui.widgets._blank import Blank
from lfcal_gui.widgets.picture_menu import offer_menu, save_picture

LINES = ("#2a8fc4", "#d9772b", "#2aa37b", "#c76aa0", "#8b97a8", "#c9a227")
"""Line colours that colour-blind readers can distinguish, on light and dark backgrounds."""

RED_LINES = ("#ff5a45", "#a83a2c", "#ff8a5c", "#c9301c", "#7d2a20", "#ff2010")
"""Line colours in the red theme, in the same order."""


def shown_tone(tone: str) -> str:
    """Return the colour of a line of ``tone``; in the red theme, a shade of red."""
    if not current_theme().red:
        return tone
    return RED_LINES[LINES.index(tone)] if tone in LINES else RED_LINES[0]


def line_px(width: float) -> float:
    """Return the width of a line in screen pixels, because the pens of pyqtgraph do not scale with the screen."""
    screen = QGuiApplication.primaryScreen()
    return width * (1.0 if screen is None else screen.devicePixelRatio())


MANY = 10**9
"""Upper limit of counts on an axis."""

MARGIN = 10
"""Margin around a plot (px)."""


class LinePlot(QWidget):
    """Plot of curves over a common x, which can be clicked and saved. With ``counted``, x is a count from 0."""

    def __init__(
        self, xlabel: str, ylabel: str, *, legend: bool = False, counted: bool = False, parent: QWidget | None = None
    ) -> None:
        super().__init__(parent)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        self.graphics = pg.GraphicsView()
        self.graphics.setMinimumSize(120, 110)
        layout.addWidget(self.graphics)
        below = PixelAxis("bottom") if counted else None
        if below is not None:
            below.cover(0, MANY)
        self.plot = Plot(bottom=below, margin=MARGIN)
        self.graphics.setCentralItem(self.plot)
        self.plot.show_grid()
        if legend:
            self.plot.add_legend()
        self._name_axes(xlabel, ylabel)
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
        """Draw or replace a curve; NaN leaves a gap. Without ``line``, only symbols are drawn."""
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
        self._curves[name] = self.plot.curve(
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
        """Make axes logarithmic, labelled with the numbers themselves."""
        sides = [side for side, decades in (("bottom", x), ("left", y)) if decades]
        self.plot.set_axes(*map(DecadeAxis, sides))
        self.plot.set_log(x=x, y=y)
        self.set_labels(*self._labels)

    def set_labels(self, xlabel: str, ylabel: str) -> None:
        """Label both axes with quantity and unit."""
        self._name_axes(xlabel, ylabel)
        self.apply_theme()

    def _name_axes(self, xlabel: str, ylabel: str) -> None:
        self._labels = (xlabel, ylabel)
        self.plot.name_axes(xlabel, ylabel)
        self.graphics.setAccessibleName(" over ".join(filter(None, (ylabel, xlabel))))

    def remove_curve(self, name: str) -> None:
        """Remove a curve."""
        curve = self._curves.pop(name, None)
        if curve is not None:
            self.plot.removeItem(curve)
            self._known.discard(name)
            self.blank.show_blank(not self._known)

    def clear(self) -> None:
        """Remove all curves."""
        for name in list(self._curves):
            self.remove_curve(name)

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        self.graphics.setBackground(current_theme().panel)
        self.plot.apply_theme()
        self.blank.apply_theme()
        if self._red != current_theme().red:
            self._red = current_theme().red
            for name in self._curves:
                self._paint(name)

    def _paint(self, name: str) -> None:
        """Draw a curve in its requested colour; in the red theme, in a shade of red."""
        tone, curve = shown_tone(self._tones[name]), self._curves[name]
        if curve.opts["pen"] is not None:
            pen = pg.mkPen(curve.opts["pen"])
            pen.setColor(pg.mkColor(tone))
            curve.setPen(pen)
        curve.setSymbolBrush(tone)

    def _entries(self) -> list[tuple[str, Any]]:
        return [
            ("Show all", lambda: self.plot.vb.autoRange()),
            ("Copy values", self.copy_data),
            ("Save data …", lambda: self.save_data()),
        ]

    def save_picture(self, path: str = "") -> None:
        """Save the plot as PNG or SVG."""
        save_picture(self, "plot", path)

    def copy_data(self) -> None:
        """Copy all curves to the clipboard, for a spreadsheet."""
        QApplication.clipboard().setText("".join(self.table_lines("\t")))

    def save_data(self, path: str = "") -> None:
        """Save all curves as text with the columns x and y of each."""
        path = path or ask_target(self, "Save data", "plot.csv", "Text (*.csv)")
        if path:
            write_file(self, path, lambda part: part.write_text("".join(self.table_lines(",")), encoding="utf-8"))

    def table_lines(self, between: str) -> Iterator[str]:
        """Yield the curves as table lines of x and y, with ``between`` as the column separator."""
        for name, curve in self._curves.items():
            yield f"# {name}: {self._labels[0]}, {self._labels[1]}\n"
            # the values, not their logarithms on a logarithmic axis
            x, y = curve.getOriginalDataset()
            if x is not None:
                yield from (f"{a:.9g}{between}{b:.9g}\n" for a, b in zip(x, y, strict=True))
