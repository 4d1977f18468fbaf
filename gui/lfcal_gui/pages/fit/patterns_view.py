"""Measured, model and residual of one position side by side, and the map that it is chosen on."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtWidgets import QFrame, QGridLayout, QHBoxLayout, QLabel, QPushButton, QSlider, QVBoxLayout, QWidget

from lfcal_gui.models import Shot, levels_of
from lfcal_gui.pages.fit._place_map import PlaceMap
from lfcal_gui.pages.fit.model_run import FoundFit, Place
from lfcal_gui.pages.fit.model_words import chi2_words, place_words
from lfcal_gui.widgets import SCALINGS, Picture, choice_box, heading, link, share_contrast

__all__ = ["PatternsView"]

SIGMAS = 5.0
"""Residuals at the ends of the colours: always the same, so that noise looks like noise."""


LEGEND = "Round: fitted. Square: kept aside. Cross: left out as unlike the others."


class PatternsView(QWidget):
    """Three pictures that are panned and zoomed together; below them what they are of.

    Signals
    -------
    place_asked(place)
        Another position (z, y, x) is to be shown.
    """

    place_asked = Signal(tuple)

    def __init__(self) -> None:
        super().__init__()
        self._found: FoundFit | None = None
        self._place: Place | None = None
        self.measured, self.model, self.residual = Picture(), Picture(), Picture("residual (σ of the noise)")
        self.views = (self.measured, self.model, self.residual)
        link(*self.views)
        share_contrast(self.measured, self.model)
        grid = QGridLayout(self)
        grid.setContentsMargins(0, 6, 0, 0)
        grid.setSpacing(6)
        for column, (view, title) in enumerate(
            zip(self.views, ("Measured", "Model, same colours", "Residual"), strict=True)
        ):
            grid.addWidget(heading(title), 0, column)
            grid.addWidget(view, 1, column)
            view.hovered.connect(self._hovered)
            grid.setColumnStretch(column, 1)
        self.map = PlaceMap()
        self.map.chosen.connect(self.place_asked.emit)
        grid.addWidget(heading("χ² of each pattern of the plane, weighted by the light"), 2, 0, 1, 2)
        grid.addWidget(self.map, 3, 0, 1, 2)
        grid.addWidget(self._controls(), 2, 2, 2, 1)
        grid.setRowStretch(1, 3)
        grid.setRowStretch(3, 2)

    # -- building --------------------------------------------------------------------------------------
    def _controls(self) -> QWidget:
        frame = QFrame()
        column = QVBoxLayout(frame)
        column.setContentsMargins(8, 0, 0, 0)
        column.setSpacing(4)
        self.plane_label, self.pattern_label = QLabel(), QLabel()
        self.planes, self.patterns = QSlider(Qt.Orientation.Horizontal), QSlider(Qt.Orientation.Horizontal)
        self.planes.setToolTip("Depth plane of patterns and map (page up, page down)")
        self.patterns.setToolTip("Pattern of the plane, row by row (left, right)")
        self.planes.setAccessibleName("depth plane")
        self.patterns.setAccessibleName("pattern of the plane")
        self.planes.valueChanged.connect(self._plane_moved)
        self.patterns.valueChanged.connect(self._pattern_moved)
        for slider in (self.planes, self.patterns):
            _offer(slider, 0)
        for label, slider in ((self.plane_label, self.planes), (self.pattern_label, self.patterns)):
            row = QHBoxLayout()
            row.addWidget(label)
            row.addWidget(slider, 1)
            column.addLayout(row)
        self.words, self.readout, self.sums = _wrapped(""), _wrapped("hint"), _wrapped("")
        self.readout.setText("Point at a pixel to read it.")
        self.worst_button = QPushButton("Worst pattern")
        self.worst_button.setToolTip("The pattern that is explained worst (W)")
        self.worst_button.clicked.connect(lambda _=False: self.show_worst())
        self.scale_box = choice_box(SCALINGS, "Gamma and log bring out faint light (L, G); residuals stay linear")
        self.scale_box.currentIndexChanged.connect(lambda _: self._show_pictures())
        row = QHBoxLayout()
        row.addWidget(self.worst_button)
        row.addWidget(self.scale_box, 1)
        column.addWidget(self.words)
        column.addWidget(self.readout)
        column.addLayout(row)
        column.addStretch(1)
        column.addWidget(self.sums)
        legend = _wrapped("hint")
        legend.setText(LEGEND)
        column.addWidget(legend)
        return frame

    # -- showing ---------------------------------------------------------------------------------------
    def show_found(self, found: FoundFit) -> None:
        """Show the patterns of a fit, from the first."""
        self._found = found
        self._place = None  # the map is of the fit before, also where the plane is the same
        self.sums.setText(chi2_words(found))
        self.show_place(found.places[0])

    def clear(self) -> None:
        """Show nothing, and keep nothing of the fit."""
        self._found = self._place = None
        for view in self.views:
            view.set_shot(None)
        self.map.clear()
        for slider in (self.planes, self.patterns):
            _offer(slider, 0)
        for label in (self.words, self.sums, self.plane_label, self.pattern_label):
            label.setText("")

    @property
    def place(self) -> Place | None:
        """The position that is shown."""
        return self._place

    def show_place(self, place: Place) -> None:
        """Show a position (z, y, x) of the fit; one that it was not given is left alone."""
        found = self._found
        if found is None or place not in found.chi2:
            return
        changed = self._place is None or self._place[0] != place[0]
        self._place = place
        if changed:
            self.map.show_plane(found, place[0])
        planes = self._planes()
        self.map.show_place(place)
        _offer(self.planes, len(planes), planes.index(place[0]))
        _offer(self.patterns, len(self.map.places), self.map.places.index(place))
        self.plane_label.setText(f"Plane {place[0]}")
        self.pattern_label.setText(f"Pattern {self.patterns.value() + 1} of {len(self.map.places)}")
        self.words.setText(place_words(found, place))
        self._show_pictures()

    def _show_pictures(self) -> None:
        found, place = self._found, self._place
        if found is None or place is None:
            return
        measured, model = found.patterns[place], found.model[place]
        # both by one scale, or they could not be compared
        levels = levels_of(np.stack([measured, model]))
        name = "z{}_y{}_x{}".format(*place)
        for view, image, what in ((self.measured, measured, "measured"), (self.model, model, "model")):
            view.set_display(replace(view.display, scale=self.scale_box.currentData()))
            view.set_shot(Shot(image, "", found.unit, f"{what}_{name}", levels))
        residual = Shot(found.residual[place], name=f"residual_{name}", levels=(-SIGMAS, SIGMAS), signed=True)
        self.residual.set_shot(residual)

    def _planes(self) -> list[int]:
        return [] if self._found is None else sorted({place[0] for place in self._found.places})

    # -- stepping --------------------------------------------------------------------------------------
    def step(self, by: int) -> None:
        """Go on by so many patterns of the plane."""
        self.patterns.setValue(self.patterns.value() + by)

    def step_plane(self, by: int) -> None:
        """Go on by so many planes."""
        self.planes.setValue(self.planes.value() + by)

    def show_worst(self) -> None:
        """Ask for the pattern that is explained worst."""
        if self._found is not None:
            self.place_asked.emit(self._found.worst())

    def toggle_scale(self, scale: str) -> None:
        """Change between ``scale`` and linear."""
        chosen = "linear" if self.scale_box.currentData() == scale else scale
        self.scale_box.setCurrentIndex(self.scale_box.findData(chosen))

    def _pattern_moved(self, number: int) -> None:
        """Ask for another pattern of the plane."""
        if number < len(self.map.places):
            self.place_asked.emit(self.map.places[number])

    def _plane_moved(self, number: int) -> None:
        """Ask for the pattern of another plane that is nearest to the one shown."""
        found, place = self._found, self._place
        if found is None or place is None:
            return
        z = self._planes()[number]
        own = [one for one in found.places if one[0] == z]
        self.place_asked.emit(min(own, key=lambda one: math.hypot(one[1] - place[1], one[2] - place[2])))

    # -- pointer ---------------------------------------------------------------------------------------
    def _hovered(self, row: int, column: int, _: float) -> None:
        found, place = self._found, self._place
        if found is None or place is None or row < 0:
            for view in self.views:
                view.set_cross(None)
            return
        for view in self.views:
            view.set_cross(row, column)
        a, b, c = (float(one[place][row, column]) for one in (found.patterns, found.model, found.residual))
        off = f"{c:+.1f} σ" if found.valid[place][row, column] else "no measurement"
        self.readout.setText(f"t {row}, s {column}: measured {a:.5g}, model {b:.5g} {found.unit}; {off}")

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        for widget in (*self.views, self.map):
            widget.apply_theme()
        if self._found is not None and self._place is not None:
            self.map.show_plane(self._found, self._place[0])


def _offer(slider: QSlider, count: int, value: int = 0) -> None:
    """Let a slider choose one of ``count`` things, ``value`` now, without reporting it."""
    blocker = QSignalBlocker(slider)
    slider.setRange(0, max(0, count - 1))
    slider.setValue(value)
    blocker.unblock()
    slider.setEnabled(count > 1)


def _wrapped(role: str) -> QLabel:
    label = QLabel()
    label.setWordWrap(True)
    label.setTextFormat(Qt.TextFormat.PlainText)
    if role:
        label.setProperty("role", role)
    return label
