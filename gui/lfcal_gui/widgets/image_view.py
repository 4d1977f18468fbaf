"""A 2-D array as a picture: axes with units, colour bar, hover, copy and save."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pyqtgraph as pg
from numpy.typing import NDArray
from PySide6.QtCore import QEvent, QPointF, QRectF, Qt, Signal
from PySide6.QtGui import QPen
from PySide6.QtWidgets import QGraphicsItem, QVBoxLayout, QWidget

from lfcal_gui.models import DisplaySettings, levels_of, to_uint8
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets._measured import MeasuredView
from lfcal_gui.widgets.blank import Blank
from lfcal_gui.widgets.colour_bar import ColourBar, bar_table, theme_table
from lfcal_gui.widgets.picture_menu import offer_menu, save_picture
from lfcal_gui.widgets.pixel_axis import count_pixels, pixel_axes
from lfcal_gui.widgets.plots import line_px, style_axes, theme_plot

__all__ = ["ImageView"]


class ImageView(MeasuredView, QWidget):
    """Show an array; row 0 is at the top, pixel centres are at whole numbers.

    Signals
    -------
    hovered(row, column, value)
        The pixel under the pointer, told again when the picture under it changes; row -1 when it left.
    clicked(row, column)
        A pixel was clicked.
    picture_changed()
        There is another picture, or none.
    whole_shown()
        The user asked for the whole picture.
    """

    hovered = Signal(int, int, float)
    clicked = Signal(int, int)
    picture_changed = Signal()
    whole_shown = Signal()

    def __init__(
        self,
        *,
        xlabel: str = "column s",
        ylabel: str = "row t",
        unit: str = "px",
        value_label: str = "intensity (counts)",
        signed: bool = False,
        parent: QWidget | None = None,
    ) -> None:
        super().__init__(parent)
        self._signed = signed
        self._display = DisplaySettings(colour_map="RdBu_r" if signed else "viridis")
        self._image: NDArray[Any] | None = None
        self._origin = (0.0, 0.0)
        self._step = 1.0
        self._name = "image"
        self._bar_look: tuple[Any, ...] = ()
        self._bar_levels = (math.nan, math.nan)
        self._given: tuple[float, float] | None = None
        self._value_label = value_label
        self._pointer: QPointF | None = None
        self._red = current_theme().red
        self._build(f"{xlabel} ({unit})", f"{ylabel} ({unit})", value_label)
        self.graphics.scene().sigMouseMoved.connect(self._moved)
        self.graphics.scene().sigMouseClicked.connect(self._clicked)
        offer_menu(self, lambda: self._name, self._entries)
        self.apply_theme()

    def _build(self, xlabel: str, ylabel: str, value_label: str) -> None:
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        self.graphics = pg.GraphicsLayoutWidget()
        self.graphics.setMinimumSize(120, 110)
        layout.addWidget(self.graphics)
        self.plot: pg.PlotItem = self.graphics.addPlot(row=0, col=0, axisItems=pixel_axes(), enableMenu=False)
        self.plot.setAspectLocked(True)
        self.plot.invertY(True)
        self.plot.hideButtons()
        style_axes(self.plot, xlabel, ylabel)
        self.item = pg.ImageItem(axisOrder="row-major")
        self.plot.addItem(self.item)
        self.bar = ColourBar(label=value_label)
        self.graphics.addItem(self.bar, row=0, col=1)
        self.cursor = pg.TargetItem(
            movable=False, size=12, pen=pg.mkPen("#ffffff", width=line_px(1.5)), symbol="crosshair"
        )
        self.cursor.hide()
        self.plot.addItem(self.cursor)
        self.blank = Blank(self.graphics, self.plot)
        self.blank.show_blank(True)
        self.bar.hide()

    # -- content ---------------------------------------------------------------------------------------
    def set_image(
        self,
        image: NDArray[Any] | None,
        *,
        name: str = "",
        levels: tuple[float, float] | None = None,
        origin: tuple[float, float] = (0.0, 0.0),
        step: float = 1.0,
        keep_view: bool = True,
    ) -> None:
        """Show ``image`` ``(rows, columns)``; None shows nothing.

        Parameters
        ----------
        image
            Any numbers; not-a-number is shown dark.
        name
            For saved files.
        levels
            Values at the ends of the colour bar; None follows the display's levels or the data.
        origin, step
            Coordinates (row, column) of the first pixel and length of a pixel, in axis units.
        keep_view
            Keep pan and zoom if the shape is the same.
        """
        before = None if self._image is None else self._image.shape
        self._image, self._origin, self._step, self._given = image, origin, step, levels
        self._name = name or self._name
        self.blank.show_blank(image is None)
        self.bar.setVisible(image is not None)
        if image is None:
            self.item.clear()
            self._tell()
            self.picture_changed.emit()
            return
        shown = self.contrast or levels or self._display.levels or levels_of(image, signed=self._signed)
        data = to_uint8(image, self._display, shown)
        table = theme_table(self._display.colour_map)
        self.item.setImage(data, levels=(0, 255), lut=table, autoLevels=False)
        rows, columns = image.shape
        rect = QRectF(origin[1] - step / 2, origin[0] - step / 2, columns * step, rows * step)
        self.item.setRect(rect)
        count_pixels(self.plot, image.shape, origin, step)
        self._show_bar(shown)
        if before is None:
            self.graphics.ci.layout.activate()  # room for the colour bar now, or all of it is drawn twice
        if not keep_view or before != image.shape:
            self.plot.setRange(rect, padding=0.01)
        self._tell()
        self.picture_changed.emit()

    def _show_bar(self, levels: tuple[float, float]) -> None:
        """Change the colour bar only if need be: its axis is slow to draw."""
        scale = self._display.scale
        look = (self._display.colour_map, current_theme().red, scale, None if scale == "linear" else levels)
        if look != self._bar_look:
            self._bar_look = look
            self.bar.set_colours(bar_table(self._display.colour_map, scale, levels))
        if levels != self._bar_levels:
            self._bar_levels = levels
            self.bar.set_levels(levels)

    def set_display(self, display: DisplaySettings) -> None:
        """Change scaling, colour map and levels; levels that were given with the picture stay."""
        self._display = display
        if self._image is not None:
            self.set_image(self._image, levels=self._given, origin=self._origin, step=self._step)

    @property
    def signed(self) -> bool:
        """Whether levels are symmetric about zero."""
        return self._signed

    def set_signed(self, signed: bool, display: DisplaySettings) -> None:
        """Show differences (symmetric levels, diverging map) or intensities with ``display``."""
        self._signed = signed
        self._display = replace(display, scale="linear", colour_map="RdBu_r") if signed else display
        # the middle of a diverging map is as white as the cross
        self.cursor.setPen(self.overlay_pen("#101418" if signed and not current_theme().red else "#ffffff"))

    @property
    def display(self) -> DisplaySettings:
        """Scaling, colour map and levels in use."""
        return self._display

    @property
    def image(self) -> NDArray[Any] | None:
        """The array shown."""
        return self._image

    def set_value_label(self, text: str) -> None:
        """Name the quantity of the colour bar, with its unit."""
        self._value_label = text
        self.bar.set_label(text)

    def set_axes(self, xlabel: str, ylabel: str) -> None:
        """Name both axes, with their units."""
        style_axes(self.plot, xlabel, ylabel)
        self.apply_theme()

    def set_cursor(self, row: float | None, column: float | None = None) -> None:
        """Put the cross at (row, column); None hides it."""
        if row is None or column is None:
            self.cursor.hide()
            return
        self.cursor.setPos(column, row)
        self.cursor.show()

    def add_overlay(self, item: QGraphicsItem) -> None:
        """Draw ``item`` over the image, in axis units (x = column, y = row)."""
        self.plot.addItem(item)

    def overlay_pen(self, colour: str = "#ffffff", width: float = 1.5) -> QPen:
        """Return a pen that keeps its width at every zoom."""
        pen = pg.mkPen(colour, width=line_px(width))
        pen.setCosmetic(True)
        return pen

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        theme_plot(self.graphics, self.plot)
        self.blank.apply_theme()
        self.bar.apply_theme()
        red = current_theme().red
        if red != self._red:
            self._red = red
            self.set_display(self._display)

    # -- pointer ---------------------------------------------------------------------------------------
    def pixel_at(self, scene_position: QPointF) -> tuple[int, int] | None:
        """Return the pixel (row, column) under a scene position, None outside the image."""
        if self._image is None or not self.plot.sceneBoundingRect().contains(scene_position):
            return None
        point = self.plot.vb.mapSceneToView(scene_position)
        row = round((point.y() - self._origin[0]) / self._step)
        column = round((point.x() - self._origin[1]) / self._step)
        if 0 <= row < self._image.shape[0] and 0 <= column < self._image.shape[1]:
            return row, column
        return None

    def _moved(self, position: QPointF) -> None:
        self._pointer = position
        pixel = self.pixel_at(position)
        if pixel is None or self._image is None:
            self.hovered.emit(-1, -1, float("nan"))
        else:
            self.hovered.emit(*pixel, float(self._image[pixel]))

    def _tell(self) -> None:
        """Tell what is under a pointer that rests, so that no value of an earlier picture stays."""
        if self._pointer is not None:
            self._moved(self._pointer)

    def leaveEvent(self, event: QEvent) -> None:
        """Tell that the pointer left."""
        self._pointer = None
        self.hovered.emit(-1, -1, math.nan)
        super().leaveEvent(event)

    def _clicked(self, event: Any) -> None:
        pixel = self.pixel_at(event.scenePos())
        if pixel is not None and event.button() == Qt.MouseButton.LeftButton:
            self.clicked.emit(*pixel)

    # -- measuring, copying, saving --------------------------------------------------------------------
    def _entries(self) -> list[tuple[str, Any]]:
        return [("Show all", self.show_all), *self.entries()]

    def quantity(self) -> str:
        """Return what the values are, with the unit."""
        return self._value_label

    def file_name(self) -> str:
        """Return what the picture is called in files."""
        return self._name

    def measured(self) -> NDArray[Any] | None:
        """Return the picture."""
        return self._image

    def placed(self) -> tuple[tuple[float, float], float]:
        """Return the coordinates of the first pixel and the length of a pixel."""
        return self._origin, self._step

    def shown_levels(self) -> tuple[float, float]:
        """Return the values at the ends of the colours."""
        low, high = self._bar_levels
        return (0.0, 1.0) if math.isnan(low) else (low, high)

    def set_contrast(self, levels: tuple[float, float] | None) -> None:
        """Show these values in this and the next pictures, whatever the page says; None: what the page says."""
        if levels != self.contrast:
            self.contrast = levels
            if self._image is not None:
                self.set_image(self._image, levels=self._given, origin=self._origin, step=self._step)

    def show_all(self) -> None:
        """Zoom so that the whole image is seen."""
        if self._image is not None:
            self.plot.setRange(self.item.mapRectToParent(self.item.boundingRect()), padding=0.01)
            self.whole_shown.emit()

    def save_picture(self, path: str = "") -> None:
        """Write the picture, axes and all, as PNG or SVG."""
        save_picture(self, self._name, path)
