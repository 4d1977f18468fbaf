"""Record: how, the buttons, and the session as it grows."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtGui import QShowEvent
from PySide6.QtWidgets import (
    QCheckBox,
    QComboBox,
    QFileDialog,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QProgressBar,
    QPushButton,
    QSizePolicy,
    QSlider,
    QStyle,
    QVBoxLayout,
    QWidget,
)

from lfcal.acquire import LiveFrame
from lfcal_gui.jobs import Jobs
from lfcal_gui.pages.acquire._record_pictures import RecordPictures
from lfcal_gui.pages.acquire.model import EXTENTS, FIELDS, MORE, UNTIL
from lfcal_gui.pages.acquire.model_recorder import QUANTITIES, RecordPicture
from lfcal_gui.pages.acquire.model_until import ErrorCurve
from lfcal_gui.widgets import ElidedLabel, Folded, Form, card, choice_box, column_area, heading, line, name_controls

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


SINGLE = "a single point"

EXTENT_TIP = (
    "Every position of the plan; or a few, then a fit of them, then the positions that help it most, and so on until H "
    "is known as well as wanted"
)


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
    target_asked()
        Another source is wanted: a target of many points, or a single point again.
    told()
        Status, detail or alarms are others.
    """

    pressed = Signal(str)
    folder_edited = Signal(str)
    folder_asked = Signal()
    view_changed = Signal()
    plane_asked = Signal(int)
    extent_asked = Signal(str)
    target_asked = Signal()
    told = Signal()

    def __init__(self, jobs: Jobs, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.form, self.more, self.until = self.forms = [Form(one, dense=True) for one in (FIELDS, MORE, UNTIL)]
        self._jobs = jobs
        self._picture: RecordPicture | None = None
        self._curve: ErrorCurve | None = None
        self._last_curve: ErrorCurve | None = None
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 6, 0, 0)
        row.setSpacing(8)
        row.addWidget(column_area(306, self._session_card(), self._how_card(), dense=True))
        self._seen = QVBoxLayout()
        self._seen.setSpacing(8)
        self._seen.addWidget(self._progress_card())
        row.addLayout(self._seen, 1)
        self.say_of_folder("")

    @cached_property
    def pictures(self) -> RecordPictures:
        """The session as it grows; made when it is first looked at, for six plots are most of what the page takes."""
        made = RecordPictures(self._jobs)
        name_controls(made)
        self._seen.addWidget(made, 1)
        if self._picture is not None:
            made.show_picture(self._picture)
        made.show_error(self._curve)
        return made

    @property
    def _drawn(self) -> RecordPictures | None:
        return self.pictures if "pictures" in vars(self) else None

    def showEvent(self, event: QShowEvent) -> None:
        """Make the pictures, and ask for what they show."""
        self.pictures.show()
        super().showEvent(event)
        self.view_changed.emit()

    def say_of_folder(self, words: str) -> None:
        """Say what is in the session's folder; without words there is no room for them."""
        self.folder_words.setText(words)
        self.folder_words.setVisible(bool(words))

    # -- building --------------------------------------------------------------------------------------
    def _session_head(self) -> QHBoxLayout:
        self.source, self.choose_target = ElidedLabel(SINGLE), QPushButton("Target …")
        self.source.setProperty("role", "hint")
        self.choose_target.clicked.connect(lambda: self.target_asked.emit())
        self.show_target("")
        return line(heading("Session"), self.source, self.choose_target, stretch=1)

    def _session_card(self) -> QWidget:
        frame, column = card()
        column.setSpacing(4)
        column.addLayout(self._session_head())
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
        self.extent = choice_box(EXTENTS, EXTENT_TIP)
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
        more = Folded("More settings of a recording", "Exposures, faults, holds, stage and drift")
        for form in (self.form, self.more):
            for key in form.fields:
                form.editor(key).setMinimumWidth(56)
        column.addWidget(self.form)
        more.column.addWidget(self.more)
        positions = self.more.editor("positions")
        assert isinstance(positions, QLineEdit)
        browse = positions.addAction(
            self.style().standardIcon(QStyle.StandardPixmap.SP_DirOpenIcon), QLineEdit.ActionPosition.TrailingPosition
        )
        browse.setToolTip("Choose the file of the list")
        browse.triggered.connect(lambda: self._choose_list(positions))
        column.addWidget(more)
        return frame

    def _choose_list(self, editor: QLineEdit) -> None:
        path = QFileDialog.getOpenFileName(self, "List of positions", "", "Lists (*.json)")[0]
        if path:
            editor.setText(path)
            editor.textEdited.emit(path)

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
        self.alarms.setProperty("role", "error")
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
    def show_target(self, name: str) -> None:
        """Say which target's plan is recorded; an empty name: the scan of a single point."""
        self.source.setText(name or SINGLE)
        self.choose_target.setText("Single point" if name else "Target …")
        self.choose_target.setToolTip(
            "Record the scan of a single point again"
            if name
            else "Record frames of many points: choose a target's plan (.json), as page Plan saves it"
        )

    def set_values(self, values: Mapping[str, Any], extent: str) -> None:
        """Show what the user chose; what ends a recording by the error of H only where it does."""
        blocker = QSignalBlocker(self.extent)
        self.extent.setCurrentIndex([key for key, _ in EXTENTS].index(extent))
        blocker.unblock()
        for form in self.forms:
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
        self.plane_label.setText(plane_words)
        self._picture = picture
        if self._drawn is not None:
            self._drawn.show_picture(picture)
        words = "<br>".join(picture.alarms)
        self.alarms.setText(f"<b>{words}</b>" if words else "")
        self.alarms.setVisible(bool(words))
        self.told.emit()
        self.open_plane.setEnabled(picture.complete)

    def show_filling(self, light: NDArray[np.float64] | None, words: str = "") -> None:
        """Show H in the place of the map while it is assembled; None: what was recorded again."""
        if self._drawn is not None:
            self._drawn.show_filling(light, words)

    def show_error(self, curve: ErrorCurve | None) -> None:
        """Show the error of H in the place of the depth-plane sum, or that again."""
        self._curve, self._last_curve = curve, curve or self._last_curve
        if self._drawn is not None:
            self._drawn.show_error(curve)

    def error_curve(self) -> ErrorCurve | None:
        """Return the error of H that was shown last."""
        return self._last_curve

    def show_frame(
        self, frame: LiveFrame, point: tuple[float, float] | None, target: NDArray[np.float64] | None = None
    ) -> None:
        """Show the frame just recorded, with its cutout, or the places of a target's images."""
        self.pictures.show_frame(frame, point, target)

    def clear_frame(self) -> None:
        """Show no frame."""
        if self._drawn is not None:
            self._drawn.clear_frame()

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        if self._drawn is not None:
            self._drawn.apply_theme()

    def _plane_moved(self, _: int) -> None:
        self.follow.setChecked(False)
        self.view_changed.emit()
