"""The selected effect: why it is on or off, its magnitudes, and what it does to one position."""

from __future__ import annotations

from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtWidgets import QComboBox, QLabel, QPushButton, QScrollArea, QSpinBox, QSplitter, QVBoxLayout, QWidget

from lfcal.base import format_length
from lfcal.camera import ScanPlan
from lfcal_gui.pages.simulate._influence_view import InfluenceView
from lfcal_gui.pages.simulate._magnitude_form import MagnitudeForm
from lfcal_gui.pages.simulate.model_effects import FRAMES_ONLY, EffectRow
from lfcal_gui.pages.simulate.model_influence import InfluencePictures
from lfcal_gui.widgets import clear, heading, line

__all__ = ["EffectPanel"]


class EffectPanel(QWidget):
    """What is known of one effect.

    Signals
    -------
    given(effect, field, value, mark)
        The user gave a magnitude, or with a value of None takes it back.
    place_changed()
        Another plane or position was chosen.
    stop_asked()
        The user waits no longer for the pictures.
    frame_asked()
        The user wants a sensor frame of the position.
    """

    given = Signal(str, str, object, str)
    place_changed = Signal()
    stop_asked = Signal()
    frame_asked = Signal()

    def __init__(self) -> None:
        super().__init__()
        self.title = heading("Choose an effect to see its magnitudes and what it does.")
        self.why = QLabel()
        self.formula = QLabel()
        for label in (self.title, self.why, self.formula):
            label.setWordWrap(True)
        self.formula.setProperty("role", "hint")
        self.note = QLabel("No magnitude of its own: the camera's description has all it needs.")
        self.note.setProperty("role", "hint")
        self.note.setWordWrap(True)
        self._typical = False
        self.form = MagnitudeForm()
        self.form.given.connect(self.given.emit)
        self.influence = InfluenceView()
        self.frame_button = QPushButton("Make a frame")
        self.frame_button.setToolTip("A sensor frame of this position with every effect on that acts on frames")
        self.frame_button.clicked.connect(lambda _=False: self.frame_asked.emit())
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 6, 0, 0)
        both = QSplitter(Qt.Orientation.Vertical)
        both.setChildrenCollapsible(False)
        both.setHandleWidth(8)
        both.addWidget(self._words_area())
        self.pictures = self._pictures()
        both.addWidget(self.pictures)
        both.setStretchFactor(0, 0)
        both.setStretchFactor(1, 1)
        both.setSizes([256, 360])
        layout.addWidget(both)
        self.show_row(None)

    def _words_area(self) -> QScrollArea:
        inner = QWidget()
        column = QVBoxLayout(inner)
        column.setContentsMargins(0, 0, 4, 0)
        column.setSpacing(5)
        for widget in (self.title, self.why, self.form, self.note, self.formula):
            column.addWidget(widget)
        column.addLayout(line(self.frame_button))
        column.addStretch()
        area = QScrollArea()
        area.setWidgetResizable(True)
        area.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        area.setWidget(inner)
        clear(area)
        return area

    def _pictures(self) -> QWidget:
        self.plane_box = QComboBox()
        self.plane_box.setAccessibleName("plane of the pictures")
        self.plane_box.setMinimumContentsLength(9)
        self.plane_box.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        self.plane_box.setToolTip("Depth plane of the pictures: many effects grow away from focus")
        self.plane_box.currentIndexChanged.connect(lambda _: self.place_changed.emit())
        self.row_box, self.column_box = QSpinBox(), QSpinBox()
        for box, axis in ((self.row_box, "y"), (self.column_box, "x")):
            box.setAccessibleName(f"position {axis}")
            box.setToolTip(f"Source position {axis} in the period (px)")
            box.setKeyboardTracking(False)
            box.valueChanged.connect(lambda _: self.place_changed.emit())
        self.stop_button = QPushButton("Stop")
        self.stop_button.setToolTip("Leave the pictures as they are; the effect stays on")
        self.stop_button.clicked.connect(lambda _=False: self.stop_asked.emit())
        inner = QWidget()
        column = QVBoxLayout(inner)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(4)
        column.addLayout(
            line("Plane", self.plane_box, "y", self.row_box, "x", self.column_box, self.stop_button, stretch=1)
        )
        column.addWidget(self.influence, 1)
        return inner

    # -- showing ---------------------------------------------------------------------------------------
    def show_plan(self, plan: ScanPlan) -> None:
        """Offer planes and positions of a plan; the middle ones where the plan is another."""
        planes = [f"{z}: {format_length(depth)}" for z, depth in enumerate(plan.depths_um)]
        ny, nx = plan.period
        before = [self.plane_box.itemText(k) for k in range(self.plane_box.count())]
        limits = (self.row_box.maximum(), self.column_box.maximum())
        if before == planes and limits == (ny - 1, nx - 1):
            return
        blockers = [QSignalBlocker(w) for w in (self.plane_box, self.row_box, self.column_box)]
        self.plane_box.clear()
        self.plane_box.addItems(planes)
        for box, count in ((self.row_box, ny), (self.column_box, nx)):
            box.setMaximum(count - 1)
            box.setValue(count // 2)
        for blocker in blockers:
            blocker.unblock()

    @property
    def place(self) -> tuple[int, int, int]:
        """The position (z, y, x) of the pictures."""
        return max(0, self.plane_box.currentIndex()), self.row_box.value(), self.column_box.value()

    def show_row(self, row: EffectRow | None) -> None:
        """Show what is known of an effect; None: none is selected."""
        there = row is not None
        for widget in (self.why, self.form, self.note, self.formula, self.pictures):
            widget.setVisible(there)
        self.frame_button.setVisible(row is not None and not row.enters_h)
        self.stop_button.setEnabled(False)
        if row is None:
            return
        self._typical = row.effect.deviation and not row.given and row.share > 0
        self.title.setText(row.title if row.enters_h else f"{row.title}: {FRAMES_ONLY}")
        self.why.setText(row.verdict_text())
        self.formula.setText(f"Estimate: {row.formula}")
        self.note.setVisible(not row.magnitudes)
        self.form.show_row(row)

    def show_waiting(self, words: str) -> None:
        """Say that pictures are being computed; they may be stopped."""
        self.stop_button.setEnabled(True)
        self.influence.show_influence(None, words)

    def show_influence(self, influence: InfluencePictures | None, why: str = "") -> None:
        """Show the pictures, or why there are none."""
        self.stop_button.setEnabled(False)
        size = "At a typical size, " if self._typical else ""
        self.influence.show_influence(influence, why or (f"{size}{influence.words}" if influence is not None else ""))
