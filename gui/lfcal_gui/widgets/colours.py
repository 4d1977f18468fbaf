"""Colours of pictures in the current theme."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import Qt
from PySide6.QtGui import QColor, QImage, QPen

from lfcal_gui.models import DisplaySettings, Levels, colour_table, shades
from lfcal_gui.theme import current_theme


def theme_table(colour_map: str) -> NDArray[np.uint8]:
    """Return the colours ``(256, 4)`` of a picture in the current theme: in the dark-lab theme from black to red."""
    return colour_table(colour_map, red=current_theme().red)


def ramp(display: DisplaySettings, levels: Levels, width: int) -> QImage:
    """Return a row of ``width`` colours, linear in the value from level to level."""
    index = (shades(np.linspace(*levels, width), display.scale, levels) * 255).astype(int)
    return row_of(theme_table(display.colour_map)[index])


def outline_pen(colour: QColor, width: float, style: Qt.PenStyle) -> QPen:
    """Return the pen of an outline. Its dashes are as long as the gaps, which show the outline below."""
    pen = QPen(colour, width, style, Qt.PenCapStyle.FlatCap)
    if style == Qt.PenStyle.DashLine:  # Qt's dashes with their square caps leave gaps of one width
        pen.setDashPattern([4, 4])
    return pen


def row_of(colours: NDArray[np.uint8]) -> QImage:
    """Return colours ``(n, 4)`` as a picture of one row."""
    row = np.ascontiguousarray(colours)
    return QImage(row.data, len(row), 1, 4 * len(row), QImage.Format.Format_RGBA8888).copy()
