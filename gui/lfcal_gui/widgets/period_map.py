"""The period of the array as a map: drag over it to choose a source position."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pyqtgraph as pg
from numpy.typing import NDArray
from PySide6.QtCore import QEvent, QObject, QRectF, Qt, Signal
from PySide6.QtGui import QMouseEvent
from PySide6.QtWidgets import QVBoxLayout, QWidget

from lfcal_gui.models import levels_of
from lfcal_gui.widgets.colour_bar import theme_table
from lfcal_gui.widgets.picture_menu import offer_menu, table_entries
from lfcal_gui.widgets.pixel_axis import count_pixels, pixel_axes
from lfcal_gui.widgets.plots import style_axes, theme_plot

__all__ = ["PeriodMap"]

MISSING = (220, 60, 60, 255)


class PeriodMap(QWidget):
    """Show one value per source position ``(ny, nx)`` and let the user drag a cross over it.

    Signals
    -------
    chosen(y, x)
        The pointer is held on another position.
    """

    chosen = Signal(int, int)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._shape = (1, 1)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        self.graphics = pg.GraphicsLayoutWidget()
        self.graphics.setMinimumSize(120, 96)
        layout.addWidget(self.graphics)
        self.plot: pg.PlotItem = self.graphics.addPlot(axisItems=pixel_axes(), enableMenu=False)
        self.plot.setAspectLocked(True)
        self.plot.invertY(True)
        self.plot.hideButtons()
        self.plot.setMouseEnabled(False, False)
        style_axes(self.plot, "position x (px)", "position y (px)")
        self.item = pg.ImageItem(axisOrder="row-major")
        self.plot.addItem(self.item)
        self.missing = pg.ScatterPlotItem(size=5, pen=None, brush=pg.mkBrush(*MISSING), symbol="x")
        self.plot.addItem(self.missing)
        self.cross = pg.TargetItem(movable=False, size=14, symbol="crosshair", pen=pg.mkPen("#ffffff", width=2))
        self.plot.addItem(self.cross)
        self._held = False
        self.graphics.viewport().installEventFilter(self)
        self._values: NDArray[Any] | None = None
        offer_menu(self, lambda: "period", self._entries)
        self.setToolTip("Drag to choose the source position; arrow keys step")
        self.apply_theme()

    def set_values(self, values: NDArray[Any], recorded: NDArray[Any] | None = None) -> None:
        """Show ``values`` ``(ny, nx)``; positions with ``recorded`` 0 are crossed out."""
        self._values = data = np.asarray(values, float)
        self._shape = (data.shape[0], data.shape[1])
        self.item.setImage(data, levels=levels_of(data), lut=theme_table("cividis"), autoLevels=False)
        ny, nx = self._shape
        rect = QRectF(-0.5, -0.5, nx, ny)
        self.item.setRect(rect)
        count_pixels(self.plot, self._shape)
        self.plot.setRange(rect, padding=0.02)
        y, x = np.nonzero(recorded == 0) if recorded is not None else (np.zeros(0), np.zeros(0))
        self.missing.setData(x, y)

    def _entries(self) -> list[tuple[str, Any]]:
        return [] if self._values is None else table_entries(self, "period", self._lines)

    def _lines(self, between: str) -> Iterator[str]:
        """Yield the values as they lie in the map, a row of positions in a line."""
        assert self._values is not None
        for row in self._values:
            yield between.join(f"{value:.7g}" for value in row) + "\n"

    def clear(self) -> None:
        """Show no values; positions can still be chosen."""
        self._values = None
        self.item.clear()
        self.missing.setData([], [])

    def set_position(self, y: int, x: int) -> None:
        """Move the cross without reporting it."""
        self.cross.setPos(x, y)

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        theme_plot(self.graphics, self.plot)
        if self.item.image is not None:
            self.item.setLookupTable(self._table())

    def _table(self) -> NDArray[np.uint8]:
        return theme_table("cividis")

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Follow the pointer while its button is held."""
        kind = event.type()
        if isinstance(event, QMouseEvent) and kind in (
            QEvent.Type.MouseButtonPress,
            QEvent.Type.MouseMove,
            QEvent.Type.MouseButtonRelease,
        ):
            if kind == QEvent.Type.MouseButtonPress and event.button() == Qt.MouseButton.LeftButton:
                self._held = True
            if self._held and kind != QEvent.Type.MouseButtonRelease:
                self._choose(event)
                return True
            if kind == QEvent.Type.MouseButtonRelease:
                self._held = False
        return super().eventFilter(watched, event)

    def _choose(self, event: QMouseEvent) -> None:
        point = self.plot.vb.mapSceneToView(self.graphics.mapToScene(event.position().toPoint()))
        y = min(max(round(point.y()), 0), self._shape[0] - 1)
        x = min(max(round(point.x()), 0), self._shape[1] - 1)
        self.chosen.emit(y, x)
