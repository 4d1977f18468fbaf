"""The colours of a picture beside it, with their values: a strip, an axis and a name, and nothing else.

`pyqtgraph.ColorBarItem` is a whole plot with a view, four axes and its menus: half of the time in which a page with
pictures was made and resized.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import pyqtgraph as pg
from numpy.typing import NDArray
from PySide6.QtCore import Qt
from PySide6.QtGui import QImage, QPainter, QPixmap
from PySide6.QtWidgets import QGraphicsGridLayout, QSizePolicy

from lfcal_gui.models import colour_table, shades
from lfcal_gui.theme import current_theme

__all__ = ["ColourBar", "bar_table", "theme_table"]

VALUES_PX = 45
"""Room for the numbers beside an upright bar."""


def theme_table(colour_map: str) -> NDArray[np.uint8]:
    """Return the colours ``(256, 4)`` of a picture in the theme in use: in the dark of a lab from black to red."""
    return colour_table(colour_map, red=current_theme().red)


def bar_table(colour_map: str, scale: str, levels: tuple[float, float]) -> NDArray[np.uint8]:
    """Return the colours ``(256, 4)`` of a bar that is linear in the value from level to level, for a scaling."""
    # where the bar begins matters to a root and a logarithm alone
    return _bar_table(colour_map, scale, (0.0, 1.0) if scale == "linear" else levels, current_theme().red)


@lru_cache(maxsize=32)
def _bar_table(colour_map: str, scale: str, levels: tuple[float, float], red: bool) -> NDArray[np.uint8]:
    index = shades(np.linspace(*levels, 256), scale, levels)
    return colour_table(colour_map, red=red)[(index * 255).astype(int)]


class _Strip(pg.GraphicsWidget):
    """The colours, and a line about them."""

    def __init__(self, *, below: bool) -> None:
        super().__init__()
        self._below = below
        self._colours = QPixmap()

    def take(self, table: NDArray[np.uint8]) -> None:
        colours = np.ascontiguousarray(table[None] if self._below else table[::-1, None])  # high values at the top
        rows, columns = colours.shape[:2]
        image = QImage(colours.data, columns, rows, 4 * columns, QImage.Format.Format_RGBA8888)
        self._colours = QPixmap.fromImage(image.copy())
        self.update()

    def paint(self, painter: QPainter, *_: Any) -> None:
        area = self.rect()
        if not self._colours.isNull():
            painter.drawPixmap(area, self._colours, self._colours.rect().toRectF())
        painter.setPen(pg.mkPen(current_theme().line))
        painter.setBrush(Qt.BrushStyle.NoBrush)
        painter.drawRect(area)


class ColourBar(pg.GraphicsWidget):
    """Values to the right of an upright bar and its name to the left; or both under a bar that lies ``below``.

    Parameters
    ----------
    levels
        Values at its ends.
    width
        Thickness of the strip (px).
    label
        The quantity, with its unit.
    below
        Whether it lies under its picture.
    """

    def __init__(
        self, levels: tuple[float, float] = (0.0, 1.0), *, width: int = 12, label: str = "", below: bool = False
    ) -> None:
        super().__init__()
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        layout = QGraphicsGridLayout()
        layout.setContentsMargins(1, 1, 1, 1)
        layout.setSpacing(0)
        self.setLayout(layout)
        self._strip = _Strip(below=below)
        self.axis = pg.AxisItem("bottom" if below else "right")
        self.name_axis = self.axis
        if below:
            self._strip.setMinimumHeight(width)
            self._strip.setMaximumHeight(width)
            layout.addItem(self._strip, 0, 0)
            layout.addItem(self.axis, 1, 0)
        else:
            self._strip.setMinimumWidth(width)
            self._strip.setMaximumWidth(width)
            self.name_axis = pg.AxisItem("left", showValues=False)
            self.name_axis.setTicks([])
            for column, part in enumerate((self.name_axis, self._strip, self.axis)):
                layout.addItem(part, 0, column)
        for axis in {self.axis, self.name_axis}:
            axis.setStyle(maxTickLevel=1)
            # prefixes for the range on screen would scale the numbers
            axis.setSIPrefixEnableRanges(())
            axis.enableAutoSIPrefix(False)
        self._levels = levels
        self.axis.setRange(*levels)
        if label:
            self.set_label(label)
        self.visibleChanged.connect(self._make_room)
        self._make_room()
        self.apply_theme()

    def set_colours(self, table: NDArray[np.uint8]) -> None:
        """Show a table ``(256, 4)``, its first colour at the lowest value."""
        self._strip.take(table)

    def set_levels(self, levels: tuple[float, float]) -> None:
        """Show the values at both ends."""
        self._levels = levels
        self.axis.setRange(*levels)

    def levels(self) -> tuple[float, float]:
        """Return the values at both ends."""
        return self._levels

    def set_label(self, text: str) -> None:
        """Name the quantity, with its unit."""
        self.name_axis.setLabel(text)
        self.name_axis.resizeEvent()  # into its middle

    def label(self) -> str:
        """Return the name of the quantity."""
        text: str = self.name_axis.labelText
        return text

    def _make_room(self) -> None:
        """Give numbers and name the room that they do not take while they are hidden."""
        if self.name_axis is self.axis:
            self.axis.setHeight()
        else:
            self.axis.setWidth(VALUES_PX)
            self.name_axis.setWidth()

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        theme = current_theme()
        for axis in {self.axis, self.name_axis}:
            axis.setPen(theme.line)
            axis.setTextPen(theme.text)  # after the pen, which colours the name, too
        self._strip.update()
