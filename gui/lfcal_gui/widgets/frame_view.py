"""A frame of any size, panned and zoomed smoothly: only what is visible is drawn, reduced in a worker."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pyqtgraph as pg
from numpy.typing import NDArray
from PySide6.QtCore import QEvent, QPointF, QRectF, QTimer, Signal
from PySide6.QtWidgets import QVBoxLayout, QWidget

from lfcal.camera import Camera
from lfcal_gui.jobs import Jobs
from lfcal_gui.models import DisplaySettings, Tile, lattice_points, render_tile, visible_tile
from lfcal_gui.theme import TYPE_COLOURS
from lfcal_gui.widgets._measured import MeasuredView
from lfcal_gui.widgets.blank import Blank
from lfcal_gui.widgets.colour_bar import theme_table
from lfcal_gui.widgets.picture_menu import offer_menu
from lfcal_gui.widgets.plots import line_px, style_axes, theme_plot

__all__ = ["FrameView"]


class FrameView(MeasuredView, QWidget):
    """Show a frame with the lattice and the cutout drawn over it.

    Signals
    -------
    hovered(row, column, value)
        The pixel under the pointer, told again when the frame under it changes; row -1 when it left.
    drawn()
        A new picture is on the screen.
    picture_changed()
        There is another frame, or none.
    """

    copied = False

    hovered = Signal(int, int, float)
    drawn = Signal()
    picture_changed = Signal()

    def __init__(self, jobs: Jobs, group: str, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._jobs, self._group = jobs, group
        self._frame: NDArray[Any] | None = None
        self._display, self._levels = DisplaySettings(), (0.0, 1.0)
        self._camera: Camera | None = None
        self._tile: Tile | None = None
        self._pointer: QPointF | None = None
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        self.graphics = pg.GraphicsLayoutWidget()
        self.graphics.setMinimumSize(120, 110)
        layout.addWidget(self.graphics)
        self.plot: pg.PlotItem = self.graphics.addPlot(enableMenu=False)
        self.plot.setAspectLocked(True)
        self.plot.invertY(True)
        self.plot.hideButtons()
        style_axes(self.plot, "sensor column (px)", "sensor row (px)")
        self.item = pg.ImageItem(axisOrder="row-major")
        self.plot.addItem(self.item)
        self.lattice = [
            pg.ScatterPlotItem(size=5, pen=None, brush=pg.mkBrush(colour), symbol="o") for colour in TYPE_COLOURS
        ]
        for points in self.lattice:
            self.plot.addItem(points)
        self.cutout = pg.PlotCurveItem(pen=pg.mkPen("#ff5a5f", width=line_px(2)))
        self.point = pg.ScatterPlotItem(size=12, symbol="+", pen=pg.mkPen("#ff5a5f", width=line_px(2)), brush=None)
        self.plot.addItem(self.cutout)
        self.plot.addItem(self.point)
        self.blank = Blank(self.graphics, self.plot)
        self.blank.show_blank(True)
        self._origin = (0, 0)
        self._with_it: Callable[[], None] | None = None
        self._drawing = self._again = False
        self._watch()
        self.apply_theme()

    def _watch(self) -> None:
        """Draw what comes into view, and follow the pointer."""
        self._timer = QTimer(self)
        self._timer.setSingleShot(True)
        self._timer.setInterval(12)
        self._timer.timeout.connect(self._render)
        self.plot.vb.sigRangeChanged.connect(lambda *_: self._timer.start())
        self.graphics.scene().sigMouseMoved.connect(self._moved)
        offer_menu(self, lambda: "frame", self._entries)

    # -- content ---------------------------------------------------------------------------------------
    def set_frame(
        self,
        frame: NDArray[Any] | None,
        levels: tuple[float, float],
        with_it: Callable[[], None] | None = None,
    ) -> None:
        """Show ``frame`` ``(rows, columns)``; pan and zoom stay if its shape does.

        ``with_it`` shows what belongs to the frame, such as its cutout, once its picture is drawn. A picture that
        takes longer than the next frame is drawn late then, rather than none at all.
        """
        before = None if self._frame is None else self._frame.shape
        self._frame, self._levels, self._with_it = frame, levels, with_it
        self.blank.show_blank(frame is None)
        if frame is None:
            self.item.clear()
            self._tell()
            self.picture_changed.emit()
            return
        if before != frame.shape:
            self.show_all()
        self._render()
        self._tell()
        self.picture_changed.emit()

    def set_display(self, display: DisplaySettings) -> None:
        """Change scaling and colour map."""
        self._display = display
        self._render()

    def set_levels(self, levels: tuple[float, float]) -> None:
        """Change the values at the ends of the colour map."""
        self._levels = levels
        self._render()

    def set_lattice(self, camera: Camera | None, origin: tuple[int, int] = (0, 0)) -> None:
        """Draw the micro-image centres of ``camera`` over a frame whose first pixel is ``origin``; None: none."""
        self._camera, self._origin = camera, origin
        self._draw_lattice()

    def set_cutout(self, row: int, column: int, shape: tuple[int, int], point: tuple[float, float]) -> None:
        """Draw the cutout whose first pixel is (row, column), and the paraxial image of the point."""
        top, left = row - 0.5, column - 0.5
        bottom, right = top + shape[0], left + shape[1]
        self.cutout.setData([left, right, right, left, left], [top, top, bottom, bottom, top])
        self.point.setData([point[1]], [point[0]])

    def clear_cutout(self) -> None:
        """Draw no cutout."""
        self.cutout.setData([], [])
        self.point.setData([], [])

    def show_all(self) -> None:
        """Zoom so that the whole frame is seen."""
        if self._frame is not None:
            rows, columns = self._frame.shape
            self.plot.setRange(QRectF(-0.5, -0.5, columns, rows), padding=0.01)

    def show_region(self, row: float, column: float, height: float, width: float) -> None:
        """Zoom to a region of the sensor."""
        self.plot.setRange(QRectF(column, row, width, height), padding=0.05)

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        theme_plot(self.graphics, self.plot)
        self.blank.apply_theme()
        self._render()

    # -- drawing ---------------------------------------------------------------------------------------
    def view_range(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return the visible (rows, columns)."""
        (left, right), (top, bottom) = self.plot.vb.viewRange()
        return (top, bottom), (left, right)

    def _render(self) -> None:
        frame, with_it = self._frame, self._with_it
        if frame is None:
            return
        self._draw_lattice()
        self._again = self._drawing
        if self._drawing:
            return
        self._drawing = True
        rows, columns = self.view_range()
        size = self.plot.vb.size()
        ratio = self.devicePixelRatioF()
        screen = (round(size.height() * ratio), round(size.width() * ratio))
        tile = visible_tile((frame.shape[0], frame.shape[1]), rows, columns, screen)
        display, levels = self._display, self.shown_levels()
        self._jobs.compute(
            self._group,
            lambda: (tile, render_tile(frame, tile, display, levels)),
            lambda result: self._drawn(frame, with_it, result),
            self._not_drawn,
        )

    def _drawn(
        self, frame: NDArray[Any], with_it: Callable[[], None] | None, result: tuple[Tile, NDArray[np.uint8]]
    ) -> None:
        """Show a picture, and then draw what was set meanwhile."""
        self._drawing = False
        # one that is late is shown only with what belongs to it, and never where no frame is shown any more
        if self._frame is frame or (self._frame is not None and with_it is not None):
            self._show(result)
            if with_it is not None:
                with_it()
        if self._again:
            self._render()

    def _not_drawn(self, words: str) -> None:
        self._drawing = False
        self._jobs.trouble.emit(words)

    def _show(self, result: tuple[Tile, NDArray[np.uint8]]) -> None:
        tile, picture = result
        table = theme_table(self._display.colour_map)
        self.item.setImage(picture, levels=(0, 255), lut=table, autoLevels=False)
        self.item.setRect(
            QRectF(
                tile.columns[0] - 0.5, tile.rows[0] - 0.5, picture.shape[1] * tile.step, picture.shape[0] * tile.step
            )
        )
        self.drawn.emit()

    def _draw_lattice(self) -> None:
        if self._camera is None or self._frame is None:
            for points in self.lattice:
                points.setData([], [])
            return
        (top, left), (rows, columns) = self._origin, self.view_range()
        on_sensor = (rows[0] + top, rows[1] + top), (columns[0] + left, columns[1] + left)
        centres, types = lattice_points(self._camera, *on_sensor)
        centres = centres - [top, left]
        for kind, points in enumerate(self.lattice):
            chosen = centres[types == kind]
            points.setData(chosen[:, 1], chosen[:, 0])

    def _tell(self) -> None:
        """Tell what is under a pointer that rests, so that no value of an earlier frame stays."""
        if self._pointer is not None:
            self._moved(self._pointer)

    def leaveEvent(self, event: QEvent) -> None:
        """Tell that the pointer left."""
        self._pointer = None
        self.hovered.emit(-1, -1, float("nan"))
        super().leaveEvent(event)

    def _moved(self, position: QPointF) -> None:
        self._pointer = position
        if self._frame is None or not self.plot.sceneBoundingRect().contains(position):
            self.hovered.emit(-1, -1, float("nan"))
            return
        point = self.plot.vb.mapSceneToView(position)
        row, column = round(point.y()), round(point.x())
        if 0 <= row < self._frame.shape[0] and 0 <= column < self._frame.shape[1]:
            self.hovered.emit(row, column, float(self._frame[row, column]))
        else:
            self.hovered.emit(-1, -1, float("nan"))

    # -- measuring, copying, saving --------------------------------------------------------------------
    def _entries(self) -> list[tuple[str, Any]]:
        return [("Show all", self.show_all), *self.entries()]

    def quantity(self) -> str:
        """Return what the values are, with the unit."""
        return "sample value (counts)"

    def file_name(self) -> str:
        """Return what the picture is called in files."""
        return "frame"

    def measured(self) -> NDArray[Any] | None:
        """Return the frame."""
        return self._frame

    def placed(self) -> tuple[tuple[float, float], float]:
        """Return the coordinates of the first pixel and the length of a pixel."""
        return (0.0, 0.0), 1.0

    def shown_levels(self) -> tuple[float, float]:
        """Return the values at the ends of the colours."""
        return self.contrast or self._levels

    def set_contrast(self, levels: tuple[float, float] | None) -> None:
        """Show these values in this and the next frames, whatever the page says; None: what the page says."""
        self.contrast = levels
        self._render()

    @property
    def display(self) -> DisplaySettings:
        """Scaling and colour map in use."""
        return replace(self._display)
