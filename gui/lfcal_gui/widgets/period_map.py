"""The period of the array as a map: drag over it to choose a source position."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QRectF, Signal
from PySide6.QtGui import QColor
from PySide6.QtWidgets import QWidget

from lfcal_gui.models import Levels, Shot, Symbols
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets.colours import theme_table
from lfcal_gui.widgets.picture import Picture
from lfcal_gui.widgets.picture_menu import table_entries

MISSING, CROSSED = "#ff5a5f", 50
SIZES = {"x": 5, "o": 11, "s": 9}
"""Sizes of symbols (px)."""
UNKNOWN = "#222831"
"""Colour of positions without a value."""


class PeriodMap(Picture):
    """Show one value per source position ``(ny, nx)`` and let the user drag over it."""

    chosen = Signal(int, int, arguments=["y", "x"])
    """The user dragged the pointer to another position."""

    def __init__(self, quantity: str = "value", parent: QWidget | None = None) -> None:
        axes = "position x (px)", "position y (px)"
        super().__init__(quantity, axes=axes, steered=True, legend=False, colour_map="cividis", parent=parent)
        self._position: tuple[int, int] | None = None
        self.pointed = True
        """Whether the current position is marked."""
        self.lines: Callable[[str], Iterable[str]] | None = None
        """Function that yields the table that is copied and saved instead of the values."""
        self.box.setMouseEnabled(False, False)
        self.steered_to.connect(self.chosen.emit)
        self.setToolTip("Drag, or use the arrow keys, to choose the source position")

    def set_values(
        self,
        values: NDArray[Any],
        recorded: NDArray[Any] | None = None,
        *,
        marks: Mapping[str, NDArray[Any]] | None = None,
        **more: Any,
    ) -> None:
        """Show ``values`` ``(ny, nx)``; positions with ``recorded`` 0 have none, and are crossed out if they are few.

        ``marks`` contains further positions (y, x) ``(n, 2)`` by their symbol, and ``more`` contains fields of `Shot`.
        """
        values, missing = np.array(values, float), np.zeros((0, 2))
        if recorded is not None:
            lacking = np.asarray(recorded) == 0
            values[lacking] = np.nan
            missing = np.argwhere(lacking) if lacking.sum() <= CROSSED else missing
        marked = [("x", missing), *(marks or {}).items()]
        overlays = tuple(Symbols(np.asarray(at, float), symbol, MISSING, SIZES[symbol]) for symbol, at in marked)
        shown = {"name": "period", "overlays": overlays, "cross": self._cross, **more}
        self.set_shot(Shot(values, **shown))

    def entries(self) -> list[tuple[str, Callable[[], Any]]]:
        """Return the entries of the context menu."""
        if self.values is None or self.lines is None:
            return super().entries()
        return table_entries(self, self.file_name, self.lines)

    def clear(self) -> None:
        """Remove all values."""
        self.lines = None
        self.set_shot(None)

    def set_position(self, y: int, x: int) -> None:
        """Mark a position without reporting it."""
        self._position = (y, x)
        if self._cross is not None:
            self.set_cross(y, x)

    def _put(self, shot: Shot, picture: NDArray[np.uint8], place: QRectF, levels: Levels) -> None:
        """Draw positions without a value in a grey that does not occur in any colour map."""
        unknown = None if shot.values is None else np.isnan(shot.values)
        if picture.ndim == 2 and unknown is not None and unknown.any():
            picture = theme_table(self.display.colour_map)[picture]
            picture[unknown] = QColor(current_theme().raised if current_theme().red else UNKNOWN).getRgb()
        super()._put(shot, picture, place, levels)

    @property
    def _cross(self) -> tuple[int, int] | None:
        return self._position if self.pointed else None
