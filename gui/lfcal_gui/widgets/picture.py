"""Widget for 2-D arrays of any size, whose values, overlays and caption are always drawn together."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import count, repeat
from typing import Any

import numpy as np
import pyqtgraph as pg
from numpy.typing import NDArray
from PySide6.QtCore import QEvent, QObject, QPointF, QRectF, QSizeF, Qt, QTimer, Signal
from PySide6.QtGui import (
    QColor,
    QImage,
    QKeyEvent,
    QKeySequence,
    QMouseEvent,
    QPainter,
    QPaintEvent,
    QPen,
    QPolygonF,
    QTransform,
)
from PySide6.QtWidgets import QApplication, QVBoxLayout, QWidget

from lfcal.camera import Camera
from lfcal_gui.jobs import Jobs
from lfcal_gui.models import (
    DIVERGING,
    DisplaySettings,
    Label,
    Levels,
    Outline,
    Overlay,
    Shot,
    Symbols,
    depth_colours,
    lattice_points,
    level_words,
    minus,
    render_tile,
    scale_bar,
    tinted,
    to_uint8,
    visible_tile,
)
from lfcal_gui.theme import TYPE_COLOURS, current_theme
from lfcal_gui.widgets._axes import ABOVE, PixelAxis, Plot, count_pixels
from lfcal_gui.widgets._blank import Blank
from lfcal_gui.widgets._measuring import Measuring
from lfcal_gui.widgets.colours import outline_pen, ramp, row_of, theme_table
from lfcal_gui.widgets.picture_menu import copy_picture, offer_menu, save_picture, save_values

LARGE = 1 << 18
"""Number of pixels above which a picture is drawn in the background, and only its visible part."""

COPIED = 1 << 18
"""Largest number of pixels that can be copied as a table."""

REDRAW_MS = 12

PILL, GAP, LINE = QColor(8, 10, 13, 205), 8, 15
"""Background of texts over a picture, space around them, and height of a line (px)."""

RIM = QColor(0, 0, 0)
"""Colour around marks that lie on bright pixels."""

RAMP, SCALE = 120, 140
"""Largest length of the colour bar of a legend, and of a scale bar (px)."""

UNSCALED = 110
"""Height of a picture up to which no scale bar is drawn (px)."""

SHORT = 40
"""Length of the colour bar of a legend if its quantity needs the space (px)."""

ARROWS = {Qt.Key.Key_Up: (-1, 0), Qt.Key.Key_Down: (1, 0), Qt.Key.Key_Left: (0, -1), Qt.Key.Key_Right: (0, 1)}
"""Rows and columns by which a key moves the grip."""

_numbers = count()


class Picture(QWidget):
    """Show one `Shot` at a time; row 0 is at the top, pixel centres are at whole numbers.

    Parameters
    ----------
    quantity
        Quantity of the values, with its unit.
    axes
        Names of the horizontal and of the vertical axis. None: there are no axes.
    jobs
        Jobs of the window, which draw large pictures in the background. None: all pictures are drawn immediately.
    steered
        Whether a drag with the left button points at a place (`steered_to`) and moves nothing.
    square
        Whether a pixel is as wide as high.
    legend
        Whether to show a colour bar with its values below the picture, for pictures without a `Contrast`.
    colour_map
        Colour map until another one is set; empty: the colour map of `DisplaySettings`.
    """

    hovered = Signal(int, int, float, arguments=["row", "column", "value"])
    """The pixel under the pointer, also emitted when the picture changes; row -1: the pointer left."""
    clicked = Signal(int, int, arguments=["row", "column"])
    """A pixel was clicked."""
    pressed = Signal()
    """In a steered picture, the left button was pressed; `steered_to` follows."""
    steered_to = Signal(int, int, arguments=["row", "column"])
    """The pointer was dragged to a pixel; outside the picture, to the nearest one."""
    dragged = Signal(int, int, arguments=["rows", "columns"])
    """Numbers of rows and columns by which the pointer or an arrow key moved the grip since the last signal."""
    changed = Signal()
    """Another picture is displayed, or none."""
    readout_clicked = Signal()
    """The readout in the upper right corner was clicked."""
    moved = Signal()
    """The user panned, zoomed or asked for the whole picture."""

    def __init__(
        self,
        quantity: str = "intensity (counts)",
        *,
        axes: tuple[str, str] | None = None,
        jobs: Jobs | None = None,
        steered: bool = False,
        square: bool = True,
        legend: bool = True,
        colour_map: str = "",
        parent: QWidget | None = None,
    ) -> None:
        super().__init__(parent)
        self._quantity, self._jobs, self._legend = quantity, jobs, legend
        self._group = f"picture {next(_numbers)}"
        self._display = DisplaySettings(colour_map=colour_map) if colour_map else DisplaySettings()
        self._wanted = self._shot = Shot()
        self._name = "picture"
        self._levels: Levels = (0.0, 1.0)
        self._later: tuple[Overlay, ...] = ()
        self._note = ("", "")
        self._readout_at = QRectF()
        self._camera: Camera | None = None
        self._lattice_at: tuple[int, int] = (0, 0)
        self._lattice: tuple[Symbols, ...] = ()
        self._pointer: QPointF | None = None
        self._drawing = self._again = False
        self._red = current_theme().red
        self.contrast: Levels | None = None
        """Levels that the user chose. None: the levels of the picture."""
        self.sharing: tuple[Picture, ...] = (self,)
        """Pictures that share one contrast."""
        self._steered, self._held = steered, False
        self._grip: QRectF | None = None
        self._dragged_from: QPointF | None = None
        self._build(axes, square)
        self._watch()
        self.apply_theme()

    def _build(self, axes: tuple[str, str] | None, square: bool) -> None:
        self.setFocusPolicy(Qt.FocusPolicy.ClickFocus)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        self.graphics = _Canvas(self)
        self.graphics.setAccessibleName(self._quantity if axes is None else f"{axes[1]} over {axes[0]}")
        layout.setSpacing(0)
        layout.addWidget(self.graphics, 1)
        self.legend = _Legend(self) if self._legend else None
        if self.legend is not None:
            layout.addWidget(self.legend)
        self.box = pg.ViewBox(lockAspect=square, invertY=True, enableMenu=False)
        self.plot: Plot | None = None
        if axes is None:
            self.graphics.setCentralItem(self.box)
        else:
            self.plot = Plot(self.box, left=PixelAxis("left"), bottom=PixelAxis("bottom"), top=ABOVE)
            self.plot.name_axes(*axes)
            self.graphics.setCentralItem(self.plot)
        self.item = _Image(axisOrder="row-major")
        self.box.addItem(self.item)
        self.blank = Blank(self.graphics, self.box, self.plot, dark=True)
        self.blank.show_blank(True)
        self.graphics.viewport().installEventFilter(self)

    def _watch(self) -> None:
        self._timer = QTimer(self, singleShot=True, interval=REDRAW_MS)
        self._timer.timeout.connect(self._redraw)
        self.box.sigRangeChanged.connect(lambda *_: self._range_changed())
        self.box.sigRangeChangedManually.connect(lambda *_: self.moved.emit())
        self.graphics.scene().sigMouseMoved.connect(self._point_at)
        self.graphics.scene().sigMouseClicked.connect(self._clicked)
        offer_menu(self, lambda: self.file_name, self._entries)

    # -- content ---------------------------------------------------------------------------------------
    def set_shot(self, shot: Shot | None, *, keep_view: bool = True) -> None:
        """Show ``shot``; a large one is drawn in the background first. None: show nothing.

        With ``keep_view``, pan and zoom are kept if place and size equal those of the previous picture.
        """
        shot = shot or Shot()
        before, self._wanted = self._wanted, shot
        self._name = shot.name or self._name
        moved = not keep_view or shot.place != before.place
        if shot.values is not None and moved:
            self._show_extent(shot)
        if self._in_background:
            self._redraw()
        else:
            self._draw_now()

    @property
    def shot(self) -> Shot:
        """The displayed shot, an empty `Shot` if there is none."""
        return self._shot

    @property
    def values(self) -> NDArray[Any] | None:
        """The displayed values; for RGB, their mean."""
        return self._shot.measured

    @property
    def display(self) -> DisplaySettings:
        """Scaling, colour map and levels in use."""
        return _display_of(self._shot, self._display)

    def set_display(self, display: DisplaySettings) -> None:
        """Set scaling, colour map and levels; signed values keep a linear scale and their own colour map."""
        if display != self._display:
            self._display = display
            self._redraw()

    def set_contrast(self, levels: Levels | None) -> None:
        """Set the levels of this and later pictures, and of pictures sharing them. None: levels of each picture."""
        for picture in self.sharing:
            if levels != picture.contrast:
                picture.contrast = levels
                picture._redraw()

    def set_overlays(self, *overlays: Overlay) -> None:
        """Set ``overlays`` that are drawn in addition to the overlays of the picture."""
        self._later = overlays
        self._repaint()

    def set_note(self, words: str, colour: str = "") -> None:
        """Set a line below the readout that does not belong to the picture, such as a temporary status."""
        if (words, colour) != self._note:
            self._note = words, colour
            self._repaint()

    @property
    def note(self) -> tuple[str, str]:
        """The line below the readout, and its colour; an empty colour means the colour of the readout."""
        return self._note

    def set_lattice(self, camera: Camera | None, origin: tuple[int, int] = (0, 0)) -> None:
        """Draw the micro-image centres of ``camera`` over a frame whose first pixel is ``origin``. None: none."""
        self._camera, self._lattice_at = camera, origin
        self._find_lattice()
        self._repaint()

    def set_cross(self, row: float | None, column: float | None = None) -> None:
        """Mark a pixel of the displayed picture. None: none."""
        nowhere = row is None or column is None or self._wanted.values is None
        cross = None if nowhere else (row, column)
        if cross == self._wanted.cross == self._shot.cross:
            return
        self._wanted, self._shot = replace(self._wanted, cross=cross), replace(self._shot, cross=cross)
        self._repaint()

    def set_axes(self, across: str, down: str) -> None:
        """Name both axes, with their units."""
        assert self.plot is not None
        self.plot.name_axes(across, down)
        self.plot.apply_theme()

    @property
    def overlays(self) -> tuple[Overlay, ...]:
        """All overlays that are drawn over the picture."""
        return (*self._lattice, *self._shot.overlays, *self._later)

    @property
    def quantity(self) -> str:
        """The quantity of the values, with its unit."""
        return self._shot.quantity or self._quantity

    @property
    def file_name(self) -> str:
        """The name of the picture for files."""
        return self._name

    @property
    def levels(self) -> Levels:
        """The values at the ends of the colour scale."""
        return self._levels

    # -- the part that is seen -------------------------------------------------------------------------
    def show_all(self) -> None:
        """Zoom such that the whole picture is visible."""
        if self._wanted.values is not None:
            self._show_extent(self._wanted)
            self.moved.emit()

    def show_part(self, row: float, column: float, height: float, width: float, *, padding: float = 0.05) -> None:
        """Zoom to a part of the picture, given in its units."""
        self.box.setRange(QRectF(column, row, width, height), padding=padding)

    def _show_extent(self, shot: Shot) -> None:
        assert shot.shape is not None
        if self.plot is not None:
            count_pixels(self.plot, shot.shape, shot.origin, shot.step)
        whole = _extent(shot) if shot.whole is None else _rect(*shot.whole)
        self.box.setRange(whole, padding=0.01 if self.plot is not None else 0)

    # -- drawing ---------------------------------------------------------------------------------------
    @property
    def _tinted(self) -> bool:
        """Whether pixels are tinted; not in the red theme."""
        return self._wanted.tint is not None and not current_theme().red

    @property
    def _in_background(self) -> bool:
        values = self._wanted.values
        large = values is not None and values.ndim == 2 and values.size > LARGE
        return self._jobs is not None and large

    def _range_changed(self) -> None:
        if self._camera is not None or self._in_background:
            self._timer.start()
        self._repaint()

    def _redraw(self) -> None:
        self._find_lattice()
        if not self._in_background:
            self._draw_now()
            return
        self._again = self._drawing
        if self._drawing:
            return
        self._drawing = True
        shot, chosen = self._wanted, self.contrast
        display = _display_of(shot, self._display)
        assert shot.values is not None and shot.shape is not None and self._jobs is not None
        values, (row, column), step = shot.values, shot.origin, shot.step
        (left, right), (top, bottom) = self.box.viewRange()
        rows, columns = ((top - row) / step, (bottom - row) / step), ((left - column) / step, (right - column) / step)
        ratio, size = self.devicePixelRatioF(), self.box.size()
        tint = shot.tint.values if self._tinted and shot.tint is not None else None
        tile = visible_tile(shot.shape, rows, columns, (round(size.height() * ratio), round(size.width() * ratio)))

        def render() -> tuple[NDArray[np.uint8], QRectF, Levels]:
            levels = shot.levels_in(display, chosen)
            picture = render_tile(values, tile, display, levels, tint)
            height, width = (n * tile.step * step for n in picture.shape[:2])
            first = row + (tile.rows[0] - 0.5) * step, column + (tile.columns[0] - 0.5) * step
            return picture, QRectF(first[1], first[0], width, height), levels

        self._jobs.compute(self._group, render, lambda found: self._drawn(shot, *found), self._not_drawn)

    def _drawn(self, shot: Shot, picture: NDArray[np.uint8], place: QRectF, levels: Levels) -> None:
        """Show a picture that was drawn in the background, even if a newer one has been requested meanwhile."""
        self._drawing = False
        if self._in_background:
            self._put(shot, picture, place, levels)
        if self._again:
            self._redraw()

    def _not_drawn(self, words: str) -> None:
        self._drawing = False
        if self._jobs is not None:
            self._jobs.trouble.emit(words)

    def _draw_now(self) -> None:
        shot = self._wanted
        if shot.values is None:
            self._shot = shot
            self.item.clear()
            self._report_view()
            return
        levels = shot.levels_in(self._display, self.contrast)
        display = _display_of(shot, self._display)
        if self._tinted:
            assert shot.tint is not None
            picture = tinted(shot.values, shot.tint.values, display, levels)
        elif shot.coloured:
            picture = (np.clip(shot.values, 0, 1) * 255 + 0.5).astype(np.uint8)
        else:
            picture = to_uint8(shot.values, display, levels)
        self._put(shot, picture, _extent(shot), levels)

    def _put(self, shot: Shot, picture: NDArray[np.uint8], place: QRectF, levels: Levels) -> None:
        self._shot, self._levels = shot, levels
        table = None if picture.ndim == 3 else theme_table(self.display.colour_map)
        self.item.setImage(picture, levels=(0, 255), lut=table, autoLevels=False)
        self.item.setRect(place)
        self._report_view()

    def _repaint(self) -> None:
        # not the viewport: it could be painted before the scene reports a changed image, and then once more
        self.graphics.scene().update()

    def _report_view(self) -> None:
        """Report a new picture, and the value under the pointer even if it does not move."""
        self.blank.show_blank(self._shot.values is None)
        self._repaint()
        if self.legend is not None:
            self.legend.setToolTip(self.quantity)
            self.legend.update()
        if self._pointer is not None:
            self._point_at(self._pointer)
        self.changed.emit()

    def _find_lattice(self) -> None:
        """Find the visible micro-images."""
        if self._camera is None or self._wanted.values is None:
            self._lattice = ()
            return
        (left, right), (up, down) = self.box.viewRange()
        top, first = self._lattice_at
        centres, types = lattice_points(self._camera, (up + top, down + top), (left + first, right + first))
        self._lattice = tuple(
            Symbols(centres[types == kind] - [top, first], "o", colour, 5, filled=True)
            for kind, colour in enumerate(TYPE_COLOURS)
        )

    def paint_over(self, painter: QPainter) -> None:
        """Draw overlays, caption, legend and scale bar in screen coordinates."""
        shot = self._shot
        if shot.values is None:
            return
        inside = self.graphics.mapFromScene(self.box.sceneBoundingRect()).boundingRect()
        painter.setClipRect(inside)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        to_screen = self.box.childTransform() * self.box.sceneTransform() * self.graphics.viewportTransform()
        for overlay in self.overlays:
            _paint_overlay(painter, overlay, to_screen)
        if shot.cross is not None:
            _paint_cross(painter, shot, to_screen)
        area = QRectF(inside)
        if shot.caption:
            _paint_lines(painter, [(words, "") for words in shot.caption.splitlines()], area)
        lines = [(words, "") for words in shot.readout.splitlines()] + [self._note] * bool(self._note[0])
        self._readout_at = _paint_lines(painter, lines, area, right=True) if lines else QRectF()
        if shot.pixel_um is not None and area.height() > UNSCALED:
            self._paint_scale(painter, area, shot.pixel_um / shot.step)
        if shot.tint is not None and self._tinted:
            _paint_tints(painter, shot.tint.ends, area)

    def _paint_scale(self, painter: QPainter, area: QRectF, unit_um: float) -> None:
        units = self.box.viewRect().width() / max(1.0, area.width())
        length, words = scale_bar(unit_um, units, min(SCALE, area.width() / 3))
        wide = max(length, float(painter.fontMetrics().horizontalAdvance(words)))
        pill = QRectF(area.left() + GAP, area.bottom() - GAP - LINE - 10, wide + 2 * GAP, LINE + 10)
        _paint_pill(painter, pill)
        painter.drawText(pill.adjusted(GAP, 0, 0, -6), Qt.AlignmentFlag.AlignVCenter, words)
        painter.setPen(QPen(painter.pen().color(), 2))
        painter.drawLine(pill.bottomLeft() + QPointF(GAP, -4), pill.bottomLeft() + QPointF(GAP + length, -4))

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        theme = current_theme()
        self.graphics.setBackground(theme.canvas if self.plot is None else theme.panel)
        self.box.setBackgroundColor(theme.canvas)
        if self.plot is not None:
            self.plot.apply_theme()
        self.blank.apply_theme()
        if theme.red != self._red:
            self._red = theme.red
            self._redraw()
        self.update()
        self._repaint()

    # -- pointer ---------------------------------------------------------------------------------------
    def pixel_at(self, place: QPointF) -> tuple[int, int] | None:
        """Return the pixel (row, column) at a position in the scene; None outside the picture."""
        if not self.box.sceneBoundingRect().contains(place):
            return None
        point = self.box.mapSceneToView(place)
        return self._shot.pixel_at(point.y(), point.x())

    def _point_at(self, place: QPointF) -> None:
        self._pointer = place
        pixel = self.pixel_at(place)
        if pixel is None:
            self.hovered.emit(-1, -1, math.nan)
        else:
            self.hovered.emit(*pixel, self._shot.value_at(pixel))

    def leaveEvent(self, event: QEvent) -> None:
        """Report that the pointer left the picture."""
        self._pointer = None
        self.hovered.emit(-1, -1, math.nan)
        super().leaveEvent(event)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Follow the pointer while its button is pressed, to select positions or to drag the grip."""
        kind = event.type()
        if not isinstance(event, QMouseEvent) or not (self._steered or self._grip is not None):
            return super().eventFilter(watched, event)
        place = self.graphics.mapToScene(event.position().toPoint())
        if kind == QEvent.Type.MouseButtonPress and event.button() == Qt.MouseButton.LeftButton:
            at = self.box.mapSceneToView(place)
            self._held = self._steered or (self._grip is not None and self._grip.contains(at))
            self._dragged_from = at
            if self._steered:
                self.pressed.emit()
        if self._held and kind in (QEvent.Type.MouseButtonPress, QEvent.Type.MouseMove):
            (self._steer if self._steered else self._drag)(place)
            return True
        if kind == QEvent.Type.MouseButtonRelease:
            self._held = False
        return super().eventFilter(watched, event)

    def set_grip(self, area: tuple[float, float, float, float] | None) -> None:
        """Report drags that begin within ``area`` (first row and column, height, width)."""
        self._grip = None if area is None else QRectF(area[1] - 0.5, area[0] - 0.5, area[3], area[2])

    def _drag(self, place: QPointF) -> None:
        assert self._dragged_from is not None
        way = self.box.mapSceneToView(place) - self._dragged_from
        columns, rows = round(way.x()), round(way.y())
        if rows or columns:
            self._dragged_from += QPointF(columns, rows)
            self.dragged.emit(rows, columns)

    def _steer(self, place: QPointF) -> None:
        shot, point = self._shot, self.box.mapSceneToView(place)
        if shot.shape is not None:
            at = zip((point.y(), point.x()), shot.origin, shot.shape, strict=True)
            self.steered_to.emit(*(min(max(round((a - o) / shot.step), 0), n - 1) for a, o, n in at))

    def _clicked(self, event: Any) -> None:
        if event.button() != Qt.MouseButton.LeftButton:
            return
        if event.double():
            self.show_all()
            return
        if self._readout_at.contains(self.graphics.mapFromScene(event.scenePos()).toPointF()):
            self.readout_clicked.emit()
            return
        pixel = self.pixel_at(event.scenePos())
        if pixel is not None:
            self.clicked.emit(*pixel)

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Copy the picture (Ctrl+C) or its values (C), or move the grip (arrow keys)."""
        if event.matches(QKeySequence.StandardKey.Copy):
            copy_picture(self)
        elif event.key() == Qt.Key.Key_C and event.modifiers() == Qt.KeyboardModifier.NoModifier:
            self.copy_data()
        elif self._grip is not None and event.key() in ARROWS:
            self.dragged.emit(*ARROWS[event.key()])
        else:
            super().keyPressEvent(event)

    # -- measuring, copying, saving --------------------------------------------------------------------
    def _entries(self) -> list[tuple[str, Callable[[], Any]]]:
        return [("Show all", self.show_all), *self.entries()]

    def entries(self) -> list[tuple[str, Callable[[], Any]]]:
        """Return the entries of the context menu; none if there is no picture."""
        if self.values is None:
            return []
        automatic = [] if self.contrast is None else [("Automatic contrast", lambda: self.set_contrast(None))]
        copying = [("Copy values", self.copy_data)] if self.values.size <= COPIED else []
        return [
            ("Contrast, profile, region …", self.measure),
            *automatic,
            *copying,
            ("Save data …", lambda: self.save_data()),
        ]

    def measure(self) -> Measuring:
        """Open the window for measurements in this picture."""
        self.measuring = Measuring(self)
        self.measuring.show()
        return self.measuring

    def copy_data(self) -> None:
        """Copy the values to the clipboard, for a spreadsheet."""
        values = self.values
        if values is not None and values.size <= COPIED:
            rows = ("\t".join(f"{value:.7g}" for value in row) for row in values)
            QApplication.clipboard().setText("\n".join(rows))

    def save_data(self, path: str = "") -> None:
        """Save the values as ``.npy``, or as text (``.csv``)."""
        if self.values is not None:
            jobs = self._jobs if self._in_background else None
            save_values(self, np.asarray(self.values), self.file_name, path, jobs)

    def save_picture(self, path: str = "") -> None:
        """Save the picture with its overlays as PNG or SVG."""
        save_picture(self, self.file_name, path)


def link(*pictures: Picture) -> None:
    """Show the same part in all of ``pictures`` when the user moves one; pyqtgraph's own links drift apart."""

    def follow(moved: Picture) -> None:
        for picture in pictures:
            if picture is not moved:
                picture.box.setRange(moved.box.targetRect(), padding=0)

    for picture in pictures:
        picture.moved.connect(lambda moved=picture: follow(moved))


