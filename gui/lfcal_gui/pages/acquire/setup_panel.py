"""Set up: devices, live view with exact numbers, stage, and what a few moves tell."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QCheckBox, QDoubleSpinBox, QHBoxLayout, QLabel, QPushButton, QVBoxLayout, QWidget

from lfcal.camera import ScanPlan
from lfcal_gui.jobs import Jobs
from lfcal_gui.models import DisplaySettings, Overlay, Shot, cutout_of
from lfcal_gui.pages.acquire._device_panel import DevicePanel
from lfcal_gui.pages.acquire._fault_panel import FaultPanel
from lfcal_gui.pages.acquire.model_live import LivePicture, age_words, expected_words
from lfcal_gui.pages.acquire.model_stills import KINDS
from lfcal_gui.pages.acquire.stage_panel import StagePanel
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets import (
    NOTHING,
    AxisArrows,
    ElidedLabel,
    LinePlot,
    Picture,
    card,
    column_area,
    heading,
    line,
    split,
)

__all__ = ["FINDINGS", "SetupPanel"]

EXPOSURE = 104
"""Least width of the box of the exposure (px)."""

FINDINGS = (
    (
        "stage",
        "Scale, rotation, sign",
        "Move to five places and fit how the image follows: with a wrong sign H is useless but looks plausible",
    ),
    (
        "axis",
        "Optical axis",
        "Look at 45 places in the first and the last plane, and find where a move in depth does not shift the image",
    ),
    (
        "exposure",
        "Exposure per plane",
        "Find for each plane the exposure that uses 70 % of the camera's range without saturation",
    ),
)
"""Key, title and meaning of what can be found."""


class SetupPanel(QWidget):
    """The tab before the session.

    Signals
    -------
    live_toggled(on), exposure_edited(seconds)
        The live view.
    find_asked(key), use_asked(key)
        Measure one of `FINDINGS`, or record one of `KINDS`; take what was found into the plan.
    """

    live_toggled = Signal(bool)
    exposure_edited = Signal(float)
    find_asked = Signal(str)
    use_asked = Signal(str)

    def __init__(self, jobs: Jobs, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.devices, self.stage, self.faults = DevicePanel(), StagePanel(), FaultPanel()
        self.view = Picture("counts", jobs=jobs)
        self.view.hovered.connect(self._hovered)
        self.histogram = LinePlot("sample value (counts)", "pixels")
        self.histogram.plot.setLogMode(False, True)
        self.view.blank.words = "Connect devices, then switch the live view on."
        self.histogram.blank.words = "Shows every pixel of the live view."
        self.seen = Picture("counts above background", legend=False)
        self.predicted = Picture("share of the light", legend=False)
        self._said: dict[str, tuple[str, bool, bool]] = {}
        self._counted: int | None = None
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 6, 0, 0)
        row.setSpacing(8)
        row.addWidget(column_area(300, self.devices, self.stage, *self._cards(), self.faults, dense=True))
        self.split = split(self._view_card(), self._numbers(), sizes=(3, 2))
        row.addWidget(self.split, 1)
        self.set_connected(False)

    # -- building --------------------------------------------------------------------------------------
    def _view_card(self) -> QWidget:
        frame, column = card()
        self.live = QPushButton("Live")
        self.live.setCheckable(True)
        self.live.setToolTip("Grab frames one after the other; every pixel of every frame is counted")
        self.live.toggled.connect(self.live_toggled.emit)
        self.exposure = QDoubleSpinBox()
        self.exposure.setRange(0.01, 60_000)
        self.exposure.setDecimals(2)
        self.exposure.setMinimumWidth(EXPOSURE)  # the longest exposures are rare, and widen the window
        self.exposure.setSuffix(" ms")
        self.exposure.setKeyboardTracking(False)
        self.exposure.setStepType(QDoubleSpinBox.StepType.AdaptiveDecimalStepType)
        self.exposure.setToolTip("Exposure of the live view; the plan's exposures stay as they are")
        self.exposure.valueChanged.connect(lambda ms: self.exposure_edited.emit(ms / 1e3))
        self._make_boxes()
        whole, near = QPushButton("Whole"), QPushButton("Near")
        whole.setToolTip("Show the whole frame")
        near.setToolTip("Zoom to the predicted cutout")
        whole.clicked.connect(self.view.show_all)
        near.clicked.connect(self._zoom)
        column.addLayout(line(self.live, self.exposure, self.lattice, self.cutout, self.axes, self.log))
        column.addWidget(self.view, 1)
        self.readout = ElidedLabel()
        self.readout.setProperty("role", "hint")
        self.age = QLabel()
        self.age.setToolTip("How long ago this frame was read, and whether the stage has moved since")
        column.addLayout(line(self.readout, self.age, whole, near, stretch=0))
        self._last: tuple[LivePicture, ScanPlan] | None = None
        self._waiting = True
        return frame

    def _make_boxes(self) -> None:
        """Make the switches of what is drawn over the frame, and the arrows."""
        self.lattice = QCheckBox("Lattice")
        self.lattice.setToolTip("Micro-image centres of the described camera, coloured by lens type")
        self.cutout = QCheckBox("Cutout")
        self.cutout.setChecked(True)
        self.cutout.setToolTip("Where the plan expects the image (cross) and the cutout around it (square)")
        self.axes = QCheckBox("Axes")
        self.axes.setChecked(True)
        self.axes.setToolTip("Where moves of the stage move the image by the plan, and how the sensor counts")
        self.arrows = AxisArrows(self.view)
        self.axes.toggled.connect(self.arrows.setVisible)
        self.log = QCheckBox("Log")
        self.log.setToolTip("Four decades below the brightest pixel instead of a linear scale")
        for box in (self.lattice, self.cutout):
            box.toggled.connect(lambda _: self._show_overlays())
        self.log.toggled.connect(lambda on: self.view.set_display(DisplaySettings("log" if on else "linear")))

    def _cards(self) -> tuple[QWidget, QWidget]:
        """Make the cards of what is measured and what is recorded before the session."""
        self.find_buttons: dict[str, QPushButton] = {}
        self.use_buttons: dict[str, QPushButton] = {}
        self.results: dict[str, QLabel] = {}
        return self._find_card("Find by moving", FINDINGS), self._find_card("White and dark", KINDS)

    def _find_card(self, heading_: str, offered: Sequence[tuple[str, str, str]]) -> QWidget:
        frame, column = card(heading_)
        for key, title, tip in offered:
            button, use, result = QPushButton(title), QPushButton("Use"), QLabel("")
            button.setToolTip(tip)
            use.setToolTip(f"Take what was found into the plan: {title.lower()}; undo takes it back")
            use.setAccessibleName(f"Use: {title}")
            use.hide()
            result.setWordWrap(True)
            result.setTextFormat(Qt.TextFormat.RichText)
            result.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
            result.hide()
            button.clicked.connect(lambda _=False, k=key: self.find_asked.emit(k))
            use.clicked.connect(lambda _=False, k=key: self.use_asked.emit(k))
            self.find_buttons[key], self.use_buttons[key], self.results[key] = button, use, result
            column.addLayout(line(button, use, stretch=0))
            column.addWidget(result)
        return frame

    def _numbers(self) -> QVBoxLayout:
        column = QVBoxLayout()
        column.setSpacing(8)
        column.addWidget(self._levels_card(), 4)
        column.addWidget(self._spot_card())
        column.addWidget(self._pair_card(), 4)
        return column

    def _levels_card(self) -> QWidget:
        frame, column = card("Every pixel of the frame")
        self.numbers = QLabel("–")
        self.saturated = QLabel("")
        self.saturated.setToolTip("Number of pixels at the camera's highest value; H is wrong there")
        for label in (self.numbers, self.saturated):
            label.setTextFormat(Qt.TextFormat.RichText)
        self.numbers.setWordWrap(True)
        self.histogram.graphics.setMinimumHeight(80)
        column.addWidget(self.histogram, 1)
        column.addWidget(self.numbers)
        column.addWidget(self.saturated)
        return frame

    def _spot_card(self) -> QWidget:
        frame, column = card("Light of the source")
        self.spot = QLabel("–")
        self.spot.setWordWrap(True)
        self.spot.setTextFormat(Qt.TextFormat.RichText)
        self.spot.setToolTip(
            "Centroid of the light above the background; sharpness compares neighbouring pixels (larger is sharper, "
            "whatever the brightness); seen − predicted: rows, columns"
        )
        column.addWidget(self.spot)
        return frame

    def _pair_card(self) -> QWidget:
        frame, column = card()
        self.correlation = QLabel("")
        self.correlation.setProperty("role", "hint")
        self.correlation.setWordWrap(True)
        self.correlation.setToolTip(
            "Normalised correlation of the two pictures; 1 for the same pattern, whatever its brightness"
        )
        pictures = QHBoxLayout()
        for title, view, tip in (
            ("Seen", self.seen, "What the camera sees in the predicted cutout, above the background"),
            ("Predicted", self.predicted, "The reference H at this position, or rays through the described camera"),
        ):
            half = QVBoxLayout()
            half.addWidget(heading(title))
            view.setToolTip(tip)
            half.addWidget(view, 1)
            pictures.addLayout(half)
        column.addLayout(pictures, 1)
        column.addWidget(self.correlation)
        return frame

    # -- showing ---------------------------------------------------------------------------------------
    def set_connected(self, connected: bool, *, free: bool = True) -> None:
        """Enable what needs devices; ``free``: nothing else uses them now."""
        for widget in (self.live, *self.find_buttons.values()):
            widget.setEnabled(connected and free)
        for button in self.use_buttons.values():  # what was found can be used without the devices
            button.setEnabled(free)
        self.stage.set_free(connected and free)
        self.stage.stop.setEnabled(connected)
        if not connected:
            self.live.setChecked(False)

    def set_exposure(self, seconds: float) -> None:
        """Show the exposure without reporting it (s)."""
        self.exposure.blockSignals(True)
        self.exposure.setValue(1e3 * seconds)
        self.exposure.blockSignals(False)

    def show_live(self, picture: LivePicture, plan: ScanPlan, note: str = "") -> None:
        """Show a live frame of a plan; ``note`` is put after the correlation."""
        if picture.frame is None:
            self.numbers.setText(picture.numbers)
            return
        self._last = picture, plan
        if self._waiting:
            self._waiting = False
            self.readout.setText(" ")
        self.view.set_shot(self._shot_of(picture))
        middle = (picture.edges[1:] + picture.edges[:-1]) / 2
        self.histogram.set_curve("pixels", middle, np.maximum(picture.counts, 0.5))
        self.numbers.setText(picture.numbers)
        self._counted = picture.saturated
        self._show_saturated()
        self.spot.setText(picture.spot)
        self.view.set_lattice(plan.camera if self.lattice.isChecked() else None)
        self.seen.set_shot(Shot(picture.seen, name="seen"))
        self.predicted.set_shot(Shot(picture.predicted, name="predicted"))
        self.predicted.blank.words = "No prediction for this place."
        words = expected_words(picture, plan)
        self.correlation.setText(f"{words}; {note}" if note else words)

    def show_age(self, now_s: float, stage_um: tuple[float, float, float]) -> None:
        """Show how old the frame is, and in red that the stage has left its place for ``stage_um``."""
        if self._last is None:
            self.age.setText("")
            return
        picture = self._last[0]
        words, moved = age_words(now_s - picture.taken_s, picture.stage_um, stage_um)
        self.age.setText(f"<span style='color:{current_theme().bad}'>{words}</span>" if moved else words)

    def _show_overlays(self) -> None:
        """Draw lattice and cutout over the frame, or not, also where no frame follows."""
        if self._last is not None:
            picture, plan = self._last
            self.view.set_lattice(plan.camera if self.lattice.isChecked() else None)
            self.view.set_shot(self._shot_of(picture))

    def _shot_of(self, picture: LivePicture) -> Shot:
        overlays: tuple[Overlay, ...] = ()
        if picture.window is not None and picture.point is not None and self.cutout.isChecked():
            row, column, nt, ns = picture.window
            overlays = cutout_of(row, column, (nt, ns), picture.point)
        return Shot(picture.frame, name="frame", overlays=overlays)

    def show_waiting(self, waiting: bool) -> None:
        """Say in the pictures that are empty that the first frame is awaited, or no longer."""
        words = "Waiting for the first frame …" if waiting else ""
        for view in (self.view, self.histogram, self.seen, self.predicted):
            view.blank.wait(words)

    def show_nothing(self) -> None:
        """Show no live frame, and nothing of one."""
        self._last = None
        self.age.setText("")
        self.view.set_shot(None)
        self.view.set_lattice(None)
        self.histogram.clear()
        for view in (self.seen, self.predicted):
            view.set_shot(None)
        self.predicted.blank.words = NOTHING
        self.numbers.setText("–")
        self.spot.setText("–")
        for label in (self.saturated, self.correlation):
            label.setText("")

    def show_result(self, key: str, words: str, *, good: bool = True, usable: bool = False) -> None:
        """Show what was found; what is bad is red."""
        self._said[key] = (words, good, usable)
        label = self.results[key]
        theme = current_theme()
        label.setText(words if good else f"<span style='color:{theme.bad}'>{words}</span>")
        label.setVisible(bool(words))
        self.use_buttons[key].setVisible(usable)

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        for widget in (self.view, self.histogram, self.seen, self.predicted):
            widget.apply_theme()
        self._show_saturated()
        for key, (words, good, usable) in tuple(self._said.items()):
            self.show_result(key, words, good=good, usable=usable)

    def _show_saturated(self) -> None:
        if self._counted is not None:
            colour = current_theme().bad if self._counted else current_theme().good
            self.saturated.setText(f"saturated pixels <b style='color:{colour}'>{self._counted}</b>")

    def _zoom(self) -> None:
        if self._last is not None and self._last[0].window is not None:
            row, column, nt, ns = self._last[0].window
            self.view.show_part(row, column, nt, ns)

    def _hovered(self, row: int, column: int, value: float) -> None:
        self.readout.setText(" " if row < 0 else f"row {row}, column {column}: {value:.5g} counts")
