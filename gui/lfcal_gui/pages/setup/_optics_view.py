"""The optics drawn to scale: main lens or objective on the left, the array and the sensor magnified on the right."""

from __future__ import annotations

import math

from PySide6.QtCore import QPointF, QRectF, Qt
from PySide6.QtGui import QColor, QPainter, QPainterPath, QPaintEvent, QPen
from PySide6.QtWidgets import QWidget

from lfcal.base import format_length
from lfcal.camera import Camera, LensletLattice, MainLens, preset
from lfcal_gui.theme import TYPE_COLOURS, current_theme
from lfcal_gui.widgets import offer_menu

PITCH_LABEL = 84.0
"""Width of the label of the pitch, next to the sensor (screen pixels)."""


class OpticsView(QWidget):
    """Two drawings to scale: the whole camera, and a few lenslets over the sensor."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._camera = preset("bench")
        self.setMinimumSize(420, 150)
        offer_menu(self, lambda: "camera")
        self.setToolTip("Left: main optics and array along the axis. Right: lenslets, gap and sensor, magnified")

    def set_camera(self, camera: Camera) -> None:
        """Draw ``camera``."""
        self._camera = camera
        self.update()

    def apply_theme(self) -> None:
        """Redraw in the colours of the theme."""
        self.update()

    def paintEvent(self, event: QPaintEvent) -> None:
        """Draw both parts."""
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        split = self.width() * 0.58
        self._draw_camera(painter, QRectF(8, 8, split - 24, self.height() - 16))
        self._draw_array(painter, QRectF(split + 8, 8, self.width() - split - 16, self.height() - 16))
        painter.end()

    # -- the whole camera --------------------------------------------------------------------------------
    def _draw_camera(self, p: QPainter, box: QRectF) -> None:
        theme = current_theme()
        optics = self._camera.optics
        if isinstance(optics, MainLens):
            before, behind = optics.working_distance_um, optics.image_distance_um
            half = optics.focal_length_um / optics.f_number / 2
        else:  # unfolded: the tube lens images the pupil at infinity onto the array
            behind = optics.tube_length_um
            before = behind / optics.magnification * 4
            half = behind / (2 * optics.working_f_number)
        axis = box.center().y() - 6
        scale = min(box.width() / (before + behind), (box.height() / 2 - 22) / max(half, 1e-9))
        scale = min(scale, box.width() / (before + behind))
        left = box.left() + (box.width() - (before + behind) * scale) / 2
        lens, array = left + before * scale, left + (before + behind) * scale
        height = max(half * scale, 6.0)
        p.setPen(QPen(QColor(theme.line), 1, Qt.PenStyle.DashLine))
        p.drawLine(QPointF(left, axis), QPointF(array, axis))
        p.setPen(QPen(QColor(theme.accent), 1.2))
        for sign in (-1, 1):
            p.drawLine(QPointF(left, axis), QPointF(lens, axis + sign * height))
            p.drawLine(QPointF(lens, axis + sign * height), QPointF(array, axis))
        self._draw_lens(p, lens, axis, height * 1.15)
        p.setPen(QPen(QColor(theme.text), 2))
        p.drawLine(QPointF(array, axis - height), QPointF(array, axis + height))
        p.setBrush(QColor(theme.bad))
        p.setPen(Qt.PenStyle.NoPen)
        p.drawEllipse(QPointF(left, axis), 3.5, 3.5)
        to_scale = not optics.telecentric
        self._dimension(p, left, lens, axis + height * 1.15 + 10, format_length(before) if to_scale else "")
        if not to_scale:  # above, where there is room for words
            self._words(p, left, lens, axis - height * 1.15 - 22, "objective (not to scale)")
        self._dimension(p, lens, array, axis + height * 1.15 + 10, format_length(behind))

    def _draw_lens(self, p: QPainter, x: float, y: float, half: float) -> None:
        bulge = min(8.0, half / 3)
        path = QPainterPath(QPointF(x, y - half))
        path.quadTo(QPointF(x + bulge, y), QPointF(x, y + half))
        path.quadTo(QPointF(x - bulge, y), QPointF(x, y - half))
        theme = current_theme()
        fill = QColor(theme.accent)
        fill.setAlpha(60)
        p.setBrush(fill)
        p.setPen(QPen(QColor(theme.accent), 1.4))
        p.drawPath(path)
        p.setBrush(Qt.BrushStyle.NoBrush)

    def _dimension(self, p: QPainter, a: float, b: float, y: float, text: str) -> None:
        theme = current_theme()
        p.setPen(QPen(QColor(theme.muted), 1))
        p.drawLine(QPointF(a, y), QPointF(b, y))
        for x in (a, b):
            p.drawLine(QPointF(x, y - 3), QPointF(x, y + 3))
        self._words(p, a, b, y + 2, text)

    def _words(self, p: QPainter, a: float, b: float, y: float, text: str) -> None:
        """Draw a text centred between ``a`` and ``b``, shifted such that it is completely within the drawing."""
        p.setPen(QColor(current_theme().text))
        wide = p.fontMetrics().horizontalAdvance(text) + 2
        left = max(0.0, min((a + b - wide) / 2, self.width() - wide))
        p.drawText(QRectF(left, y, wide, 16), Qt.AlignmentFlag.AlignHCenter, text)

    # -- lenslets and sensor -----------------------------------------------------------------------------
    def _draw_array(self, p: QPainter, box: QRectF) -> None:
        theme = current_theme()
        lattice = self._camera.lattice
        shown, pitch_um, types, word = 5, lattice.clear_um, 1, "lenslet"
        if isinstance(lattice, LensletLattice):
            pitch_um, types, word = lattice.pitch_um, len(lattice.types), "pitch"
        assert pitch_um is not None
        across, along = box.height() - 30, box.width() - PITCH_LABEL
        # slow lenslets are drawn shorter than they are: they would be too narrow to be seen
        scale = min(across / (shown * pitch_um), max(along / lattice.gap_um, 6 / pitch_um))
        gap, pitch = min(lattice.gap_um * scale, along), pitch_um * scale
        x0 = box.left() + (box.width() - PITCH_LABEL - gap) / 2
        middle = box.center().y() - 4
        clear = lattice.clear_diameter_um * scale / 2
        half_cone = min(math.atan(0.5 / self._camera.optics.working_f_number), 1.4)
        for k in range(shown):
            y = middle + (k - (shown - 1) / 2) * pitch
            colour = QColor(TYPE_COLOURS[k % types])
            self._draw_lenslet(p, x0, y, clear, colour)
            cone = QColor(colour)
            cone.setAlpha(46)
            p.setBrush(cone)
            p.setPen(Qt.PenStyle.NoPen)
            reach = gap * math.tan(half_cone)
            p.drawPolygon([QPointF(x0, y), QPointF(x0 + gap, y - reach), QPointF(x0 + gap, y + reach)])
            p.setBrush(Qt.BrushStyle.NoBrush)
        p.setPen(QPen(QColor(theme.text), 2))
        span = shown / 2 * pitch
        p.drawLine(QPointF(x0 + gap, middle - span), QPointF(x0 + gap, middle + span))
        self._dimension(p, x0, x0 + gap, middle + span + 6, f"gap {format_length(lattice.gap_um)}")
        p.setPen(QColor(theme.muted))
        text = f"{word}\n{format_length(pitch_um)}"
        p.drawText(QRectF(x0 + gap + 8, middle - 18, 70, 40), Qt.AlignmentFlag.AlignVCenter, text)

    def _draw_lenslet(self, p: QPainter, x: float, y: float, half: float, colour: QColor) -> None:
        path = QPainterPath(QPointF(x, y - half))
        path.quadTo(QPointF(x - min(half * 0.7, 10), y), QPointF(x, y + half))
        path.closeSubpath()
        p.setBrush(colour)
        p.setPen(Qt.PenStyle.NoPen)
        p.drawPath(path)
        p.setBrush(Qt.BrushStyle.NoBrush)
