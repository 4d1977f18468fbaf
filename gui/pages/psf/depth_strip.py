"""Depth-plane sums side by side: one picture a plane, click to choose it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QSize, Qt, Signal
from PySide6.QtGui import QIcon, QImage, QPixmap
from PySide6.QtWidgets import QListWidget, QListWidgetItem, QWidget

from gui.models.display import Display, colour_table, levels_of, to_uint8
from lfcal.units import format_length

__all__ = ["DepthStrip", "to_pixmap"]


def to_pixmap(image: NDArray[Any], side: int, colour_map: str = "viridis") -> QPixmap:
    """Return ``image`` as a square picture of ``side`` points."""
    data = to_uint8(image, Display(), levels_of(image))
    rgba = np.ascontiguousarray(colour_table(colour_map)[data])
    picture = QImage(rgba.data, rgba.shape[1], rgba.shape[0], 4 * rgba.shape[1], QImage.Format.Format_RGBA8888)
    return QPixmap.fromImage(picture.copy()).scaled(
        side, side, Qt.AspectRatioMode.KeepAspectRatio, Qt.TransformationMode.SmoothTransformation
    )


class DepthStrip(QListWidget):
    """A row of small pictures with the depth under each.

    Signals
    -------
    chosen(z)
        Another plane was clicked.
    """

    chosen = Signal(int)

    def __init__(self, side: int = 76, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._side = side
        self.setViewMode(QListWidget.ViewMode.IconMode)
        self.setFlow(QListWidget.Flow.LeftToRight)
        self.setWrapping(False)
        self.setMovement(QListWidget.Movement.Static)
        self.setIconSize(QSize(side, side))
        self.setGridSize(QSize(side + 18, side + 26))
        self.setFixedHeight(side + 38)
        self.setVerticalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setToolTip("Depth-plane sums: the aperture as seen from each depth. Click to choose a plane.")
        self.currentRowChanged.connect(self._changed)

    def set_planes(self, depths: NDArray[np.float64]) -> None:
        """Make one empty place per plane."""
        self.blockSignals(True)
        self.clear()
        blank = QPixmap(self._side, self._side)
        blank.fill(Qt.GlobalColor.transparent)
        for z, depth in enumerate(depths):
            item = QListWidgetItem(QIcon(blank), format_length(float(depth)))
            item.setToolTip(f"plane {z}, z = {format_length(float(depth))}")
            self.addItem(item)
        self.blockSignals(False)

    def set_sum(self, z: int, image: NDArray[Any]) -> None:
        """Show the sum of plane ``z``."""
        item = self.item(z)
        if item is not None:
            picture = to_pixmap(image, self._side)
            icon = QIcon(picture)
            icon.addPixmap(picture, QIcon.Mode.Selected)  # else the one that is chosen is tinted
            item.setIcon(icon)

    def set_current(self, z: int) -> None:
        """Mark a plane without reporting it."""
        self.blockSignals(True)
        self.setCurrentRow(z)
        self.blockSignals(False)

    def _changed(self, row: int) -> None:
        if row >= 0:
            self.chosen.emit(row)
