"""Contrast of pictures: histogram and colour scale with two handles."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QPoint, QPointF, QRectF, QSize, Qt, QTimer, Signal
from PySide6.QtGui import QColor, QContextMenuEvent, QKeyEvent, QMouseEvent, QPainter, QPaintEvent, QPen, QPolygonF
from PySide6.QtWidgets import QInputDialog, QMenu, QSizePolicy, QWidget

from lfcal_gui.models import COLOUR_MAPS, Levels, level_words, levels_of, minus, sampled, value_histogram
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets.colours import ramp

SCALINGS = (("linear", "linear"), ("log", "log, 4 decades"), ("gamma", "gamma 0.5"))
"""Pairs of scaling and displayed name."""

MARGIN, STRIP, NUMBERS, HEIGHT = 10, 8, 16, 58
"""Margin left and right of the colours, height of colours, numbers and widget (px)."""

REACH = 8
"""Largest distance at which a handle is grabbed (px)."""

TAIL = 0.001
"""Fraction of the values beyond each handle if they are set automatically."""

WAIT_MS = 30
"""Shortest interval between two histograms of a changing picture (ms)."""

STEP = 0.01


class Contrast(QWidget):
    """Histogram, colours and levels of pictures that share one scale.

    Drag a handle, move it with the arrow keys (Tab or Space selects the other one), or double-click it to type its
    value. A menu contains automatic contrast, scaling and colours.

    Parameters
    ----------
    picture
        A `lfcal_gui.widgets.picture.Picture`, which provides the histogram. The chosen contrast also applies to
        pictures that share it.
    """

    display_asked = Signal(dict, arguments=["changes"])
    """Entries of `lfcal_gui.models.display.DisplaySettings` were chosen in the menu; they are shown already."""

    def __init__(self, picture: Any, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.picture = picture
        self._places: NDArray[np.float64] = np.zeros(0)
        self._counts: NDArray[np.float64] = np.zeros(0)
        self._held: int | None = None
        self._active = 1
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.setAccessibleName("Contrast")
        self.setToolTip("Drag the handles. Press A to clip 0.1 % at both ends. Double-click a handle to type its value")
        self._timer = QTimer(self, singleShot=True, interval=WAIT_MS)
        self._timer.timeout.connect(self._count)
        picture.changed.connect(self._timer.start)
        self._count()

    def sizeHint(self) -> QSize:
        """Return the preferred size."""
        return QSize(240, HEIGHT)

    def minimumSizeHint(self) -> QSize:
        """Return the smallest size."""
        return QSize(120, HEIGHT)

    @property
    def levels(self) -> Levels:
        """The values at both handles."""
        return self.picture.levels

    @property
    def span(self) -> Levels:
        """The values at both ends of the widget."""
        low, high = self.levels
        if len(self._places):
            low, high = min(low, float(self._places[0])), max(high, float(self._places[-1]))
        return (low, high) if high > low else (low, low + 1)

    def set_levels(self, levels: Levels | None) -> None:
        """Set the levels. None: use the levels of the pictures."""
        if levels is not None and not levels[1] > levels[0]:
            return
        self.picture.set_contrast(levels)
        self.update()

    def leave_out_tails(self) -> None:
        """Place each handle such that a thousandth of the values lies beyond it."""
        values = self.picture.values
        if values is None:
            return
        found = sampled(values)
        if found.size:
            low, high = (float(v) for v in np.quantile(found, (TAIL, 1 - TAIL)))
            # else a picture with only a few bright points would be black
            self.set_levels((low, high if high > low else levels_of(values)[1]))

    def clipped(self) -> tuple[float, float]:
        """Return the fractions of the values below the low and above the high handle."""
        total = self._counts.sum()
        if not total:
            return (0.0, 0.0)
        low, high = self.levels
        return (
            float(self._counts[self._places < low].sum() / total),
            float(self._counts[self._places > high].sum() / total),
        )

    def _count(self) -> None:
        values = self.picture.values
        if values is None:
            self._places, self._counts = np.zeros(0), np.zeros(0)
        else:
            self._places, counts = value_histogram(values)
            self._counts = counts.astype(float)
        self.setEnabled(values is not None)
        low, high = (level_words(value, self.levels) for value in self.levels)
        self.setAccessibleDescription(f"from {low} to {high}, {self.picture.quantity}")
        self.update()

    # -- drawing ---------------------------------------------------------------------------------------
    def _strip(self) -> QRectF:
        return QRectF(MARGIN, self.height() - NUMBERS - STRIP, max(1, self.width() - 2 * MARGIN), STRIP)

    def _x_of(self, value: float) -> float:
        (low, high), strip = self.span, self._strip()
        return strip.left() + (value - low) / (high - low) * strip.width()

    def _value_at(self, x: float) -> float:
        (low, high), strip = self.span, self._strip()
        return low + min(max((x - strip.left()) / strip.width(), 0.0), 1.0) * (high - low)

    def paintEvent(self, _: QPaintEvent) -> None:
        """Draw histogram, colours, handles and numbers."""
        theme, strip = current_theme(), self._strip()
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        font = painter.font()
        font.setPixelSize(11)
        painter.setFont(font)
        if len(self._counts):
            self._paint_histogram(painter, strip)
        low, high = (self._x_of(value) for value in self.levels)
        picture = self.picture
        if picture.values is not None:
            painter.fillRect(strip, QColor(theme.canvas))
            colours = ramp(picture.display, self.levels, 256)
            painter.drawImage(QRectF(low, strip.top(), max(1.0, high - low), STRIP), colours)
            painter.fillRect(QRectF(high, strip.top(), strip.right() - high, STRIP), colours.pixelColor(255, 0))
            painter.fillRect(QRectF(strip.left(), strip.top(), low - strip.left(), STRIP), colours.pixelColor(0, 0))
            self._paint_handles(painter, strip, (low, high))
        painter.setPen(QColor(theme.muted))
        middle = QRectF(strip.left(), strip.bottom(), strip.width(), NUMBERS)
        if picture.values is not None and high - low > 0.5 * strip.width():
            painter.drawText(middle, Qt.AlignmentFlag.AlignCenter, picture.quantity)
        if self.hasFocus():
            painter.setPen(QPen(QColor(theme.accent), 2))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawRoundedRect(QRectF(self.rect()).adjusted(1, 1, -1, -1), 4, 4)
        painter.end()

    def _paint_histogram(self, painter: QPainter, strip: QRectF) -> None:
        """Draw the logarithm of the counts: of dark pixels there are a thousand times as many as of bright ones."""
        heights = np.log1p(self._counts)
        top = max(float(heights.max()), 1e-9)
        room, (low, high) = strip.top() - 4, self.span
        x = (strip.left() + (self._places - low) / (high - low) * strip.width()).tolist()
        y = (strip.top() - room * heights / top).tolist()
        line = [QPointF(*at) for at in zip(x, y, strict=True)]
        area = [QPointF(x[0], strip.top()), *line, QPointF(x[-1], strip.top())]
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(QColor(current_theme().edge))
        painter.drawPolygon(QPolygonF(area))

    def _paint_handles(self, painter: QPainter, strip: QRectF, at: tuple[float, float]) -> None:
        theme = current_theme()
        for k, (x, value, share) in enumerate(zip(at, self.levels, self.clipped(), strict=True)):
            painter.setPen(QPen(QColor(theme.text), 1.5))
            painter.drawLine(QPointF(x, 3), QPointF(x, strip.bottom()))
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(QColor(theme.accent if k == self._active and self.hasFocus() else theme.text))
            painter.drawRoundedRect(QRectF(x - 4, strip.top() - 1, 8, STRIP + 2), 3, 3)
            words = minus(level_words(value, self.levels)) + (
                f"  {100 * share:.2g} % clipped" if share >= 0.0005 else ""
            )
            wide = painter.fontMetrics().horizontalAdvance(words) + 2
            left = min(max(x - wide / 2, 2.0), self.width() - wide - 2.0)
            painter.setPen(QColor(theme.text))
            painter.drawText(QRectF(left, strip.bottom(), wide, NUMBERS), Qt.AlignmentFlag.AlignVCenter, words)

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        self.update()

    # -- choosing --------------------------------------------------------------------------------------
    def _handle_at(self, x: float) -> int | None:
        distances = [abs(self._x_of(value) - x) for value in self.levels]
        nearest = int(np.argmin(distances))
        return nearest if distances[nearest] <= REACH else None

    def mousePressEvent(self, event: QMouseEvent) -> None:
        """Grab the handle under the pointer, or else the nearer one."""
        if event.button() != Qt.MouseButton.LeftButton or self.picture.values is None:
            return
        x = event.position().x()
        held = self._handle_at(x)
        if held is None:
            held = int(np.argmin([abs(self._x_of(value) - x) for value in self.levels]))
        self._held = self._active = held
        self._drag(x)

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        """Move the handle."""
        if self._held is not None:
            self._drag(event.position().x())

    def mouseReleaseEvent(self, _: QMouseEvent) -> None:
        """Release the handle."""
        self._held = None

    def _drag(self, x: float) -> None:
        self._move(self._active, self._value_at(x))

    def _move(self, handle: int, value: float) -> None:
        low, high = self.levels
        least = 1e-6 * (self.span[1] - self.span[0])
        self.set_levels((min(value, high - least), high) if handle == 0 else (low, max(value, low + least)))

    def mouseDoubleClickEvent(self, event: QMouseEvent) -> None:
        """Ask for the value of a handle."""
        self._held = None
        handle = self._handle_at(event.position().x())
        if handle is not None and self.picture.values is not None:
            self.ask(handle)

    def ask(self, handle: int) -> None:
        """Ask for the value of the low (0) or high (1) handle."""
        words = ("Lowest value", "Highest value")[handle]
        given, taken = QInputDialog.getText(
            self, "Contrast", f"{words}, {self.picture.quantity}", text=f"{self.levels[handle]:.6g}"
        )
        try:
            value = float(given)
        except ValueError:
            return
        if taken and math.isfinite(value):
            self._move(handle, value)

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Move a handle by a hundredth (Left, Right), change to the other one (Space), or set both (A)."""
        moves = {Qt.Key.Key_Left: -1, Qt.Key.Key_Right: 1}
        if event.key() in moves and self.picture.values is not None:
            low, high = self.span
            by = moves[Qt.Key(event.key())] * STEP * (high - low)
            self._move(self._active, self.levels[self._active] + by)
        elif event.key() == Qt.Key.Key_Space:
            self._active = 1 - self._active
            self.update()
        elif event.key() == Qt.Key.Key_A:
            self.leave_out_tails()
        else:
            super().keyPressEvent(event)

    def contextMenuEvent(self, event: QContextMenuEvent) -> None:
        """Offer the automatic choices, scaling and colours."""
        self.menu(event.globalPos())

    def menu(self, at: QPoint) -> QMenu:
        """Show the menu."""
        menu = QMenu(self)
        menu.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)

        def add(to: QMenu, words: str, do: Callable[[], object], chosen: bool | None = None) -> None:
            action = to.addAction(words)
            action.triggered.connect(lambda _=False: do())
            if chosen is not None:
                action.setCheckable(True)
                action.setChecked(chosen)

        add(menu, "Automatic contrast", lambda: self.set_levels(None))
        add(menu, "Clip 0.1 % at both ends (A)", self.leave_out_tails)
        display = self.picture.display
        scaling, colours = menu.addMenu("Scaling"), menu.addMenu("Colours")
        for name, words in SCALINGS:
            add(scaling, words, lambda name=name: self._choose(scale=name), name == display.scale)  # type: ignore[misc]
        for name in COLOUR_MAPS:
            add(colours, name, lambda name=name: self._choose(colour_map=name), name == display.colour_map)  # type: ignore[misc]
        menu.popup(at)
        return menu

    def _choose(self, **changes: str) -> None:

        for picture in self.picture.sharing:
            if not picture.shot.signed:
                picture.set_display(replace(picture.display, **changes))  # type: ignore[arg-type]
        self.display_asked.emit(changes)
        self.update()
