"""A session as it grows: positions of a plane, the plane's sum, and curves in scan order."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from PySide6.QtWidgets import QGridLayout, QLabel, QStackedWidget, QWidget

from lfcal_gui.models import Shot
from lfcal_gui.pages.acquire._error_view import TITLE, ErrorView
from lfcal_gui.pages.acquire.model_recorder import RecordPicture
from lfcal_gui.pages.acquire.model_until import ErrorCurve
from lfcal_gui.widgets import (
    LINES,
    ElidedLabel,
    LinePlot,
    PeriodMap,
    Picture,
    card,
    name_controls,
)

__all__ = ["RecordPictures"]

MAP, SUM, COVERED = "Period map", "Depth-plane sum", "Phases covered"
NOTHING = "Nothing recorded in this plane yet."
NO_SUM = "A target's frames show many positions at once: no sum grows before they are assembled."

CURVES = {"energy": "Energy (counts)", "residual": "Residual (px)", "saturated": "Saturated (px)"}
LOW = 56
"""Least height of a curve (px)."""

FLOORS = {"energy": 1.0, "residual": 0.1, "saturated": 1.0}
"""The least the curves' axes span, so that noise about zero is not blown up."""


class RecordPictures(QWidget):
    """Two pictures above three curves."""

    def __init__(self) -> None:
        super().__init__()
        self._picture: RecordPicture | None = None
        self._light: NDArray[np.float64] | None = None
        self.map = PeriodMap()
        self.map.setToolTip("Positions of one period in this plane; empty: not recorded")
        self.map.pointed = False
        self.depth_sum = Picture("10³ counts")
        self.depth_sum.blank.words = NOTHING
        self.depth_sum.setToolTip("Sum of the plane's cutouts so far: it becomes the shape of the aperture")
        self.third = QStackedWidget()
        self.third.addWidget(self.depth_sum)
        self.curves = {
            key: LinePlot("position in scan order", words.lower(), counted=True) for key, words in CURVES.items()
        }
        tips = (
            "Light of each position above the background: constant except for the pattern of the optics",
            "Lateral difference of measured and target position, in image pixels: below 0.1 px is good",
            "Saturated pixels in each cutout: should be 0",
        )
        for plot, tip in zip(self.curves.values(), tips, strict=True):
            plot.setToolTip(tip)
        self._arrange()

    def _arrange(self) -> None:
        grid = QGridLayout(self)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setSpacing(8)
        self.map_title, self.third_title = QLabel(MAP), QLabel(SUM)
        for picture in (self.map, self.depth_sum):
            picture.graphics.setMinimumSize(120, 90)
        for k, (title, view) in enumerate(((self.map_title, self.map), (self.third_title, self.third))):
            panel, column = card(title)
            column.addWidget(view, 1)
            grid.addWidget(panel, 0, 3 * k, 1, 3)
        for k, (key, plot) in enumerate(self.curves.items()):
            panel, column = card(ElidedLabel(f"{CURVES[key]} by frame"))
            plot.graphics.setMinimumSize(120, LOW)
            for side in ("left", "bottom"):  # in a low window names beside the axes would be cut
                plot.plot.getAxis(side).showLabel(False)
            column.addWidget(plot)
            grid.addWidget(panel, 1, 2 * k, 1, 2)
        grid.setRowStretch(0, 5)
        grid.setRowStretch(1, 3)
        for k in range(6):
            grid.setColumnStretch(k, 1)

    @cached_property
    def error(self) -> ErrorView:
        """The error of H; made for a session that ends by it."""
        view = ErrorView()
        name_controls(view)
        view.graphics.setMinimumSize(120, 90)
        self.third.addWidget(view)
        return view

    def show_picture(self, picture: RecordPicture) -> None:
        """Show map, sum and curves."""
        self._picture = picture
        self._show_map()
        self._title_sum()
        if self._light is None:
            self.map_title.setText(COVERED if picture.covered else MAP)
        self.depth_sum.blank.words = NO_SUM if picture.covered else picture.reading.capitalize() or NOTHING
        seen = picture.depth_sum / 1e3 if picture.depth_sum.any() else None
        self.depth_sum.set_shot(Shot(seen, name="depth_sum"))
        for k, (key, (x, y)) in enumerate(picture.curves.items()):
            self.curves[key].set_curve(key, x, y, colour=LINES[k])
            top = float(y.max(initial=0.0))
            self.curves[key].plot.setYRange(0.0, 1.05 * max(top, FLOORS[key]), padding=0)

    def _show_map(self) -> None:
        """Show H while it fills, and else what was recorded."""
        if self._light is not None:
            self.map.set_values(self._light)
        elif self._picture is not None:
            values, recorded = self._picture.values, self._picture.recorded
            if self._picture.covered:
                self.map.set_values(values, recorded)
                return
            if not np.isfinite(values).any():
                values = np.where(recorded, 1.0, np.nan)
            self.map.set_values(values)

    def show_filling(self, light: NDArray[np.float64] | None, words: str) -> None:
        """Show the light ``(ny, nx)`` of the patterns of a plane of H that is being assembled; None: none is."""
        self._light = light
        self.map_title.setText(MAP if light is None else words)
        self._show_map()

    def show_error(self, curve: ErrorCurve | None) -> None:
        """Show the error of H in the place of the depth-plane sum, or that again."""
        self.third.setCurrentWidget(self.depth_sum if curve is None else self.error)
        self._title_sum()
        if curve is not None and curve != self.error.curve:
            self.error.show_curve(curve)

    def _title_sum(self) -> None:
        """Say how much of the sum is read where it is not all of it."""
        reading = "" if self._picture is None else self._picture.reading
        if self.third.currentWidget() is not self.depth_sum:
            self.third_title.setText(TITLE)
        else:
            self.third_title.setText(f"{SUM}: {reading}" if reading else SUM)

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        for view in (self.map, self.depth_sum, *self.curves.values()):
            view.apply_theme()
        if "error" in vars(self):
            self.error.apply_theme()
