"""Use > Depth: the frame or its depth map at the left; measurement, display and saving at the right."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QLabel, QPushButton, QSlider, QWidget

from lfcal_gui.jobs import Jobs
from lfcal_gui.pages.depth.model import BASIC, FIELDS, QUANTITIES, DepthSettings
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets import (
    Contrast,
    ElidedLabel,
    FoldedForm,
    Picture,
    StatusPanel,
    WrappedLabel,
    button,
    card,
    choice_box,
    column_area,
    column_of,
    heading,
    line,
    row_of,
    segment,
    set_role,
    wrapped,
)

OPEN = "Choose a frame recorded with the camera: TIFF, PNG, NPY, RAW or others. You can also drop a file here"
MEASURE = "Match the micro-images, or the views, of the whole frame, as a job (F5)"
STOP = "Stop measuring (Esc)"
LEAST = "Samples below this confidence are shown in grey. Saved files keep all samples, with their confidence"
MAP = "Write depth, standard error, confidence, light and disparity as float pages of a TIFF file"
POINTS = "Write a point cloud (.ply), for CloudCompare, MeshLab or Blender"

VIEWS = (
    ("depth", "Depth map", "Depth as colour over the central view (V)"),
    ("frame", "Frame", "The frame itself (V)"),
)
"""Views of the picture."""

FRAME, LIGHT = "sample value (counts)", "light"

SHORT = 14
"""Number of letters of a placeholder that fit next to the label of its field."""

NARROW, WIDE, ROOMY = 304, 368, 1380
"""Two widths of the inspector, and the smallest width of the panel for the wider one (px)."""

USUAL = 50
"""Default confidence below which samples are grey (%)."""


class DepthPanel(StatusPanel):
    """The page's widgets."""

    pressed = Signal(str, arguments=["key"])
    """A button: ``"open"``, ``"measure"``, ``"stop"``, ``"map"`` or ``"points"``."""
    chosen = Signal()
    """Another view, quantity or confidence was selected."""

    def __init__(self, jobs: Jobs) -> None:
        super().__init__()
        self.view = Picture(FRAME, jobs=jobs, legend=False)
        self.contrast = Contrast(self.view)
        self.readout = ElidedLabel(" ", role="hint")
        self._facts: Sequence[tuple[str, str]] = ()
        self._make_segments()
        self.area = column_area(NARROW, self._measuring(), self._showing(), dense=True)
        row_of(
            column_of(self.view, self.contrast, self.readout, spacing=2, stretch=0),
            self.area,
            of=self,
            spacing=8,
            stretch=0,
        )
        self.show_facts(())

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Widen the inspector in a large window."""
        super().resizeEvent(event)
        self.area.setFixedWidth(WIDE if self.width() >= ROOMY else NARROW)

    # -- building --------------------------------------------------------------------------------------
    def _make_segments(self) -> None:
        self.segments: dict[str, QPushButton] = {}
        for key, words, tip in VIEWS:
            self.segments[key] = segment(words, tip, self.chosen.emit, on=key == "frame")
            self.segments[key].setAutoExclusive(True)

    def _measuring(self) -> QWidget:
        frame, column = card()
        self.took = ElidedLabel()
        self.took.setAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
        column.addLayout(line(heading("Measure depth"), self.took, stretch=1))
        self.file = WrappedLabel("none yet", role="hint")
        self.open = button("Open frame …", OPEN, lambda: self.pressed.emit("open"))
        column.addLayout(line(self.open))
        column.addWidget(self.file)
        seen = tuple(field for key in BASIC for field in FIELDS if field.key == key)
        rest = tuple(field for field in FIELDS if field.key not in BASIC)
        tip = "Lattice file, method, search range, mask, colours, and position of the frame on the sensor"
        self.form = FoldedForm(seen, rest, f"{len(rest)} more settings", tip)
        for field in rest:  # next to long labels there is no room for what an empty field means
            if len(field.empty) > SHORT:
                self.form.own_line(field.key)
        column.addWidget(self.form)
        self._go = "measure"
        self.go = button("Measure", MEASURE, lambda: self.pressed.emit(self._go))
        column.addLayout(line(self.go))
        self.add_status(column)
        return frame

    def _showing(self) -> QWidget:
        frame, column = card("Depth map")
        self.quantity = choice_box(
            [*QUANTITIES.items()], "Choose depth, slope or disparity for the colours", "quantity of the colours"
        )
        self.quantity.currentIndexChanged.connect(lambda _: self.chosen.emit())
        self.least, self.percent = QSlider(Qt.Orientation.Horizontal), QLabel()
        self.least.setRange(0, 100)
        self.least.setAccessibleName("Smallest confidence shown")
        self.least.setToolTip(LEAST)
        self.least.valueChanged.connect(self._confidence_moved)
        self.least.setValue(USUAL)
        self.percent.setFixedWidth(self.percent.fontMetrics().horizontalAdvance("100 %") + 4)
        column.addLayout(line("Colour", self.quantity, stretch=1))
        column.addLayout(line("Confidence", self.least, self.percent, stretch=1))
        self.facts = wrapped("")
        self.facts.setTextFormat(Qt.TextFormat.RichText)
        column.addWidget(self.facts)
        self.save_map = button("Save map …", MAP, lambda: self.pressed.emit("map"))
        self.save_points = button("Save points …", POINTS, lambda: self.pressed.emit("points"))
        column.addLayout(line(self.save_map, self.save_points))
        return frame

    def _confidence_moved(self, percent: int) -> None:
        self.percent.setText(f"{percent} %")
        self.chosen.emit()

    # -- showing ---------------------------------------------------------------------------------------
    @property
    def shows_map(self) -> bool:
        """Whether the depth map is shown instead of the frame."""
        return self.segments["depth"].isChecked()

    def show_map(self, on: bool) -> None:
        """Show the depth map, or the frame."""
        self.segments["depth" if on else "frame"].setChecked(True)
        self.chosen.emit()

    def show_settings(self, settings: DepthSettings, shown: dict[str, object]) -> None:
        """Show the settings; ``shown`` are the values of the fields of the task."""
        self.form.set_values({**shown, "use_camera": settings.use_camera, "use_h": settings.use_h})

    def show_go(self, *, running: bool, enabled: bool) -> None:
        """Set the text of the main button to its current action."""
        self._go = "stop" if running else "measure"
        self.go.setText("Stop" if running else "Measure")
        self.go.setToolTip(STOP if running else MEASURE)
        self.go.setEnabled(running or enabled)

    def show_took(self, words: str, role: str = "hint") -> None:
        """Show next to the title the forecast or measured duration."""
        self.took.setText(words)
        set_role(self.took, role)

    def show_facts(self, facts: Sequence[tuple[str, str]], quantities: Sequence[str] = ()) -> None:
        """Show the results and the quantities that can be shown in colour; empty if there is no map."""
        self._facts = facts
        muted = f"style='color:{current_theme().muted}'"
        rows = "".join(f"<tr><td {muted}><nobr>{a}&nbsp;&nbsp;</nobr></td><td>{escape(b)}</td></tr>" for a, b in facts)
        self.facts.setText(f"<table cellspacing='1'>{rows}</table>" if facts else "Nothing has been measured yet.")
        for one in (self.quantity, self.least, self.save_map, self.save_points, self.segments["depth"]):
            one.setEnabled(bool(facts))
        if quantities:
            self._offer(quantities)

    def _offer(self, quantities: Sequence[str]) -> None:
        chosen = self.quantity.currentData()
        self.quantity.blockSignals(True)
        self.quantity.clear()
        for key in quantities:
            self.quantity.addItem(QUANTITIES[key], key)
        self.quantity.setCurrentIndex(max(0, self.quantity.findData(chosen)))
        self.quantity.blockSignals(False)

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        for widget in (self.view, self.contrast):
            widget.apply_theme()
        self.show_facts(self._facts)  # their colours are the theme's
