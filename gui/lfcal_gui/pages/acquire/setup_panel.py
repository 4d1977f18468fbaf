"""The live view with its readout, and parts of the inspector: devices, stage, measurements."""

from __future__ import annotations

import math
from dataclasses import replace

from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtGui import QAction
from PySide6.QtWidgets import QDoubleSpinBox, QHBoxLayout, QLabel, QMenu, QPushButton, QWidget

from lfcal.camera import ScanPlan
from lfcal_gui.jobs import Jobs
from lfcal_gui.models import CUTOUT, Overlay, Shot, Symbols, cutout_of
from lfcal_gui.pages.acquire._devices import DevicePanel, FaultPanel
from lfcal_gui.pages.acquire._stage import StagePanel
from lfcal_gui.pages.acquire.model_live import LivePicture, age_words, expected_words, plane_to_go
from lfcal_gui.theme import canvas_fair, current_theme
from lfcal_gui.widgets import (
    AxisArrows,
    Contrast,
    ElidedLabel,
    Picture,
    button,
    column_of,
    heading,
    line,
    set_role,
    wrapped,
)

EXPOSURE, PAIR = 104, 104
"""Smallest width of the exposure field, and height of the two small pictures (px)."""

FINDINGS = (
    (
        "stage",
        "Scale, rotation, sign",
        "Move to five positions and fit how the image moves. With a wrong sign, H looks plausible but is useless",
    ),
    (
        "axis",
        "Optical axis",
        "Take frames at 45 positions in each of the first and last planes. Find where a move in depth does not shift "
        "the image",
    ),
    (
        "exposure",
        "Exposure per plane",
        "Find for each plane the exposure that uses 70 % of the camera's range without saturation",
    ),
)
"""Key, title and tooltip of each measurement."""

STILLS = (
    ("white", "White image", "Frames of uniform light, to measure the lattice and the relative brightness"),
    ("dark", "Dark frames", "Frames of the whole sensor without light, subtracted from the white image"),
)
"""Key, title and tooltip of the frames that can be recorded."""

OVERLAYS = (
    ("lattice", "Lattice", "Micro-image centres of the described camera, coloured by lens type"),
    ("cutout", "Cutout", "Where the plan expects the image (cross) and the cutout around it (square)"),
    ("axes", "Axes", "Directions in which stage moves shift the image, as in the plan, and the sensor's axes"),
)

CONNECTS = (
    ("Connect", "Connect camera and stage as chosen under Devices; nothing moves yet"),
    ("Choose devices …", "Choose the drivers of camera and stage, to record with real devices"),
    ("Use the simulated rig", "Practise with a simulated camera and stage, which also have noise and faults"),
)
"""Title and tooltip of the buttons that connect, or that lead to the choice of devices."""

AGREE = 0.9
"""Correlation above which measured and expected light agree."""

WAITING = "Waiting for the first frame …"
NO_FRAME, NO_REFERENCE = "No frame yet.", "While recording, this needs an H of the plan in the project."
UNCONNECTED = "No camera connected. Connect one, or use the simulated rig to practise."


