"""One of several pictures of a view, as something that can be measured in, copied and saved."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import pyqtgraph as pg
from numpy.typing import NDArray
from PySide6.QtCore import QPoint, Signal
from PySide6.QtWidgets import QWidget

from lfcal_gui.widgets._measured import MeasuredView

__all__ = ["MeasuredPart", "entries_at"]

Levels = tuple[float, float]


class MeasuredPart(MeasuredView, QWidget):
    """What `lfcal_gui.widgets._measuring.Measuring` needs of a picture; never shown itself.

    Parameters
    ----------
    parent
        The view that draws it.
    plot, name, value
        Where it is drawn; what it is called in files; its quantity with the unit.
    refresh
        Draws the view anew, when the contrast was changed.
    """

    picture_changed = Signal()

    def __init__(
        self, parent: QWidget, plot: pg.PlotItem, name: str, value: str, refresh: Callable[[MeasuredPart], object]
    ) -> None:
        super().__init__(parent)
        self.hide()
        self.plot, self.name, self.value = plot, name, value
        self._refresh = refresh
        self._image: NDArray[Any] | None = None
        self._levels: Levels = (0.0, 1.0)
        self._origin = (0.0, 0.0)

    def take(self, image: NDArray[Any] | None, levels: Levels = (0.0, 1.0), origin: Levels = (0.0, 0.0)) -> Levels:
        """Remember a picture whose first pixel is at ``origin``; return its levels: the user's, or ``levels``."""
        self._image, self._origin = image, origin
        self._levels = self.contrast or levels
        self.picture_changed.emit()
        return self._levels

    def measured(self) -> NDArray[Any] | None:
        """Return the picture."""
        return self._image

    def placed(self) -> tuple[tuple[float, float], float]:
        """Return the coordinates of the first pixel and the length of a pixel."""
        return self._origin, 1.0

    def shown_levels(self) -> Levels:
        """Return the values at the ends of the colours."""
        return self._levels

    def set_contrast(self, levels: Levels | None) -> None:
        """Show these values in this and the next pictures, whatever the page says; None: what the page says."""
        if levels != self.contrast:
            self.contrast = levels
            self._refresh(self)

    def quantity(self) -> str:
        """Return what the values are, with the unit."""
        return self.value

    def file_name(self) -> str:
        """Return what the picture is called in files."""
        return self.name


def entries_at(
    graphics: pg.GraphicsLayoutWidget, parts: Sequence[MeasuredPart], point: QPoint
) -> list[tuple[str, Callable[[], Any]]]:
    """Return what a menu offers for the picture at a point of the view."""
    place = graphics.mapToScene(point)
    return next((part.entries() for part in parts if part.plot.sceneBoundingRect().contains(place)), [])
