"""The period of the array as a map: drag over it to choose a source position."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import Signal
from PySide6.QtWidgets import QWidget

from lfcal_gui.models import Shot, Symbols
from lfcal_gui.widgets.picture import Picture

__all__ = ["PeriodMap"]

MISSING = "#ff5a5f"


class PeriodMap(Picture):
    """Show one value per source position ``(ny, nx)`` and let the user drag over it.

    Signals
    -------
    chosen(y, x)
        The pointer is held on another position.
    """

    chosen = Signal(int, int)

    def __init__(self, quantity: str = "value", parent: QWidget | None = None) -> None:
        axes = "position x (px)", "position y (px)"
        super().__init__(quantity, axes=axes, steered=True, legend=False, colour_map="cividis", parent=parent)
        self._position: tuple[int, int] | None = None
        self.pointed = True
        """Whether the position that is looked at is pointed out."""
        self.box.setMouseEnabled(False, False)
        self.steered_to.connect(self.chosen.emit)
        self.setToolTip("Drag to choose the source position; arrow keys step")

    def set_values(self, values: NDArray[Any], recorded: NDArray[Any] | None = None) -> None:
        """Show ``values`` ``(ny, nx)``; positions with ``recorded`` 0 are crossed out."""
        missing = np.zeros((0, 2)) if recorded is None else np.argwhere(np.asarray(recorded) == 0).astype(float)
        overlays = (Symbols(missing, "x", MISSING, 5),)
        self.set_shot(Shot(np.asarray(values, float), name="period", overlays=overlays, cross=self._cross))

    def clear(self) -> None:
        """Show no values."""
        self.set_shot(None)

    def set_position(self, y: int, x: int) -> None:
        """Point out a position without reporting it."""
        self._position = (y, x)
        if self._cross is not None:
            self.set_cross(y, x)

    @property
    def _cross(self) -> tuple[int, int] | None:
        return self._position if self.pointed else None
