"""A session as it grows: positions of a plane, the frame just recorded, the plane's sum, and curves in scan order."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from PySide6.QtWidgets import QGridLayout, QLabel, QStackedWidget, QWidget

from lfcal.acquire import LiveFrame
from lfcal_gui.jobs import Jobs
from lfcal_gui.models import CUTOUT, Overlay, Shot, Symbols, cutout_of
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
    """Three pictures above three curves."""

    def __init__(self, jobs: Jobs) -> None:
        super().__init__()
        self._picture: RecordPicture | None = None
        self._light: NDArray[np.float64] | None = None
        self.map = PeriodMap()
        self.map.setToolTip("Positions of one period in this plane; empty: not recorded")
        self.map.pointed = False
        self.frame = Picture("counts", jobs=jobs)
        self.depth_sum = Picture("10³ counts")
        self.depth_sum.blank.words = NOTHING
        self.frame.setToolTip("The frame just recorded, in pixels of the region that is read")
        self.frame.blank.words = "The frame just recorded is shown here."
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
        titles = [QLabel(title) for title in (MAP, "Current frame", SUM)]
        self.map_title, _, self.third_title = titles
        for picture in (self.map, self.frame, self.depth_sum):
            picture.graphics.setMinimumSize(120, 90)
        for k, (title, view) in enumerate(zip(titles, (self.map, self.frame, self.third), strict=True)):
            panel, column = card(title)
            column.addWidget(view, 1)
            grid.addWidget(panel, 0, k)
        for k, (key, plot) in enumerate(self.curves.items()):
            panel, column = card(ElidedLabel(f"{CURVES[key]} by frame"))
            plot.graphics.setMinimumSize(120, LOW)
            for side in ("left", "bottom"):  # in a low window names beside the axes would be cut
                plot.plot.getAxis(side).showLabel(False)
            column.addWidget(plot)
            grid.addWidget(panel, 1, k)
        grid.setRowStretch(0, 5)
        grid.setRowStretch(1, 3)
        for k in range(3):
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

    def show_frame(
        self, frame: LiveFrame, point: tuple[float, float] | None, target: NDArray[np.float64] | None = None
    ) -> None:
        """Show the frame just recorded, with its cutout, or the places ``(n, 2)`` of a target's images as planned.

        Cutout and title change with the picture, which is drawn in the background.
        """
        where = frame.position
        place = "" if where is None else f", z {where.z}, y {where.y}, x {where.x}"
        caption = f"{frame.what}{place}"
        overlays: tuple[Overlay, ...] = ()
        if target is not None:
            caption = f"frame {0 if where is None else where.x + 1}: {len(target)} points as planned"
            overlays = (Symbols(target, "o", CUTOUT, 11),)
        elif frame.cutout is not None:
            row, column = frame.cutout.row - frame.roi.row, frame.cutout.column - frame.roi.column
            image = (0.0, 0.0) if point is None else (point[0] - frame.roi.row, point[1] - frame.roi.column)
            overlays = cutout_of(row, column, frame.cutout.shape, image)
        self.frame.set_shot(Shot(frame.data, caption, name="frame", overlays=overlays))

    def clear_frame(self) -> None:
        """Show no frame."""
        self.frame.set_shot(None)

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        for view in (self.map, self.frame, self.depth_sum, *self.curves.values()):
            view.apply_theme()
        if "error" in vars(self):
            self.error.apply_theme()
