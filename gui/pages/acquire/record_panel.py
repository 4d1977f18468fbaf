"""Record: how, the buttons, and the session as it grows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtWidgets import (
    QCheckBox,
    QComboBox,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QProgressBar,
    QPushButton,
    QSizePolicy,
    QSlider,
    QStackedWidget,
    QWidget,
)

from gui.jobs import Jobs
from gui.pages.acquire.error_view import TITLE, ErrorView
from gui.pages.acquire.model import EXTENTS, FIELDS, UNTIL
from gui.pages.acquire.model_recorder import QUANTITIES, RecordPicture
from gui.pages.acquire.model_until import ErrorCurve
from gui.theme import current_theme
from gui.widgets.cards import card, choice_box, column_area, line
from gui.widgets.form import Form
from gui.widgets.frame_view import FrameView
from gui.widgets.image_view import ImageView
from gui.widgets.period_map import PeriodMap
from gui.widgets.plots import LINES, LinePlot, style_axes
from lfcal.acquire.preview import LiveFrame

__all__ = ["BUTTONS", "RecordPanel"]

BUTTONS = (
    (
        "start",
        "Start",
        "Record every position into the session folder, or until H is known; a frame counts once it is safe on disk",
    ),
    ("pause", "Pause", "Finish the current position, then wait; Resume continues"),
    ("stop", "Stop", "Finish the current position, then stop; the session can be resumed later"),
    (
        "abort",
        "Abort",
        "Stop the stage now and discard the current frame; recorded positions are safe and the session can be resumed",
    ),
    ("redo", "Record again", "Record the positions listed by the Quality page again; the later frame is used"),
    (
        "assemble",
        "Assemble H …",
        "Make H of the cutouts of what is recorded, less darks where there are any",
    ),
    ("fit", "Fit", "Assemble what is recorded into H.h5 of the session's folder, and go on with it on the page Fit"),
    ("pack", "Pack", "Compress the finished recording; every frame is checked"),
)
"""Key, title and meaning of each button."""


SUM = "Depth-plane sum"

FLOORS = {"energy": 1.0, "residual": 0.1, "saturated": 1.0}
"""The least the curves' axes span, so that noise about zero is not blown up."""