def share_contrast(*pictures: Picture) -> None:
    """Let ``pictures`` share one contrast, which can be set in any of them."""
    for picture in pictures:
        picture.sharing = pictures


class _Legend(QWidget):
    """Colour bar with the values at its ends, and the quantity."""

    def __init__(self, picture: Picture) -> None:
        super().__init__(picture)
        self._picture = picture
        self.setFixedHeight(LINE + 3)

    def paintEvent(self, _: QPaintEvent) -> None:
        """Draw both values, the colours between them, and the quantity if there is enough space."""
        picture = self._picture
        if picture.values is None or picture.shot.coloured:
            return
        painter, theme = QPainter(self), current_theme()
        font = painter.font()
        font.setPixelSize(11)
        painter.setFont(font)
        metrics = painter.fontMetrics()
        low, high = (minus(level_words(value, picture.levels)) for value in picture.levels)
        ends = metrics.horizontalAdvance(low) + metrics.horizontalAdvance(high) + 4 * GAP
        length = max(0, min(RAMP, self.width() - ends))
        spare = self.width() - ends - metrics.horizontalAdvance(picture.quantity) - 3 * GAP
        length = max(min(length, SHORT), min(length, spare))  # shorter colours, so that the quantity has room
        x, flags = float(GAP), Qt.AlignmentFlag.AlignVCenter
        painter.setPen(QColor(theme.text))
        for words in (low, None, high):
            wide = float(length if words is None else metrics.horizontalAdvance(words))
            place = QRectF(x, 0, wide, self.height())
            if words is None:
                strip = QRectF(x, self.height() / 2 - 3, wide, 7)
                painter.drawImage(strip, ramp(picture.display, picture.levels, RAMP))
            else:
                painter.drawText(place, flags, words)
            x += wide + GAP
        painter.setPen(QColor(theme.muted))
        room = math.ceil(self.width() - x)
        # the whole quantity, else its unit
        for words in (picture.quantity, "".join(picture.quantity.rpartition("(")[1:])):
            if metrics.horizontalAdvance(words) <= room:
                painter.drawText(QRectF(x, 0, room, self.height()), flags, words)
                break
        painter.end()


