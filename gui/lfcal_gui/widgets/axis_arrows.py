"""Arrows over a picture: directions in which the stage axes move the image, and directions of the sensor's axes."""

from __future__ import annotations

from PySide6.QtCore import QEvent, QObject, QPointF, QSize, Qt
from PySide6.QtGui import QColor, QPainter, QPaintEvent, QPen, QPolygonF
from PySide6.QtWidgets import QWidget

from lfcal_gui.theme import current_theme

WIDTH, HEIGHT, MARGIN = 184, 132, 14
MIDDLE, LENGTH = QPointF(82, 82), 24.0
"""Start and length of the stage's arrows (px)."""

STAGE, SENSOR, GROUND = QColor("#ffb000"), QColor("#d0d4dc"), QColor(0, 0, 0, 205)
"""Colours that are distinct on any picture. The background is dark in every theme, as frames are."""


class AxisArrows(QWidget):
    """Arrows of a fixed size in the corner of another widget, which still receives all mouse events.

    The arrows of the sensor's row and column start in the corner, at its first pixel. The arrows of the stage start in
    the middle; each points where the image moves when that axis moves in the positive direction.
    """

    def __init__(self, parent: QWidget) -> None:
        super().__init__(parent)
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self.setProperty("overlay", True)  # overlaps the picture on purpose
        self.setFixedSize(WIDTH, HEIGHT)
        parent.installEventFilter(self)
        self.arrows: tuple[tuple[str, float, float], ...] = ()

    def sizeHint(self) -> QSize:
        """Return the fixed size."""
        return QSize(WIDTH, HEIGHT)

    def eventFilter(self, parent: QObject, event: QEvent) -> bool:
        """Keep the arrows in the lower right corner when the widget is resized."""
        if event.type() == QEvent.Type.Resize and isinstance(parent, QWidget):
            self.move(parent.width() - WIDTH - MARGIN, parent.height() - HEIGHT - MARGIN)
        return False

    def set_arrows(self, arrows: tuple[tuple[str, float, float], ...]) -> None:
        """Show the arrows of the stage: labels, and directions (down, right) in which the image moves."""
        self.arrows = arrows
        words = [f"stage {text} moves the image {sense(down, right)}" for text, down, right in arrows]
        self.setAccessibleDescription("; ".join(words))
        self.update()

    def paintEvent(self, _: QPaintEvent) -> None:
        """Draw background, sensor axes and stage axes."""
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(GROUND)
        painter.drawRoundedRect(self.rect(), 6, 6)
        font = painter.font()
        font.setPixelSize(11)
        painter.setFont(font)
        corner, theme = QPointF(18, 12), current_theme()
        sensor, stage = (QColor(theme.muted), QColor(theme.text)) if theme.red else (SENSOR, STAGE)
        _arrow(painter, corner, (0.0, 1.0), sensor, "column")
        _arrow(painter, corner, (1.0, 0.0), sensor, "row")
        for words, down, right in self.arrows:
            _arrow(painter, MIDDLE, (down, right), stage, f"stage {words}")
        painter.end()


def sense(down: float, right: float) -> str:
    """Return the word for a direction on the screen."""
    if abs(right) >= abs(down):
        return "right" if right > 0 else "left"
    return "down" if down > 0 else "up"


def _arrow(painter: QPainter, start: QPointF, direction: tuple[float, float], colour: QColor, words: str) -> None:
    """Draw an arrow (down, right) from ``start`` with its label at the tip."""
    down, right = direction
    along, across = QPointF(right, down), QPointF(-down, right)
    end = start + along * LENGTH
    painter.setPen(QPen(colour, 2))
    painter.drawLine(start, end - along * 4)
    painter.setPen(Qt.PenStyle.NoPen)
    painter.setBrush(colour)
    painter.drawPolygon(QPolygonF([end, end - along * 8 + across * 4, end - along * 8 - across * 4]))
    painter.setPen(colour)
    wide, high = painter.fontMetrics().horizontalAdvance(words), painter.fontMetrics().ascent()
    at = end + along * (6 + (wide if right else high) / 2)
    # keep the label of an arrow at the edge inside
    painter.drawText(QPointF(max(3.0, at.x() - wide / 2), at.y() + high / 2 - 1), words)