class RecordPanel(QWidget):
    """The tab of the session.

    Signals
    -------
    pressed(key)
        One of `BUTTONS`.
    folder_edited(path), folder_asked()
        Another session folder; the dialog to choose one.
    view_changed()
        Another plane or quantity is to be shown.
    plane_asked(z)
        Open the H of a complete plane.
    extent_asked(key)
        One of `EXTENTS` is wanted.
    told()
        Status, detail or alarms are others.
    """

    pressed = Signal(str)
    folder_edited = Signal(str)
    folder_asked = Signal()
    view_changed = Signal()
    plane_asked = Signal(int)
    extent_asked = Signal(str)
    told = Signal()

    def __init__(self, jobs: Jobs, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.form, self.until = Form(FIELDS), Form(UNTIL)
        self.map = PeriodMap()
        self.map.setToolTip("Positions of one period in this plane; dark: not recorded yet")
        self.map.cross.hide()
        self.frame = FrameView(jobs, "acquire record frame")
        style_axes(self.frame.plot, "column in the region read (px)", "row (px)")
        self.depth_sum = ImageView(value_label="10³ counts")
        self.depth_sum.setToolTip("Sum of the plane's cutouts so far: it becomes the shape of the aperture")
        self.error, self.third = ErrorView(), QStackedWidget()
        for view in (self.depth_sum, self.error):
            self.third.addWidget(view)
        self.curves = {
            "energy": LinePlot("position in scan order", "energy (counts)"),
            "residual": LinePlot("position in scan order", "residual (px)"),
            "saturated": LinePlot("position in scan order", "saturated (px)"),
        }
        tips = (
            "Light of each position above the background: constant except for the pattern of the optics",
            "Lateral difference of measured and target position, in image pixels: below 0.1 px is good",
            "Saturated pixels in each cutout: should be 0",
        )
        for plot, tip in zip(self.curves.values(), tips, strict=True):
            plot.setToolTip(tip)
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 6, 0, 0)
        row.setSpacing(8)
        row.addWidget(column_area(306, self._session_card(), self._how_card()))
        row.addLayout(self._pictures(), 1)

    # -- building --------------------------------------------------------------------------------------
    def _session_card(self) -> QWidget:
        frame, column = card("Session")
        self.folder = QLineEdit()
        self.folder.setPlaceholderText("folder of the session")
        self.folder.setToolTip("A new or empty folder, or that of an interrupted session to resume it")
        self.folder.editingFinished.connect(lambda: self.folder_edited.emit(self.folder.text().strip()))
        browse = QPushButton("…")
        browse.setToolTip("Choose a folder")
        browse.clicked.connect(lambda: self.folder_asked.emit())
        column.addLayout(line(self.folder, browse, stretch=0))
        self.folder_words = QLabel("")
        self.folder_words.setProperty("role", "hint")
        self.folder_words.setWordWrap(True)
        column.addWidget(self.folder_words)
        self.extent = choice_box(
            EXTENTS,
            "Every position of the plan; or a few, then a fit of them, then the positions that help it most, and so on "
            "until H is known as well as wanted",
        )
        self.extent.setAccessibleName("positions to record")
        self.extent.currentIndexChanged.connect(lambda _: self.extent_asked.emit(self.extent.currentData()))
        column.addWidget(self.extent)
        column.addWidget(self.until)
        grid = QGridLayout()
        grid.setSpacing(5)
        self.buttons: dict[str, QPushButton] = {}
        for k, (key, title, tip) in enumerate(BUTTONS):
            button = QPushButton(title)
            button.setToolTip(tip)
            button.clicked.connect(lambda _=False, key=key: self.pressed.emit(key))
            self.buttons[key] = button
            button.setMinimumWidth(60)
            grid.addWidget(button, k // 2, k % 2)
        self.buttons["start"].setProperty("role", "primary")
        column.addLayout(grid)
        self.why = QLabel("")
        self.why.setProperty("role", "hint")
        self.why.setWordWrap(True)
        column.addWidget(self.why)
        return frame

    def _how_card(self) -> QWidget:
        frame, column = card("How it records")
        for key in self.form.fields:
            self.form.editor(key).setMinimumWidth(56)
        column.addWidget(self.form)
        return frame

    def _pictures(self) -> QGridLayout:
        grid = QGridLayout()
        grid.setSpacing(8)
        grid.addWidget(self._progress_card(), 0, 0, 1, 3)
        for k, (title, view) in enumerate((("Period map", self.map), ("Current frame", self.frame), (SUM, self.third))):
            label = QLabel(title)
            panel, column = card(label)
            view.setMinimumSize(120, 104)
            column.addWidget(view, 1)
            grid.addWidget(panel, 1, k)
            if view is self.frame:
                self.frame_title = label
            elif view is self.third:
                self.third_title = label
        for k, plot in enumerate(self.curves.values()):
            panel, column = card()
            plot.setMinimumSize(120, 64)
            column.addWidget(plot)
            grid.addWidget(panel, 2, k)
        grid.setRowStretch(1, 5)
        grid.setRowStretch(2, 3)
        for k in range(3):
            grid.setColumnStretch(k, 1)
        return grid

    def _progress_card(self) -> QWidget:
        frame, column = card()
        self.bar = QProgressBar()
        self.bar.setTextVisible(False)
        self.status = QLabel("Not recording.")
        self.status.setProperty("role", "heading")
        self.detail = QLabel("")
        self.detail.setProperty("role", "hint")
        # long words go on in the next line, and never make the window wider
        self.detail.setWordWrap(True)
        self.detail.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)
        column.addLayout(line(self.status, self.detail, stretch=1))
        column.addWidget(self.bar)
        self.alarms = QLabel("")
        self.alarms.setWordWrap(True)
        self.alarms.hide()
        column.addWidget(self.alarms)
        self.plane = QSlider(Qt.Orientation.Horizontal)
        self.plane.setToolTip("Depth plane of the map and the sum")
        self.plane.valueChanged.connect(self._plane_moved)
        self.plane_label = QLabel("")
        self.follow = QCheckBox("Follow")
        self.follow.setChecked(True)
        self.follow.setToolTip("Show the plane that is being recorded")
        self.quantity = QComboBox()
        for key, title in QUANTITIES:
            self.quantity.addItem(title, key)
        self.quantity.setToolTip("What the map shows of each position")
        self.quantity.currentIndexChanged.connect(lambda _: self.view_changed.emit())
        self.open_plane = QPushButton("Open plane")
        self.open_plane.setToolTip(
            "Assemble this plane, which is complete, and show its H and HT while recording continues"
        )
        self.open_plane.clicked.connect(lambda: self.plane_asked.emit(self.plane.value()))
        column.addLayout(line(self.plane_label, self.plane, self.follow, self.quantity, self.open_plane, stretch=1))
        return frame

    # -- showing ---------------------------------------------------------------------------------------
    def set_values(self, values: Mapping[str, Any], extent: str) -> None:
        """Show what the user chose; what ends a recording by the error of H only where it does."""
        blocker = QSignalBlocker(self.extent)
        self.extent.setCurrentIndex([key for key, _ in EXTENTS].index(extent))
        blocker.unblock()
        for form in (self.form, self.until):
            form.set_values({key: values[key] for key in form.fields})
        self.until.setVisible(extent == "error")

    def set_planes(self, count: int) -> None:
        """Offer so many depth planes."""
        self.plane.blockSignals(True)
        self.plane.setRange(0, max(0, count - 1))
        self.plane.setEnabled(count > 1)
        self.plane.blockSignals(False)

    def set_plane(self, z: int) -> None:
        """Show plane ``z`` without reporting it."""
        self.plane.blockSignals(True)
        self.plane.setValue(z)
        self.plane.blockSignals(False)

    def show_status(self, words: str, detail: str, fraction: float | None) -> None:
        """Show how far the session is; None: not known."""
        self.status.setText(words)
        self.detail.setText(detail)
        self.bar.setRange(0, 0 if fraction is None else 1000)
        if fraction is not None:
            self.bar.setValue(round(1000 * fraction))
        self.told.emit()

    def show_picture(self, picture: RecordPicture, plane_words: str) -> None:
        """Show map, sum, curves and alarms."""
        theme = current_theme()
        self.plane_label.setText(plane_words)
        values = picture.values
        if not np.isfinite(values).any():
            values = np.where(picture.recorded, 1.0, np.nan) if picture.recorded.any() else np.zeros(values.shape)
        self.map.set_values(values)
        self.depth_sum.set_image(picture.depth_sum / 1e3, name="depth_sum")
        for k, (key, (x, y)) in enumerate(picture.curves.items()):
            self.curves[key].set_curve(key, x, y, colour=LINES[k])
            top = float(y.max(initial=0.0))
            self.curves[key].plot.setYRange(0.0, 1.05 * max(top, FLOORS[key]), padding=0)
        words = "<br>".join(picture.alarms)
        self.alarms.setText(f"<b style='color:{theme.bad}'>{words}</b>" if words else "")
        self.alarms.setVisible(bool(words))
        self.told.emit()
        self.open_plane.setEnabled(picture.complete)

    def show_error(self, curve: ErrorCurve | None) -> None:
        """Show the error of H in the place of the depth-plane sum, or that again."""
        self.third.setCurrentWidget(self.depth_sum if curve is None else self.error)
        self.third_title.setText(SUM if curve is None else TITLE)
        if curve is not None and curve != self.error.curve:
            self.error.show_curve(curve)

    def show_frame(self, frame: LiveFrame, point: tuple[float, float] | None) -> None:
        """Show the frame just recorded, with its cutout."""
        data = frame.data
        self.frame.set_frame(data, (float(data.min()), float(max(data.max(), data.min() + 1))))
        where = frame.position
        place = "" if where is None else f", z {where.z}, y {where.y}, x {where.x}"
        self.frame_title.setText(f"Frame: {frame.what}{place}")
        if frame.cutout is not None:
            row, column = frame.cutout.row - frame.roi.row, frame.cutout.column - frame.roi.column
            image = (0.0, 0.0) if point is None else (point[0] - frame.roi.row, point[1] - frame.roi.column)
            self.frame.set_cutout(row, column, frame.cutout.shape, image)
        else:
            self.frame.clear_cutout()

    def clear_frame(self) -> None:
        """Show no frame."""
        self.frame.set_frame(None, (0, 1))
        self.frame.clear_cutout()
        self.frame_title.setText("Current frame")

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        for widget in (self.map, self.frame, self.depth_sum, self.error):
            widget.apply_theme()
        for plot in self.curves.values():
            plot.apply_theme()

    def _plane_moved(self, _: int) -> None:
        self.follow.setChecked(False)
        self.view_changed.emit()
