"""Measured, model and residual of one fitted position, in place of H and HT."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from PySide6.QtWidgets import QHBoxLayout, QVBoxLayout, QWidget

from lfcal_gui.models import DisplaySettings, Shot, levels_of
from lfcal_gui.pages.h.model_fit_run import FoundFit, Place
from lfcal_gui.pages.h.model_fit_words import place_words
from lfcal_gui.widgets import Contrast, Picture, link, share_contrast

SIGMAS = 5.0
"""Residuals at the ends of the colours: always the same, so that noise looks like noise."""


class FitPictures(QWidget):
    """Three pictures that are panned and zoomed together; measured and model share one scale."""

    def __init__(self) -> None:
        super().__init__()
        self._found: FoundFit | None = None
        self.place: Place | None = None
        """The position (z, y, x) that is shown."""
        self.words = ""
        """Where the pattern is, what became of it, and how well it is explained."""
        self.measured, self.model = Picture(legend=False), Picture(legend=False)
        self.residual = Picture("residual (σ of the noise)", legend=False)
        self.views = (self.measured, self.model, self.residual)
        link(*self.views)
        share_contrast(self.measured, self.model)
        self.contrast = Contrast(self.measured)
        row = QHBoxLayout()
        for view in self.views:
            view.hovered.connect(self._hovered)
            row.addWidget(view, 1)
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(2)
        column.addLayout(row, 1)
        column.addWidget(self.contrast)

    def show_fit(self, found: FoundFit | None) -> None:
        """Show the patterns of a fit, from the first; None: nothing, and nothing of the fit is kept."""
        if found is self._found:
            return
        self._found, self.place, self.words = found, None, ""
        for view in self.views:
            view.set_shot(None)

    def show_place(self, place: Place) -> None:
        """Show the fitted pattern that is nearest to a position (z, y, x), in its plane if that has one."""
        found = self._found
        if found is None:
            return
        own = [one for one in found.places if one[0] == place[0]] or found.places
        self.place = nearest = min(own, key=lambda one: math.dist(one, place))
        self.words = place_words(found, nearest)
        measured, model = found.patterns[nearest], found.model[nearest]
        levels = levels_of(np.stack([measured, model]))
        name = "z{}_y{}_x{}".format(*nearest)
        for view, image, what in ((self.measured, measured, "measured"), (self.model, model, "model")):
            view.set_shot(Shot(image, what.capitalize(), found.unit, f"{what}_{name}", levels))
        ends = (-SIGMAS, SIGMAS)
        self.residual.set_shot(Shot(found.residual[nearest], "Residual", "", f"residual_{name}", ends, signed=True))

    def step(self, by: int) -> Place | None:
        """Return the position ``by`` patterns further in the plane that is shown, row by row."""
        if self._found is None or self.place is None:
            return None
        own = [one for one in self._found.places if one[0] == self.place[0]]
        return own[max(0, min(len(own) - 1, own.index(self.place) + by))]

    def step_plane(self, by: int) -> Place | None:
        """Return the nearest position in the plane ``by`` fitted planes further."""
        if self._found is None or self.place is None:
            return None
        planes = sorted({one[0] for one in self._found.places})
        z = planes[max(0, min(len(planes) - 1, planes.index(self.place[0]) + by))]
        own = [one for one in self._found.places if one[0] == z]
        return min(own, key=lambda one: math.dist(one, self.place or one))

    def set_display(self, display: DisplaySettings) -> None:
        """Use scaling and colours; residuals stay linear."""
        for view in self.views[:2]:
            view.set_display(replace(display))
        self.contrast.update()

    def _hovered(self, row: int, column: int, _: float) -> None:
        found, place = self._found, self.place
        if found is None or place is None or row < 0:
            for view in self.views:
                view.set_cross(None)
            self.residual.set_note("")
            return
        for view in self.views:
            view.set_cross(row, column)
        a, b, c = (float(one[place][row, column]) for one in (found.patterns, found.model, found.residual))
        off = f"{c:+.1f} σ" if found.valid[place][row, column] else "no measurement"
        self.residual.set_note(f"t {row}, s {column}: measured {a:.5g}, model {b:.5g} {found.unit}; {off}")

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        for widget in (*self.views, self.contrast):
            widget.apply_theme()