class _Image(pg.ImageItem):
    """Image item that averages pixels that share a screen pixel, because subsampling would cause moiré patterns."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self._shrunk: tuple[object, QImage | None] = None, None

    def paint(self, painter: QPainter, *arguments: Any) -> None:
        """Draw the image; enlarged pixels have sharp edges."""
        area = self.boundingRect()
        seen = painter.deviceTransform().mapRect(area).size()
        if self.image is None or (seen.width() >= area.width() and seen.height() >= area.height()):
            super().paint(painter, *arguments)
            return
        if self._renderRequired:
            self.render()
        size = (max(1, round(min(seen.width(), area.width()))), max(1, round(min(seen.height(), area.height()))))
        key = self.qimage.cacheKey(), size
        if key != self._shrunk[0]:
            aspect, smooth = Qt.AspectRatioMode.IgnoreAspectRatio, Qt.TransformationMode.SmoothTransformation
            self._shrunk = key, self.qimage.scaled(*size, aspect, smooth)
        painter.drawImage(area, self._shrunk[1])


class _Canvas(pg.GraphicsView):
    """View that paints the overlays together with the picture."""

    def __init__(self, picture: Picture) -> None:
        super().__init__()
        self._picture = picture
        self.setMinimumSize(120, 90)

    def drawForeground(self, painter: QPainter, rect: QRectF) -> None:
        """Draw overlays and texts in screen coordinates."""
        painter.save()
        painter.resetTransform()
        self._picture.paint_over(painter)
        painter.restore()


def _display_of(shot: Shot, display: DisplaySettings) -> DisplaySettings:
    if shot.tint is not None and not current_theme().red:
        return replace(display, colour_map="gray")  # the values give the brightness of the tint
    return replace(display, scale="linear", colour_map=DIVERGING) if shot.signed else display


def _rect(row: float, column: float, height: float, width: float) -> QRectF:
    return QRectF(column, row, width, height)


def _extent(shot: Shot) -> QRectF:
    return _rect(*shot.extent)


def _ink() -> QColor:
    return QColor(current_theme().text if current_theme().red else "#ffffff")


def _tone(colour: str) -> QColor:
    return _ink() if current_theme().red else QColor(colour)


def _paint_overlay(painter: QPainter, overlay: Overlay, to_screen: QTransform) -> None:
    if not len(overlay.points):
        return
    places = to_screen.map(QPolygonF([QPointF(column, row) for row, column in np.asarray(overlay.points).tolist()]))
    painter.setBrush(Qt.BrushStyle.NoBrush)
    if isinstance(overlay, Label):
        around = QRectF(places.first(), QSizeF()).adjusted(-40, -LINE, 40, LINE)
        for colour, across, down in (*((RIM, x, y) for x in (-1, 1) for y in (-1, 1)), (_tone(overlay.colour), 0, 0)):
            painter.setPen(colour)
            painter.drawText(around.translated(across, down), Qt.AlignmentFlag.AlignCenter, overlay.words)
        return
    if isinstance(overlay, Outline):
        style = Qt.PenStyle.DashLine if overlay.dashed else Qt.PenStyle.SolidLine
        draw = painter.drawPolygon if overlay.closed else painter.drawPolyline
        if overlay.rimmed:
            painter.setPen(QPen(RIM, overlay.width + 2))
            draw(places)
        painter.setPen(outline_pen(_tone(overlay.colour), overlay.width, style))
        draw(places)
        return
    if overlay.filled and isinstance(overlay.colours, str):  # thousands of micro-images in one call
        pen = QPen(_tone(overlay.colours), overlay.size)
        pen.setCapStyle(Qt.PenCapStyle.RoundCap if overlay.symbol == "o" else Qt.PenCapStyle.SquareCap)
        painter.setPen(pen)
        painter.drawPoints(places)
        return
    colours = repeat(overlay.colours) if isinstance(overlay.colours, str) else overlay.colours
    for place, colour in zip(places, colours, strict=False):
        painter.setPen(QPen(_tone(colour), 1.5))
        painter.setBrush(_tone(colour) if overlay.filled else Qt.BrushStyle.NoBrush)
        _paint_symbol(painter, overlay.symbol, place, overlay.size / 2)


def _paint_symbol(painter: QPainter, symbol: str, at: QPointF, half: float) -> None:
    if symbol == "o":
        painter.drawEllipse(at, half, half)
        return
    if symbol == "s":
        painter.drawRect(QRectF(at.x() - half, at.y() - half, 2 * half, 2 * half))
        return
    across, down = (
        (QPointF(half, 0), QPointF(0, half)) if symbol == "+" else (QPointF(half, half), QPointF(half, -half))
    )
    painter.drawLine(at - across, at + across)
    painter.drawLine(at - down, at + down)


def _paint_cross(painter: QPainter, shot: Shot, to_screen: QTransform) -> None:
    """Draw a square around a pixel, or lines to it if the pixel is too small."""
    assert shot.cross is not None
    (row, column), half = shot.cross, shot.step / 2
    around = to_screen.mapRect(QRectF(column - half, row - half, shot.step, shot.step))
    painter.setBrush(Qt.BrushStyle.NoBrush)
    for colour, width in ((RIM, 3.5), (_ink(), 1.5)):
        painter.setPen(QPen(colour, width))
        if min(around.width(), around.height()) >= 6:
            painter.drawRect(around)
        else:
            _paint_symbol(painter, "+", around.center(), 8)


def _paint_pill(painter: QPainter, area: QRectF) -> None:
    painter.setPen(Qt.PenStyle.NoPen)
    painter.setBrush(PILL)
    painter.drawRoundedRect(area, 5, 5)
    painter.setBrush(Qt.BrushStyle.NoBrush)
    painter.setPen(_ink())
    font = painter.font()
    font.setPixelSize(11)
    painter.setFont(font)


def _paint_lines(painter: QPainter, lines: Sequence[tuple[str, str]], area: QRectF, *, right: bool = False) -> QRectF:
    """Draw coloured texts in an upper corner if there is enough space; return their area."""
    _paint_pill(painter, QRectF())
    metrics, room = painter.fontMetrics(), round(area.width() - 4 * GAP)
    shown = [(metrics.elidedText(minus(words), Qt.TextElideMode.ElideRight, room), colour) for words, colour in lines]
    wide = max(metrics.horizontalAdvance(words) for words, _ in shown) + 2 * GAP
    left = area.right() - GAP - wide if right else area.left() + GAP
    pill = QRectF(left, area.top() + GAP, wide, LINE * len(shown) + 8)
    _paint_pill(painter, pill)
    for k, (words, colour) in enumerate(shown):
        painter.setPen(_tone(colour) if colour else _ink())
        place = QRectF(pill.left() + GAP, pill.top() + 4 + k * LINE, wide, LINE)
        painter.drawText(place, Qt.AlignmentFlag.AlignVCenter, words)
    return pill


def _paint_tints(painter: QPainter, ends: tuple[str, str], area: QRectF) -> None:
    """Draw the colours of depths in the lower right corner if there is enough space."""
    _paint_pill(painter, QRectF())
    wide = max(RAMP, painter.fontMetrics().horizontalAdvance("    ".join(ends)))
    if wide > area.width() - min(SCALE, area.width() / 3) - 6 * GAP:
        return
    pill = QRectF(area.right() - 3 * GAP - wide, area.bottom() - GAP - LINE - 10, wide + 2 * GAP, LINE + 10)
    _paint_pill(painter, pill)
    inside = pill.adjusted(GAP, 4, -GAP, -2)
    painter.drawImage(QRectF(inside.topLeft(), QSizeF(wide, 5)), row_of(depth_colours()))
    for side, end in zip((Qt.AlignmentFlag.AlignLeft, Qt.AlignmentFlag.AlignRight), ends, strict=True):
        painter.drawText(inside, side | Qt.AlignmentFlag.AlignBottom, minus(end))
