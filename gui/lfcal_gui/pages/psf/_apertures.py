"""The apertures of all planes, large, in a separate window."""

from __future__ import annotations

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QDialog, QLabel, QVBoxLayout, QWidget

from lfcal_gui.pages.psf.model_aperture import aperture_tip
from lfcal_gui.theme import style_sheet
from lfcal_gui.widgets import PlaneTile, Strip, legend_words

__all__ = ["Apertures", "tip_of"]

LARGE = 200
SIZE = (930, 640)


def tip_of(z: int, tile: PlaneTile, count: int) -> str:
    """Return what is known of the aperture of plane ``z`` of ``count`` planes."""
    return aperture_tip(z, tile.depth_um, count, tile.fitted, tile.expected)


class Apertures(QDialog):
    """The apertures of all planes, large, in a separate window; it follows the strip while it is open.

    Signals
    -------
    chosen(z)
        A plane was clicked.
    """

    chosen = Signal(int)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Apertures of all planes")
        self.resize(*SIZE)
        self.grid = Strip(tip_of, LARGE, wrapping=True)
        self.grid.chosen.connect(self.chosen.emit)
        column = QVBoxLayout(self)
        self.legend = QLabel()
        column.addWidget(self.legend)
        column.addWidget(self.grid, 1)
        self.apply_theme()

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        self.setStyleSheet(style_sheet())
        self.legend.setText(legend_words(" &nbsp; "))
        self.grid.apply_theme()
