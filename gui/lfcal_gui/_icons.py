"""Icons of the pages, drawn by themselves with `lfcal_gui.models.page.Sketch`; none are fetched."""

from __future__ import annotations

from collections.abc import Callable

from PySide6.QtCore import QPointF, QRectF, Qt
from PySide6.QtGui import QColor, QIcon, QPainter, QPen, QPixmap, QPolygonF

from lfcal_gui.models import ICON_SIDE, Sketch

__all__ = ["icon_of"]


class PainterSketch:
    """A `Sketch` on a painter: lines with the painter's pen, fillings in the colour of the pen."""

    def __init__(self, painter: QPainter) -> None:
        self._painter = painter

    def line(self, *points: tuple[float, float]) -> None:
        """Draw straight lines from point (x, y) to point."""
        self._painter.drawPolyline(QPolygonF([QPointF(x, y) for x, y in points]))

    def circle(self, x: float, y: float, radius: float, *, filled: bool = False) -> None:
        """Draw a circle about (x, y)."""
        self._fill(filled)
        self._painter.drawEllipse(QPointF(x, y), radius, radius)

    def box(self, x: float, y: float, width: float, height: float, *, radius: float = 0, filled: bool = False) -> None:
        """Draw a rectangle with its upper left corner at (x, y), its corners rounded by ``radius``."""
        self._fill(filled)
        self._painter.drawRoundedRect(QRectF(x, y, width, height), radius, radius)

    def _fill(self, filled: bool) -> None:
        self._painter.setBrush(self._painter.pen().color() if filled else Qt.BrushStyle.NoBrush)


def icon_of(draw: Callable[[Sketch], None], colour: str, selected: str = "", size: int = ICON_SIDE) -> QIcon:
    """Return what ``draw`` draws as a line icon, in the colour ``selected`` where it stands on the accent."""
    icon = QIcon(_drawn(draw, colour, size))
    if selected:
        icon.addPixmap(_drawn(draw, selected, size), QIcon.Mode.Selected)
    return icon


def _drawn(draw: Callable[[Sketch], None], colour: str, size: int) -> QPixmap:
    """Draw at twice the size, for sharp screens."""
    pixmap = QPixmap(size * 2, size * 2)
    pixmap.setDevicePixelRatio(2.0)
    pixmap.fill(Qt.GlobalColor.transparent)
    painter = QPainter(pixmap)
    painter.setRenderHint(QPainter.RenderHint.Antialiasing)
    painter.setPen(QPen(QColor(colour), 1.6, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap))
    painter.scale(size / ICON_SIDE, size / ICON_SIDE)
    draw(PainterSketch(painter))
    painter.end()
    return pixmap
