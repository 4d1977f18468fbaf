"""Apertures side by side: the depth-plane sum of each plane with the fitted and the expected outline."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QPointF, QSize, Qt, Signal
from PySide6.QtGui import QColor, QIcon, QImage, QPainter, QPen, QPixmap, QPolygonF, QResizeEvent
from PySide6.QtWidgets import QListWidget, QListWidgetItem

from lfcal.base import format_plane
from lfcal_gui.models import DisplaySettings, levels_of, minus, to_uint8
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets.colours import outline_pen, theme_table

if TYPE_CHECKING:
    from lfcal.camera import ScanPlan
    from lfcal.psf.aperture import Aperture

FITTED, EXPECTED = "#39d353", "#56b4e9"
"""Colours of the outlines, which differ from all colours of pictures."""

RED_FITTED, RED_EXPECTED = "#ff8a5c", "#7d2a20"
"""Colours of the outlines in the red theme."""


def outline_tones() -> tuple[str, str]:
    """Return the colours of fitted and expected outlines in the current theme."""
    return (RED_FITTED, RED_EXPECTED) if current_theme().red else (FITTED, EXPECTED)


def legend_words(between: str = "<br>") -> str:
    """Return the meaning of the outlines as rich text."""
    fitted, expected = outline_tones()
    return f"<span style='color:{fitted}'>━</span> fit{between}<span style='color:{expected}'>┅</span> expected"


LEAST, WORD = 84, 16
"""Smallest width of a tile with its depth, and height of the word below it (px)."""


@dataclass(frozen=True, eq=False)
class PlaneTile:
    """Data of a plane: depth (µm), depth-plane sum ``(nt, ns)``, and apertures.

    ``shape`` is the shape of the cutout, if only the expected aperture is shown. A plane that is being recorded has a
    ``word`` for its state and the recorded fraction (``progress``), and a ``merit`` as soon as it was judged. For a
    simulated plane, ``made`` states how it was computed.
    """

    depth_um: float
    image: NDArray[Any] | None = None
    fitted: Aperture | None = None
    expected: Aperture | None = None
    shape: tuple[int, int] | None = None
    word: str = ""
    progress: float | None = None
    merit: str = ""
    made: str = ""

    def outlines(self) -> tuple[tuple[str, Qt.PenStyle, NDArray[np.float64]], ...]:
        """Return colour, pen and points (row, column) of the outlines over the sum."""
        fitted, expected = outline_tones()
        pens = ((fitted, Qt.PenStyle.SolidLine, self.fitted), (expected, Qt.PenStyle.DashLine, self.expected))
        # an outline is unknown if the sum is too dim or too small
        return tuple((colour, pen, one.outline()) for colour, pen, one in pens if one is not None and one.seen)

    def picture(self, side: int, ratio: float = 1.0) -> QPixmap:
        """Return a square pixmap with a side of ``side`` points, each of ``ratio`` screen pixels."""
        pixels = round(side * ratio)
        shape = self.shape if self.image is None else self.image.shape
        found = QPixmap(pixels, pixels) if self.image is None else to_pixmap(self.image, pixels)
        if self.image is None:
            found.fill(Qt.GlobalColor.transparent if shape is None else QColor(current_theme().canvas))
        if self.progress is not None or self.merit:
            self._draw_state(found, ratio)
        if shape is not None:
            self._draw(found, found.width() / shape[1], found.height() / shape[0], ratio)
        found.setDevicePixelRatio(ratio)
        return found

    def _draw_state(self, on: QPixmap, ratio: float) -> None:
        """Draw the recorded fraction as a bar, and the merit as a dot: filled if good, otherwise a ring."""
        theme, painter = current_theme(), QPainter(on)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if self.progress is not None:
            height = round(3 * ratio)
            painter.fillRect(0, on.height() - height, on.width(), height, QColor(theme.line))
            done = round(self.progress * on.width())
            painter.fillRect(0, on.height() - height, done, height, QColor(theme.accent))
        if self.merit:
            tone = QColor(getattr(theme, self.merit, theme.muted))
            painter.setPen(QPen(tone, 2 * ratio))
            painter.setBrush(tone if self.merit == "good" else Qt.BrushStyle.NoBrush)
            painter.drawEllipse(QPointF(on.width() - 8 * ratio, 8 * ratio), 3.5 * ratio, 3.5 * ratio)
        painter.end()

    def _draw(self, on: QPixmap, across: float, down: float, ratio: float) -> None:
        painter = QPainter(on)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        for colour, style, points in self.outlines():
            painter.setPen(outline_pen(QColor(colour), 1.3 * ratio, style))
            # centres of pixels have whole numbers
            painter.drawPolygon(QPolygonF([QPointF((s + 0.5) * across, (t + 0.5) * down) for t, s in points.tolist()]))
        painter.end()


def expected_apertures(plan: ScanPlan) -> list[Aperture | None]:
    """Return the expected apertures of the planes of a plan, for `Strip.show_expected`.

    Call it in the background: the first outline loads a compiled function.
    """
    from lfcal.psf.aperture import expected_aperture

    found = [expected_aperture(plan.camera, depth, plan.cutout) for depth in plan.depths_um]
    for one in found:
        if one is not None and one.seen:
            one.outline()
    return found


def to_pixmap(image: NDArray[Any], side: int, colour_map: str = "magma") -> QPixmap:
    """Return ``image`` as a square pixmap with a side of ``side`` points."""
    data = to_uint8(image, DisplaySettings(), levels_of(image))
    rgba = np.ascontiguousarray(theme_table(colour_map)[data])
    picture = QImage(rgba.data, rgba.shape[1], rgba.shape[0], 4 * rgba.shape[1], QImage.Format.Format_RGBA8888)
    return QPixmap.fromImage(picture.copy()).scaled(
        side, side, Qt.AspectRatioMode.KeepAspectRatio, Qt.TransformationMode.SmoothTransformation
    )


class Strip(QListWidget):
    """A row of small pictures of planes, with the depth below each.

    Parameters
    ----------
    tip
        Function that returns the tooltip of a plane from its index, its tile and the number of planes.
    side
        Side of a picture (px).
    wrapping
        Whether the pictures are arranged in several rows.
    worded
        Whether a word on the state is shown below each depth.
    """

    chosen = Signal(int, arguments=["z"])
    """Another plane was clicked."""

    def __init__(
        self, tip: Callable[[int, PlaneTile, int], str], side: int = 76, *, wrapping: bool = False, worded: bool = False
    ) -> None:
        super().__init__()
        self._tip, self._side, self._wrapping = tip, side, wrapping
        words = WORD * worded
        self._height = side + 30 + words
        self.tiles: list[PlaneTile] = []
        self.setViewMode(QListWidget.ViewMode.IconMode)
        self.setFlow(QListWidget.Flow.LeftToRight)
        self.setWrapping(wrapping)
        self.setResizeMode(QListWidget.ResizeMode.Adjust)
        self.setMovement(QListWidget.Movement.Static)
        self.setIconSize(QSize(side, side))
        self.setGridSize(QSize(max(side + 18, LEAST), side + 26 + words))
        self.setAccessibleName("Apertures of all planes")
        if not wrapping:
            self.setFixedHeight(self._height)
            self.setVerticalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setToolTip("Depth-plane sums: the aperture as seen from each depth. Click to choose a plane")
        self.currentRowChanged.connect(self._changed)

    def offer(self, depths_um: Sequence[float], shape: tuple[int, int]) -> None:
        """Show planes at these depths (µm), with cutouts of a shape; the selected plane stays selected."""
        tiles, z = [PlaneTile(depth, shape=shape) for depth in depths_um], self.currentRow()
        if [(one.depth_um, one.shape) for one in self.tiles] != [(one.depth_um, one.shape) for one in tiles]:
            self.show_tiles(tiles)
            self.set_current(min(z, len(tiles) - 1))

    def show_expected(self, apertures: Sequence[Aperture | None]) -> None:
        """Draw the expected apertures of the planes. None: the plane is in focus, or its aperture is not visible."""
        for z, one in enumerate(apertures):
            self.set_tile(z, expected=one)

    def set_planes(self, depths: NDArray[np.float64]) -> None:
        """Make an empty tile for each plane."""
        self.show_tiles([PlaneTile(float(depth)) for depth in depths])

    def show_tiles(self, tiles: list[PlaneTile]) -> None:
        """Show the data of all planes."""
        self.blockSignals(True)
        self.clear()
        self.tiles = []
        for z, tile in enumerate(tiles):
            self.addItem(QListWidgetItem(format_plane(tile.depth_um, z)))
            self.tiles.append(tile)
            self._show(z, count=len(tiles))
        self.blockSignals(False)
        self._fit()

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Reserve space for the scroll bar if not all planes fit."""
        super().resizeEvent(event)
        self._fit()

    def _fit(self) -> None:
        if not self._wrapping:
            scrolled = self.count() * self.gridSize().width() > self.viewport().width()
            bar = self.horizontalScrollBar().sizeHint().height() if scrolled else 0
            self.setFixedHeight(self._height + bar)

    def set_tile(self, z: int, **known: Any) -> None:
        """Update fields of the `PlaneTile` of plane ``z``."""
        if z < len(self.tiles):
            tile = replace(self.tiles[z], **known)
            # drawing a tile is slow, and usually nothing changed
            if any(not _same(value, getattr(self.tiles[z], key)) for key, value in known.items()):
                self.tiles[z] = tile
                self._show(z, count=len(self.tiles))

    def _show(self, z: int, count: int) -> None:
        tile, item = self.tiles[z], self.item(z)
        picture = tile.picture(self._side, self.devicePixelRatioF())
        icon = QIcon(picture)
        icon.addPixmap(picture, QIcon.Mode.Selected)  # else Qt tints the selected one
        item.setIcon(icon)
        item.setText("\n".join(filter(None, (minus(format_plane(tile.depth_um, z)), tile.word))))
        item.setToolTip(self._tip(z, tile, count))

    def apply_theme(self) -> None:
        """Redraw all pictures in the colours of the current theme."""
        for z in range(len(self.tiles)):
            self._show(z, count=len(self.tiles))

    def set_current(self, z: int) -> None:
        """Select a plane without reporting it."""
        self.blockSignals(True)
        self.setCurrentRow(z)
        self.blockSignals(False)

    def _changed(self, row: int) -> None:
        if row >= 0:
            self.chosen.emit(row)


def _same(one: object, other: object) -> bool:
    return one is other or (isinstance(one, (str, float)) and one == other)
