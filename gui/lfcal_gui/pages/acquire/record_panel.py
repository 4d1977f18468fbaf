"""Widgets of a recording: settings, buttons, planes, and pictures of the session."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QSignalBlocker, Signal
from PySide6.QtGui import QShowEvent
from PySide6.QtWidgets import (
    QGridLayout,
    QLabel,
    QLineEdit,
    QProgressBar,
    QPushButton,
    QSizePolicy,
    QWidget,
)

from lfcal.base import format_length
from lfcal_gui.models import plane_words
from lfcal_gui.pages.acquire._pictures import RecordPictures
from lfcal_gui.pages.acquire.model import EXTENTS, FIELDS, MORE, UNTIL
from lfcal_gui.pages.acquire.model_recorder import QUANTITIES, ErrorCurve, RecordPicture
from lfcal_gui.widgets import (
    ElidedLabel,
    FoldedForm,
    PeriodMap,
    PlaneTile,
    Strip,
    add_chooser,
    button,
    choice_box,
    column_of,
    line,
    name_controls,
    wrapped,
)

if TYPE_CHECKING:
    pass

BUTTONS = (
    (
        "start",
        "Start",
        "Record every position, or chosen positions until H is accurate enough. A frame counts when it is saved to "
        "disk",
    ),
    ("pause", "Pause", "Finish the current position, then wait; Resume continues"),
    ("stop", "Stop", "Finish the current position, then stop; the session can be resumed later"),
    (
        "abort",
        "Abort",
        "Stop the stage now and discard the current frame; recorded positions are safe and the session can be resumed",
    ),
    ("redo", "Record again", "Record again the positions listed by the checks of H. The newer frames are used"),
    (
        "assemble",
        "Assemble H …",
        "Make H from the cutouts of the recorded frames, minus the dark frames if there are any",
    ),
    ("fit", "Fit", "Assemble H.h5 in the session's folder, and show the fit of the session or the settings for a fit"),
    ("pack", "Pack", "Compress the finished recording; every frame is checked"),
)
"""Key, title and meaning of each button."""


SINGLE = "a single point"
OPEN_PLANE = "Assemble this plane, which is complete, and show its H and HT while recording continues"

EXTENT_TIP = (
    "Every position of the plan, or chosen positions. Chosen: a few are recorded and fitted, then the most informative "
    "ones are added until H reaches the error you set"
)

SIDE, MAP, LEAST_MAP = 52, 104, 90
"""Side of a tile of the strip, and height and smallest width of the map (px)."""


class RecordPanel(QWidget):
    """Panel with the pictures of a session; ``strip``, ``progress``, ``map_box`` and ``how`` are placed next to it."""

    pressed = Signal(str, arguments=["key"])
    """One of `BUTTONS`."""
    folder_edited, folder_asked = Signal(str, arguments=["path"]), Signal()
    """The user typed another session folder, or asks for the dialog to choose one."""
    view_changed = Signal()
    """Another plane or quantity was selected."""
    noted = Signal()
    """Status, details, alarms or values changed."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        rare = "More settings of a recording", "Exposures, faults, pauses, stage and drift"
        self.form, self.until = self.forms = FoldedForm(FIELDS, MORE, *rare), FoldedForm(UNTIL)
        self._picture: RecordPicture | None = None
        self._curve: ErrorCurve | None = None
        self._last_curve: ErrorCurve | None = None
        self._light: NDArray[np.float64] | None = None
        self.strip = Strip(_tip, SIDE, worded=True)
        self.strip.setToolTip(
            "Planes of the scan. Click one to show it; the stage moves there if it is connected and not in use"
        )
        self.progress, self.map_box = self._progress(), self._map_box()
        self.how = self._how()
        self._seen = column_of(of=self, spacing=4)
        self.tools = self._tools()
        self.say_of_folder("")

    @cached_property
    def pictures(self) -> RecordPictures:
        """Pictures of the session, made when they are first shown because their plots are slow to create."""
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

    @property
    def z(self) -> int:
        """Index of the selected plane."""
        return max(0, self.strip.currentRow())

    def showEvent(self, event: QShowEvent) -> None:
        """Create the pictures, and request their content."""
        self.pictures.show()
        super().showEvent(event)
        self.view_changed.emit()

    def say_of_folder(self, words: str) -> None:
        """Show a description of the session's folder; without a text, the line is hidden."""
        self.folder_words.setText(words)
        self.folder_words.setVisible(bool(words))

    # -- building --------------------------------------------------------------------------------------
    def _progress(self) -> QWidget:
        """Create the progress display, with the reason why a recording cannot start or how it ended."""
        self.status, self.detail, self.alarms = _words("heading"), _words("hint"), _words("error")
        self.bar = QProgressBar(textVisible=False)
        self.alarms.hide()
        widget = QWidget()
        column_of(self.status, self.bar, self.detail, self.alarms, of=widget, spacing=4)
        widget.hide()
        return widget

    def _map_box(self) -> QWidget:
        """Create the box for the map of the selected plane, with the choice of the quantity as title."""
        self.quantity = choice_box(QUANTITIES, "Quantity that the map shows for each position", "quantity of the map")
        self.quantity.currentIndexChanged.connect(lambda _: self.view_changed.emit())
        self.map_words = ElidedLabel(role="hint")
        self.map_words.setToolTip(
            "Range of the values in the map; for a target of many points, the fraction of the phases that are covered. "
            "A fit of the optics predicts the other phases"
        )
        widget = QWidget()
        column_of(line(self.quantity, self.map_words, stretch=1), of=widget, spacing=4)
        widget.hide()
        return widget

    @cached_property
    def map(self) -> PeriodMap:
        """The map, which is created when there is content for it."""
        made = PeriodMap()
        made.setToolTip("Positions of one period in this plane; grey: not recorded")
        made.pointed = False
        made.graphics.setMinimumSize(LEAST_MAP, LEAST_MAP)
        made.setFixedHeight(MAP)
        for side in ("left", "bottom"):
            made.plot.getAxis(side).hide()
        self.map_box.layout().addWidget(made)
        name_controls(self.map_box)
        return made

    def _folder_line(self) -> QLineEdit:
        folder = QLineEdit(placeholderText="folder of the session")
        folder.setToolTip("A new or empty folder, or the folder of an interrupted session to resume")
        folder.editingFinished.connect(lambda: self.folder_edited.emit(folder.text().strip()))
        name = "Choose a new folder, or the folder of a session to continue"
        add_chooser(folder, name, f"{name} (Alt+Down)").connect(lambda: self.folder_asked.emit())
        return folder

    def _button_grid(self) -> QGridLayout:
        grid = QGridLayout()
        grid.setSpacing(5)
        self.buttons: dict[str, QPushButton] = {}
        for k, (key, title, tip) in enumerate(BUTTONS):
            made = self.buttons[key] = button(title, tip, lambda key=key: self.pressed.emit(key))
            grid.addWidget(made, k // 4, k % 4)
        return grid

    def show_buttons(self, *, startable: bool) -> None:
        """Show the enabled buttons, and also Start if only the devices are missing."""
        for key, one in self.buttons.items():
            one.setVisible(one.isEnabled() or (key == "start" and startable))

    def _how(self) -> QWidget:
        self.folder, self.folder_words, self.why = self._folder_line(), _words("hint"), _words("hint")
        self.source, self.choose_target = ElidedLabel(SINGLE), QPushButton("Target …")
        self.source.setProperty("role", "hint")
        self.show_target("")
        self.extent = choice_box(EXTENTS, EXTENT_TIP, "positions to record")
        where = (self.folder, self.folder_words, self._button_grid(), self.why)
        source = line(self.source, self.choose_target, stretch=0)
        widget = QWidget()
        column_of(*where, source, self.extent, self.until, self.form, of=widget, spacing=4)
        return widget

    def _tools(self) -> QWidget:
        bar = QWidget()
        self.plane_label = ElidedLabel()
        self.open_plane = button("Open plane", OPEN_PLANE)
        row = line(self.plane_label, self.open_plane, stretch=0)
        row.setContentsMargins(0, 0, 0, 0)
        bar.setLayout(row)
        return bar

    # -- showing ---------------------------------------------------------------------------------------
    def show_target(self, name: str) -> None:
        """Show the name of the target plan to record; empty: the scan of a single point."""
        self.source.setText(name or SINGLE)
        self.choose_target.setText("Single point" if name else "Target …")
        self.choose_target.setToolTip(
            "Record the scan of a single point again"
            if name
            else "Record frames of many points. Choose the plan of a target (.json), which you saved in Set up"
        )

    def set_values(self, values: Mapping[str, Any], extent: str) -> None:
        """Show the settings; the target error of H only if it ends the recording."""
        with QSignalBlocker(self.extent):
            self.extent.setCurrentIndex([key for key, _ in EXTENTS].index(extent))
        for form in self.forms:
            form.set_values(values)
        self.until.setVisible(extent == "error")
        self.noted.emit()

    def show_merits(self, merits: Sequence[str]) -> None:
        """Show the merit of each plane according to the checks of H; empty: not judged."""
        for z in range(len(self.strip.tiles)):
            self.strip.set_tile(z, merit=merits[z] if z < len(merits) else "")

    def set_plane(self, z: int) -> None:
        """Show plane ``z`` without reporting it."""
        self.strip.set_current(z)

    def show_status(self, words: str, detail: str, fraction: float | None) -> None:
        """Show status, details and completed fraction (None: unknown); without a status, the display is hidden."""
        self.status.setText(words)
        self.detail.setText(detail)
        self.detail.setVisible(bool(detail))
        self.bar.setRange(0, 0 if fraction is None else 1000)
        if fraction is not None:
            self.bar.setValue(round(1000 * fraction))
        self._show_progress()

    def _show_progress(self) -> None:
        self.progress.setVisible(bool(self.status.text() or self.alarms.text()))
        self.noted.emit()

    def show_picture(self, picture: RecordPicture, plane_words: str) -> None:
        """Show map, sum, curves and alarms; ``plane_words`` name the plane."""
        self.plane_label.setText(plane_words + ", complete" * picture.complete)
        self._picture = picture
        if self._drawn is not None:
            self._drawn.show_picture(picture)
        words = "<br>".join(picture.alarms)
        self.alarms.setText(f"<b>{words}</b>" if words else "")
        self.alarms.setVisible(bool(words))
        self._show_progress()
        self.open_plane.setEnabled(picture.complete)
        self._show_map()
        self._show_planes(picture)

    def _show_planes(self, picture: RecordPicture) -> None:
        """Show the recorded fraction of each plane, and the depth-plane sum of the selected one.

        For a target, the fraction is not shown as progress, because even a complete recording covers only some phases.
        """
        known = any(picture.planes) and not picture.covered
        for z, share in enumerate(picture.planes):
            word = "recorded" if share == 1 else f"{100 * share:.0f} %" if share else "to come"
            partly = share if 0 < share < 1 and known else None
            self.strip.set_tile(z, word=word if known else "", progress=partly)
        seen = picture.depth_sum
        self.strip.set_tile(self.z, image=seen if seen.any() else None)

    def _show_map(self) -> None:
        picture = self._picture
        self.map_box.setVisible(self._light is not None or (picture is not None and any(picture.planes)))
        self.quantity.setVisible(self._light is None and not (picture is not None and picture.covered))
        if self.map_box.isHidden():
            return
        if self._light is not None:
            self.map.set_values(self._light)
        elif picture is not None and picture.covered:
            share = picture.planes[self.z] if self.z < len(picture.planes) else 0.0
            self.map_words.setText(f"{100 * share:.0f} % of the phases are covered")
            self.map.set_values(picture.values, picture.recorded)
        elif picture is not None:
            self.map_words.setText(picture.spread(self.quantity.currentData()))
            known = np.isfinite(picture.values).any()
            self.map.set_values(picture.values if known else np.where(picture.recorded, 1.0, np.nan))

    def show_filling(self, light: NDArray[np.float64] | None, words: str = "") -> None:
        """Show H instead of the map during its assembly. None: show the map of the recording again."""
        self._light = light
        self.map_words.setText(words)
        self._show_map()

    def show_error(self, curve: ErrorCurve | None) -> None:
        """Show the error of H in place of the depth-plane sum; None: show the sum again."""
        self._curve, self._last_curve = curve, curve or self._last_curve
        if self._drawn is not None:
            self._drawn.show_error(curve)

    def error_curve(self) -> ErrorCurve | None:
        """Return the error curve that was shown last."""
        return self._last_curve

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        self.strip.apply_theme()
        for name in ("map", "pictures"):
            if name in vars(self):
                getattr(self, name).apply_theme()


def _words(role: str) -> QLabel:
    """Return a label whose text never makes the window wider."""
    label = wrapped(role)
    label.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)
    return label


def _tip(z: int, tile: PlaneTile, count: int) -> str:
    state = ", ".join(filter(None, (tile.word, f"H is {tile.merit} here" if tile.merit else "")))
    return "\n".join(filter(None, (f"{plane_words(z, count)}: z = {format_length(tile.depth_um)}", state)))
