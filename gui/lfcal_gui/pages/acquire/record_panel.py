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

from lfcal_gui.pages.acquire._pictures import RecordPictures
from lfcal_gui.pages.acquire._words import ErrorCurve
from lfcal_gui.pages.acquire.model import EXTENTS, FIELDS, MORE, UNTIL
from lfcal_gui.pages.acquire.model_recorder import QUANTITIES, RecordPicture
from lfcal_gui.widgets import ElidedLabel, FoldedForm, card, choice_box, line, name_controls

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
    ("redo", "Record again", "Record the positions that the checks of H list again; the later frame is used"),
    (
        "assemble",
        "Assemble H …",
        "Make H of the cutouts of what is recorded, less darks where there are any",
    ),
    ("fit", "Fit", "Assemble what is recorded into H.h5 of the session's folder, and fit the optics to it"),
    ("pack", "Pack", "Compress the finished recording; every frame is checked"),
)
"""Key, title and meaning of each button."""


SINGLE = "a single point"

EXTENT_TIP = (
    "Every position of the plan; or a few, then a fit of them, then the positions that help it most, and so on until H "
    "is known as well as wanted"
)


class RecordPanel(QWidget):
    """The session as it grows; ``status_card`` and ``how`` are placed next to it.

    Signals
    -------
    pressed(key)
        One of `BUTTONS`.
    folder_edited(path), folder_asked()
        Another session folder; the dialog to choose one.
    view_changed()
        Show another plane or quantity.
    plane_asked(z)
        Open the H of a complete plane.
    extent_asked(key)
        One of `EXTENTS` is wanted.
    target_asked()
        Another source is wanted: a target of many points, or a single point again.
    told()
        Status, detail or alarms changed.
    """

    pressed = Signal(str)
    folder_edited = Signal(str)
    folder_asked = Signal()
    view_changed = Signal()
    plane_asked = Signal(int)
    extent_asked = Signal(str)
    target_asked = Signal()
    told = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        rare = "More settings of a recording", "Exposures, faults, holds, stage and drift"
        self.form, self.until = self.forms = FoldedForm(FIELDS, MORE, *rare), FoldedForm(UNTIL)
        self._picture: RecordPicture | None = None
        self._curve: ErrorCurve | None = None
        self._last_curve: ErrorCurve | None = None
        self.status_card, self.how = self._status_card(), self._how()
        self._seen = QVBoxLayout(self)
        self._seen.setContentsMargins(0, 0, 0, 0)
        self._seen.setSpacing(4)
        self.tools = self._tools()
        self.say_of_folder("")

    @cached_property
    def pictures(self) -> RecordPictures:
        """The session as it grows; made when it is first looked at, for five plots are most of what the page takes."""
        made = RecordPictures()
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
    def _status_card(self) -> QWidget:
        """Make what is seen first: how far the session is, where it goes, and the buttons that can be pressed."""
        frame, column = card()
        column.setSpacing(4)
        self.status = QLabel("Not recording.")
        self.status.setProperty("role", "heading")
        self.detail, self.why, self.folder_words, self.alarms = (QLabel("") for _ in range(4))
        self.bar = QProgressBar()
        self.bar.setTextVisible(False)
        self.alarms.setProperty("role", "error")
        for label in (self.detail, self.why, self.folder_words):
            label.setProperty("role", "hint")
        for label in (self.status, self.detail, self.why, self.folder_words, self.alarms):
            label.setWordWrap(True)
            # long words never make the window wider
            label.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)
        self.alarms.hide()
        self.folder = QLineEdit()
        self.folder.setPlaceholderText("folder of the session")
        self.folder.setToolTip("A new or empty folder, or that of an interrupted session to resume it")
        self.folder.editingFinished.connect(lambda: self.folder_edited.emit(self.folder.text().strip()))
        browse = self.folder.addAction(
            self.style().standardIcon(QStyle.StandardPixmap.SP_DirOpenIcon), QLineEdit.ActionPosition.TrailingPosition
        )
        browse.setText("Choose a folder")
        browse.setToolTip("A new folder, or that of a session to continue")
        browse.triggered.connect(lambda: self.folder_asked.emit())
        for widget in (self.status, self.bar, self.detail, self.alarms, self.folder, self.folder_words):
            column.addWidget(widget)
        column.addLayout(self._button_grid())
        column.addWidget(self.why)
        return frame

    def _button_grid(self) -> QGridLayout:
        grid = QGridLayout()
        grid.setSpacing(5)
        self.connect_button = QPushButton("Connect")
        self.connect_button.setToolTip("Connect camera and stage as chosen under Devices; nothing moves yet")
        grid.addWidget(self.connect_button, 0, 0)
        self.buttons: dict[str, QPushButton] = {}
        places = {"start": (0, 1), "pause": (0, 1), "stop": (0, 2), "abort": (0, 3), "redo": (1, 0), "assemble": (1, 1)}
        for key, title, tip in BUTTONS:
            button = QPushButton(title)
            button.setToolTip(tip)
            button.clicked.connect(lambda _=False, key=key: self.pressed.emit(key))
            self.buttons[key] = button
            grid.addWidget(button, *places.get(key, (1, 2 if key == "fit" else 3)))
        return grid

    def show_buttons(self, *, connected: bool, startable: bool) -> None:
        """Show the buttons that can be pressed now, and Start also where it only waits for the devices."""
        self.connect_button.setVisible(not connected)
        for key, button in self.buttons.items():
            button.setVisible(button.isEnabled() or (key == "start" and startable))

    def _how(self) -> QWidget:
        widget = QWidget()
        column = QVBoxLayout(widget)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(4)
        self.source, self.choose_target = ElidedLabel(SINGLE), QPushButton("Target …")
        self.source.setProperty("role", "hint")
        self.choose_target.clicked.connect(lambda: self.target_asked.emit())
        self.show_target("")
        column.addLayout(line(self.source, self.choose_target, stretch=0))
        self.extent = choice_box(EXTENTS, EXTENT_TIP)
        self.extent.setAccessibleName("positions to record")
        self.extent.currentIndexChanged.connect(lambda _: self.extent_asked.emit(self.extent.currentData()))
        column.addWidget(self.extent)
        column.addWidget(self.until)
        column.addWidget(self.form)
        return widget

    def _tools(self) -> QWidget:
        """Make what stands next to the buttons that choose the view."""
        bar = QWidget()
        self.plane = QSlider(Qt.Orientation.Horizontal)
        self.plane.setToolTip("Depth plane of the map and the sum")
        self.plane.valueChanged.connect(self._plane_moved)
        self.plane_label = ElidedLabel()
        self.follow = QCheckBox("Follow")
        self.follow.setChecked(True)
        self.follow.setToolTip("Show the plane that is being recorded")
        self.quantity = QComboBox()
        self.quantity.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        self.quantity.setMinimumContentsLength(10)
        for key, title in QUANTITIES:
            self.quantity.addItem(title, key)
        self.quantity.setToolTip("What the map shows of each position")
        self.quantity.currentIndexChanged.connect(lambda _: self.view_changed.emit())
        self.open_plane = QPushButton("Open plane")
        self.open_plane.setToolTip(
            "Assemble this plane, which is complete, and show its H and HT while recording continues"
        )
        self.open_plane.clicked.connect(lambda: self.plane_asked.emit(self.plane.value()))
        row = QHBoxLayout(bar)
        row.setContentsMargins(0, 0, 0, 0)
        for widget in (self.plane_label, self.plane, self.follow, self.quantity, self.open_plane):
            row.addWidget(widget, int(widget in (self.plane, self.plane_label)))
        return bar

    # -- showing ---------------------------------------------------------------------------------------
    def show_target(self, name: str) -> None:
        """Say which target's plan is recorded; an empty name: the scan of a single point."""
        self.source.setText(name or SINGLE)
        self.choose_target.setText("Single point" if name else "Target …")
        self.choose_target.setToolTip(
            "Record the scan of a single point again"
            if name
            else "Record frames of many points: choose a target's plan (.json), as Set up saves it"
        )

    def set_values(self, values: Mapping[str, Any], extent: str) -> None:
        """Show what the user chose; what ends a recording by the error of H only where it does."""
        blocker = QSignalBlocker(self.extent)
        self.extent.setCurrentIndex([key for key, _ in EXTENTS].index(extent))
        blocker.unblock()
        for form in self.forms:
            form.set_values(values)
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
        self.detail.setVisible(bool(detail))
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

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        if self._drawn is not None:
            self._drawn.apply_theme()

    def _plane_moved(self, _: int) -> None:
        self.follow.setChecked(False)
        self.view_changed.emit()
