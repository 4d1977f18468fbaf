"""The white image with both lattices over it, or a map of how the micro-images depart from one."""

from __future__ import annotations

import numpy as np
from PySide6.QtWidgets import QLabel, QStackedWidget, QVBoxLayout, QWidget

from lfcal_gui.models import Outline, Shot, Symbols
from lfcal_gui.pages.setup.model_check import Checked
from lfcal_gui.pages.setup.model_lattice_map import DISTORTION, RESIDUALS, LatticeMap
from lfcal_gui.widgets import Picture, choice_box

__all__ = ["LatticeView"]

PICTURE = "picture"
SHOWN = ((PICTURE, "White image"), (DISTORTION, "Distortion"), (RESIDUALS, "Residuals"))
LEGENDS = {
    PICTURE: "First corner of the frame: + as measured, ○ as described.",
    DISTORTION: "From straight rows to where micro-images are seen, up to {largest:.2f} px in the frame",
    RESIDUALS: "From the lattice to the micro-images, mean of each cell, up to {largest:.3f} px",
}
STRAIGHT = "The lattice is straight: there is no distortion to draw."
LENSLETS = 12
"""Lenslets seen along a side of the picture."""


class LatticeView(QWidget):
    """A picture, what to show in it, and how to read it."""

    def __init__(self) -> None:
        super().__init__()
        self.choice = choice_box(SHOWN, "Picture with both lattices, or how the micro-images depart from a lattice")
        self.choice.setAccessibleName("Picture of the lattice")
        self.choice.currentIndexChanged.connect(lambda _: self._show())
        self.legend = QLabel()
        self.legend.setProperty("role", "hint")
        self.legend.setWordWrap(True)
        self.image = Picture(legend=False, colour_map="gray")
        self.map = Picture("displacement (px)", axes=("column (px)", "row (px)"), colour_map="cividis")
        self.stack = QStackedWidget()
        for view in (self.image, self.map):
            self.stack.addWidget(view)
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(3)
        column.addWidget(self.choice)
        column.addWidget(self.stack, 1)
        column.addWidget(self.legend)
        self._found: Checked | None = None

    def show_check(self, found: Checked) -> None:
        """Show what was found, as it is chosen."""
        self._found = found
        marks = Symbols(found.described, "o", "#ffffff", 11), Symbols(found.centres, "+", "#ff5a5f", 9)
        self.image.set_shot(Shot(found.picture, name=found.name, step=found.step, overlays=marks), keep_view=False)
        self._look_at_corner(found)
        self._show()

    def _look_at_corner(self, found: Checked) -> None:
        """Show a corner, where differences are largest; the menu shows all."""
        side = LENSLETS * (found.check.fit.pitch_px if found.check.fit is not None else 30.0)
        if found.picture is not None:
            side = min(side, found.step * max(found.picture.shape))
        self.image.show_part(-2, -2, side, side, padding=0)

    def _show(self) -> None:
        if self._found is None:
            return
        name = self.choice.currentData()
        shown = self._found.maps.get(name)
        self.stack.setCurrentWidget(self.image if name == PICTURE else self.map)
        if shown is not None:
            self._draw(name, shown)
        elif name == PICTURE:
            self.legend.setText(LEGENDS[PICTURE])
        else:
            self.map.set_shot(None)
            fitted = self._found.check.fit is not None
            self.legend.setText(STRAIGHT if fitted else "No lattice was fitted.")

    def _draw(self, name: str, shown: LatticeMap) -> None:
        first = (shown.cell - 1) / 2
        top = max(shown.largest, 1e-3)
        pairs = np.asarray(shown.arrows, float).reshape(-1, 2, 2)
        arrows = tuple(Outline(pair, closed=False, width=1.2) for pair in pairs)
        shot = Shot(shown.size, "", "", name, (0.0, top), origin=(first, first), step=shown.cell, overlays=arrows)
        self.map.set_shot(shot, keep_view=False)
        drawn = f"; arrows {shown.gain:.2g} times too long." if shown.largest else "."
        self.legend.setText(LEGENDS[name].format(largest=shown.largest) + drawn)

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        self.image.apply_theme()
        self.map.apply_theme()