class SetupPanel(QWidget):
    """The live view; ``devices``, ``stage``, ``faults``, ``pair`` and ``adjust`` are parts of the inspector."""

    plane_asked = Signal(int, arguments=["z"])
    """Request to move to a plane of the plan."""
    find_asked = Signal(str, arguments=["key"])
    """Request to measure one of `FINDINGS`, or to record one of `STILLS`."""
    connect_asked = Signal(bool, arguments=["simulated"])
    """Request to connect the chosen devices, or the simulated ones."""
    devices_asked = Signal()
    """Request to show the choice of devices."""
    results_changed = Signal()
    """Results or the connection changed."""

    def __init__(self, jobs: Jobs, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.devices, self.stage, self.faults = DevicePanel(), StagePanel(), FaultPanel()
        self.view = Picture("counts", jobs=jobs, legend=False)
        self.view.hovered.connect(self._hovered)
        self.view.readout_clicked.connect(self._type_exposure)
        self.view.blank.words = UNCONNECTED
        self.contrast = Contrast(self.view)
        self.arrows = AxisArrows(self.view)
        self.arrows.hide()
        self._said: dict[str, tuple[str, bool]] = {}
        self.done: set[str] = set()
        """Keys of `FINDINGS` and `STILLS` that are done."""
        self.z = 0
        """Selected plane, in which measurements of a single plane are made."""
        self._last: tuple[LivePicture, ScanPlan] | None = None
        self.tools = self._tools()
        column_of(self.view, self.contrast, of=self, spacing=4, stretch=0)
        self.pair, self.adjust = self._pair(), self._adjust()
        self.set_connected(False)

    # -- building --------------------------------------------------------------------------------------
    def _tools(self) -> QWidget:
        bar = QWidget()
        self.near, self.whole = QPushButton("Cutout"), QPushButton("Sensor")
        self.near.setToolTip("Show the cutout of the live frame, and follow it when the stage moves")
        self.whole.setToolTip("Show the full live frame")
        self.looked_at = self.whole
        for one in (self.near, self.whole):
            one.toggled.connect(lambda on, one=one: self._look_at(one) if on else None)
        self.readout = ElidedLabel(role="hint")
        self.exposure = QDoubleSpinBox()
        self.exposure.setRange(0.01, 60_000)
        self.exposure.setMinimumWidth(EXPOSURE)  # the longest exposures are rare, and widen the window
        self.exposure.setSuffix(" ms")
        self.exposure.setKeyboardTracking(False)
        self.exposure.setStepType(QDoubleSpinBox.StepType.AdaptiveDecimalStepType)
        self.exposure.setAccessibleName("Exposure of the live view")
        self.exposure.setToolTip("Exposure of the live view; the exposures of the plan do not change")
        actions = (
            lambda: self.connect_asked.emit(False),
            self.devices_asked.emit,
            lambda: self.connect_asked.emit(True),
        )
        self.connect_buttons = [button(*words, action) for words, action in zip(CONNECTS, actions, strict=True)]
        self.overlay = self._overlay_button()
        row = line(self.readout, *self.connect_buttons, self.exposure, self.overlay, stretch=0)
        row.setContentsMargins(0, 0, 0, 0)
        bar.setLayout(row)
        return bar

    def _overlay_button(self) -> QPushButton:
        made, menu = QPushButton("Overlay"), QMenu(self)
        self.overlays: dict[str, QAction] = {}
        for key, title, tip in OVERLAYS:
            action = menu.addAction(title)
            action.setCheckable(True)
            action.setChecked(key == "cutout")
            action.setToolTip(tip)
            action.toggled.connect(lambda _: self._show_overlays())
            self.overlays[key] = action
        menu.setToolTipsVisible(True)
        made.setToolTip("Choose what is drawn over the frame")
        made.setMenu(menu)
        return made

    def _pair(self) -> QWidget:
        """Create the two pictures that are compared, and the text on the measured light."""
        self.seen = Picture("counts above background", legend=False)
        self.predicted = Picture("fraction of the light", legend=False)
        pictures = QHBoxLayout()
        for view, tip in (
            (self.seen, "Measured image: what the camera sees in the predicted cutout, above the background"),
            (
                self.predicted,
                "Expected image: from an H of the project at this position, or from rays through the described camera",
            ),
        ):
            view.setToolTip(tip)
            view.setFixedHeight(PAIR)
            view.blank.words = NO_FRAME
            pictures.addWidget(view, 1)
        self.correlation, self.near_words = QLabel(), wrapped()
        self.correlation.setToolTip(
            "Normalised correlation of the measured and the expected image; 100 % for the same pattern at any "
            "brightness"
        )
        nearest = "Move the stage to the nearest plane of the plan, where a pattern is expected"
        self.go = button("", nearest, lambda: self.plane_asked.emit(self._nearest))
        self.go.hide()
        self._nearest = 0
        self.numbers, self.spot = wrapped("", "–"), wrapped("", "–")
        self.spot.setToolTip(
            "Centroid of the light above the background. Sharpness: computed from differences between neighbouring "
            "pixels; larger is sharper, at any brightness. Measured − predicted: offset of the image in rows and "
            "columns (px)"
        )
        for label in (self.numbers, self.spot):
            label.setTextFormat(Qt.TextFormat.RichText)
        head = line(heading("Seen and expected"), self.correlation, stretch=0)
        head.addStrut(20)
        widget = QWidget()
        column_of(head, pictures, line(self.near_words, self.go, stretch=0), of=widget)
        return widget

    def _adjust(self) -> QWidget:
        self.find_buttons: dict[str, QPushButton] = {}
        self.results: dict[str, QLabel] = {}
        widget = QWidget()
        column = column_of(self.numbers, self.spot, of=widget)
        for key, title, tip in (*FINDINGS, *STILLS):
            made, result = button(title, tip, lambda key=key: self.find_asked.emit(key)), wrapped("")
            result.setTextFormat(Qt.TextFormat.RichText)
            result.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
            result.hide()
            self.find_buttons[key], self.results[key] = made, result
            column.addWidget(made)
            column.addWidget(result)
        return widget

    # -- showing ---------------------------------------------------------------------------------------
    def set_connected(self, connected: bool, *, free: bool = True) -> None:
        """Enable the controls that need devices; ``free``: only the live view uses the devices."""
        self.connected = connected
        for widget in (*self.find_buttons.values(), self.go):
            widget.setEnabled(connected and free)
        simulated = self.devices.backend.currentData() in (None, "sim")
        for one, offered in zip(self.connect_buttons, (not simulated, simulated, True), strict=True):
            one.setVisible(offered and not connected)
        self.overlay.setVisible(connected)
        self.exposure.setVisible(connected and free)  # others use the exposures of the plan
        self.stage.set_free(connected and free)
        if free and not connected:
            self.stage.set_position((math.nan,) * 3)
        for view in (self.view, self.seen, self.predicted):
            view.blank.wait(WAITING if connected and self._last is None else "")
        self.results_changed.emit()

    def set_exposure(self, seconds: float) -> None:
        """Show the exposure without reporting it (s)."""
        with QSignalBlocker(self.exposure):
            self.exposure.setValue(1e3 * seconds)

    def show_live(self, picture: LivePicture, plan: ScanPlan, note: str = "") -> None:
        """Show a frame with its overlays and readout; ``note`` is shown below the small pictures."""
        if picture.frame is None:
            self.numbers.setText(picture.numbers)
            return
        fresh, self._last = self._last is None, (picture, plan)
        self._show_overlays()
        self.numbers.setText(picture.numbers)
        self.spot.setText(picture.spot)
        self.seen.set_shot(Shot(picture.seen, "seen", name="seen"))
        self.predicted.set_shot(Shot(picture.predicted, "expected", name="predicted"))
        words, nearest = expected_words(picture, plan), plane_to_go(picture, plan)
        self.predicted.blank.words = "Nothing is expected here." if nearest is not None else NO_REFERENCE
        agrees = not math.isnan(picture.correlation)
        merit = "hint" if not agrees else "good" if picture.correlation >= AGREE else "fair"
        set_role(self.correlation, merit)
        self.correlation.setText(words if agrees else "")
        self.near_words.setText("; ".join(filter(None, ("" if agrees else words, note))))
        self.near_words.setVisible(bool(self.near_words.text()))
        self.go.setVisible(nearest is not None)
        if nearest is not None:
            self._nearest = nearest
            self.go.setText(f"Go to plane {nearest}")
        if fresh or self.near.isChecked():
            self._zoom()

    def show_age(self, now_s: float, stage_um: tuple[float, float, float]) -> None:
        """Show the age of the frame, in the warning colour if it is late or the stage has moved since."""
        if self._last is None:
            self.view.set_note("")
            return
        picture = self._last[0]
        age = now_s - picture.taken_s
        words, moved = age_words(age, picture.stage_um, stage_um)
        self.view.set_note(words, canvas_fair() if moved or age > picture.due_s else "")

    def _show_overlays(self) -> None:
        """Draw the enabled overlays over the frame, even if no further frame arrives."""
        self.arrows.setVisible(self.overlays["axes"].isChecked())
        if self._last is not None:
            picture, plan = self._last
            self.view.set_lattice(plan.camera if self.overlays["lattice"].isChecked() else None, picture.first)
            self.view.set_shot(replace(self._shot_of(picture), pixel_um=plan.camera.sensor.pixel_um))

    def _shot_of(self, picture: LivePicture) -> Shot:
        overlays: tuple[Overlay, ...] = ()
        (top, left), shown = picture.first, self.overlays["cutout"].isChecked()
        if shown and picture.target is not None:
            overlays = (Symbols(picture.target, "o", CUTOUT, 11),)
        elif shown and picture.window is not None and picture.point is not None:
            row, column, nt, ns = picture.window
            overlays = cutout_of(row - top, column - left, (nt, ns), (picture.point[0] - top, picture.point[1] - left))
        return Shot(picture.frame, picture.caption, name="frame", overlays=overlays, readout=picture.readout)

    def show_nothing(self) -> None:
        """Clear the frame and everything that belongs to it."""
        self._last = None
        self.view.set_note("")
        self.view.set_lattice(None)
        for view in (self.view, self.seen, self.predicted):
            view.set_shot(None)
        self.predicted.blank.words = NO_FRAME
        self.go.hide()
        self.numbers.setText("–")
        self.spot.setText("–")
        self.correlation.setText("")
        self.near_words.hide()

    def show_result(self, key: str, words: str, *, good: bool = True, done: bool = False) -> None:
        """Show a result, in red if it is bad. ``done`` states whether the measurement or recording is complete."""
        self._said[key] = (words, good)
        (self.done.add if done else self.done.discard)(key)
        label = self.results[key]
        theme = current_theme()
        label.setText(words if good else f"<span style='color:{theme.bad}'>{words}</span>")
        label.setVisible(bool(words))
        self.results_changed.emit()

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        for widget in (self.view, self.contrast, self.seen, self.predicted):
            widget.apply_theme()
        for key, (words, good) in tuple(self._said.items()):
            self.show_result(key, words, good=good, done=key in self.done)

    def _look_at(self, view: QPushButton) -> None:
        self.looked_at = view
        if view is self.whole:
            self.view.show_all()
        else:
            self._zoom()

    def _zoom(self) -> None:
        """Zoom to the cutout, if this is chosen and the cutout is known."""
        if self._last is None or self._last[0].window is None or not self.near.isChecked():
            return
        (top, left), (row, column, nt, ns) = self._last[0].first, self._last[0].window
        self.view.show_part(row - top, column - left, nt, ns)

    def _type_exposure(self) -> None:
        self.exposure.setFocus(Qt.FocusReason.MouseFocusReason)
        self.exposure.selectAll()

    def _hovered(self, row: int, column: int, value: float) -> None:
        top, left = (0, 0) if self._last is None else self._last[0].first
        self.readout.setText(" " if row < 0 else f"row {row + top}, column {column + left}: {value:.5g} counts")
