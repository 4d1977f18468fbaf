"""Record > Compute: error against cost, pictures of one position, and settings and effects at the right."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property
from pathlib import Path

from PySide6.QtCore import QSignalBlocker, Signal
from PySide6.QtWidgets import (
    QComboBox,
    QFrame,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QScrollArea,
    QSpinBox,
    QStackedWidget,
    QTabWidget,
    QWidget,
)

from lfcal.accuracy import Curve
from lfcal.base import format_length
from lfcal.camera import ScanPlan
from lfcal_gui.jobs import Jobs
from lfcal_gui.models import Shot, axis_labels, cutout_of, minus, points_of
from lfcal_gui.pages.simulate import model
from lfcal_gui.pages.simulate._effect_panel import EffectPanel
from lfcal_gui.pages.simulate._effects_table import EffectsTable
from lfcal_gui.pages.simulate.model import SimulateSettings
from lfcal_gui.pages.simulate.model_effects import EffectsVerdict, measurement_words
from lfcal_gui.pages.simulate.model_frames import SimulatedFrame, write_frame
from lfcal_gui.saving import ask_target, write_file
from lfcal_gui.widgets import (
    INSPECTOR,
    CostCurve,
    Folded,
    FoldedForm,
    Picture,
    button,
    card,
    column_of,
    heading,
    line,
    name_controls,
    scrolling,
    split,
    wrapped,
)


class PlaceLine(QWidget):
    """Choice of a position: a list of planes, and y and x."""

    changed = Signal()
    """Another plane or position was selected."""

    def __init__(self) -> None:
        super().__init__()
        self.plane_box = QComboBox()
        self.plane_box.setAccessibleName("Plane")
        self.plane_box.setMinimumContentsLength(9)
        self.plane_box.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        self.plane_box.setToolTip("Depth plane of the images. Many effects increase away from focus")
        self.plane_box.currentIndexChanged.connect(lambda _: self.changed.emit())
        self.row_box, self.column_box = QSpinBox(), QSpinBox()
        for box, axis in ((self.row_box, "y"), (self.column_box, "x")):
            box.setAccessibleName(f"Position {axis}")
            box.setToolTip(f"Source position {axis} in the period (px)")
            box.setKeyboardTracking(False)
            box.setMinimumWidth(52)
            box.valueChanged.connect(lambda _: self.changed.emit())
        row: QHBoxLayout = line("z", self.plane_box, "y", self.row_box, "x", self.column_box, stretch=1)
        row.setContentsMargins(0, 0, 0, 0)
        self.setLayout(row)

    def show_plan(self, plan: ScanPlan) -> None:
        """Set the planes and positions of a plan; for a new plan, the middle ones are selected."""
        planes = [f"{z}: {minus(format_length(depth))}" for z, depth in enumerate(plan.depths_um)]
        ny, nx = plan.period
        before = [self.plane_box.itemText(k) for k in range(self.plane_box.count())]
        if before == planes and (self.row_box.maximum(), self.column_box.maximum()) == (ny - 1, nx - 1):
            return
        blockers = [QSignalBlocker(w) for w in (self.plane_box, self.row_box, self.column_box)]
        self.plane_box.clear()
        self.plane_box.addItems(planes)
        self.plane_box.setCurrentIndex(len(planes) // 2)
        for box, count in ((self.row_box, ny), (self.column_box, nx)):
            box.setMaximum(count - 1)
            box.setValue(count // 2)
        for blocker in blockers:
            blocker.unblock()

    @property
    def place(self) -> tuple[int, int, int]:
        """The position (z, y, x)."""
        return max(0, self.plane_box.currentIndex()), self.row_box.value(), self.column_box.value()


class FramePanel(QWidget):
    """A simulated frame with its caption, and the buttons that make and save it.

    Parameters
    ----------
    jobs
        Jobs of the window.
    make
        Function that makes a frame of the selected position.
    """

    def __init__(self, jobs: Jobs, make: Callable[[], object]) -> None:
        super().__init__()
        self.frame: SimulatedFrame | None = None
        tip = "Simulate a sensor frame of the position below, with every effect that is on for frames"
        self.make_button = button("Make a frame", tip, make)
        self.save_button = button("Save …", "Save the samples as TIFF or PNG", self.save)
        self.save_button.setEnabled(False)
        self.words = wrapped(
            "hint", "A frame includes every effect that is on for frames: noise, stage errors, rounding."
        )
        self._jobs, self.room = jobs, QStackedWidget()
        column_of(line(self.make_button, self.save_button), self.room, self.words, of=self, stretch=1)

    @cached_property
    def view(self) -> Picture:
        """Picture of the frame, which is created with the first frame."""
        made = Picture("counts", jobs=self._jobs)
        name_controls(made)
        self.room.addWidget(made)
        return made

    def show_waiting(self) -> None:
        """Show that a frame is being made."""
        self.words.setText("The frame is being made …")
        self.make_button.setEnabled(False)

    def show_frame(self, frame: SimulatedFrame | None, words: str = "") -> None:
        """Show a frame with the position's cutout; None: keep the previous frame, and show the reason."""
        self.make_button.setEnabled(True)
        if frame is None:
            self.words.setText(words)
            return
        self.frame = frame
        self.save_button.setEnabled(True)
        top, left = frame.window()
        plan = frame.question.plan
        nt, ns = plan.cutout
        cutout = cutout_of(top, left, (nt, ns), (top + nt // 2, left + ns // 2))
        self.view.set_shot(Shot(frame.samples, name="frame", overlays=cutout, pixel_um=plan.camera.sensor.pixel_um))
        self.words.setText(frame.words())

    def show_none(self) -> None:
        """Remove a frame of another plan or other settings."""
        self.frame = None
        self.make_button.setEnabled(True)
        self.save_button.setEnabled(False)
        if "view" in vars(self):
            self.view.set_shot(None)
        self.words.setText("The plan or the settings have changed since the last frame was made. Make a new frame.")

    def save(self, path: str = "") -> None:
        """Save the samples of the frame."""
        frame = self.frame
        if frame is None:
            return
        path = path or ask_target(self, "Save frame", "frame.tif", "TIFF (*.tif);;PNG (*.png)")
        if path:
            write_file(self, path, lambda part: write_frame(frame, Path(path), part))


WIDTH = 304
"""Smallest width of the settings (px)."""

IMPORT = "Read magnitudes and settings from a JSON file, as lfcal simulate --effect does"
EXPORT = "Write the magnitudes and settings of this page to a JSON file for lfcal simulate --effect"
MEASURE = "Show the cheapest measurements that determine these effects, and plan the bead frames"
RESET = "Set every magnitude and setting to its default"
TAB_TIPS = (
    "One pattern of H, computed with the current settings",
    "The effect selected in the list: its magnitudes, and how it changes H",
    "A full sensor frame with noise, as the camera would record it",
)


class SimulatePanel(QWidget):
    """The page's widgets."""

    edited = Signal(str, object, arguments=["name", "value"])
    """The user changed a field of the tasks; see `lfcal_gui.pages.simulate.model.FIELDS`."""
    asked = Signal(str, arguments=["what"])
    """A button was pressed: ``"frame"`` of the position, ``"frames"`` of the plan, ``"measure"`` of undescribed
    effects, ``"import"``, ``"export"`` or ``"reset"`` of magnitudes and settings, ``"stop"`` of the pictures of an
    effect."""

    def __init__(self, jobs: Jobs, curve: CostCurve) -> None:
        super().__init__()
        self.curve = curve
        self.view = Picture("fraction of the light")
        self.effect, self.frame, self.place = (
            EffectPanel(self._asking("stop")),
            FramePanel(jobs, self._asking("frame")),
            PlaceLine(),
        )
        self.table = EffectsTable()
        self.table.edit_asked.connect(self.show_effect)
        of_frames = "Sensor frames with noise, as a camera would record them on this plan"
        self.forms = (
            FoldedForm(model.FIELDS[0]),
            FoldedForm((), model.FIELDS[1], tip="Level, passes, and lossy storage of H", framed=True),
            FoldedForm((), model.FIELDS[2], "Frames instead of H", of_frames, framed=True),
        )
        for form in self.forms:
            form.check = model.refusal
            form.set_defaults({key: model.shown(key, SimulateSettings()) for key in form.fields})
            form.edited.connect(self.edited.emit)
        left, column = card("What accuracy costs")
        column.addWidget(self.curve)
        column_of(split(left, self._pictures(), self._inspector(), sizes=(40, 34, 28)), of=self)

    def _asking(self, what: str) -> Callable[[], object]:
        return lambda: self.asked.emit(what)

    # -- building --------------------------------------------------------------------------------------
    def _pictures(self) -> QFrame:
        self.tabs = QTabWidget()
        self.tabs.setDocumentMode(True)
        self.tabs.tabBar().setDrawBase(False)
        titles = ((self.view, "Pattern"), (self.effect, "Effect"), (self.frame, "Frame"))
        for (content, title), tip in zip(titles, TAB_TIPS, strict=True):
            self.tabs.setTabToolTip(self.tabs.addTab(content, title), tip)
        frame, column = card()
        column.addWidget(self.tabs, 1)
        column.addWidget(self.place)
        return frame

    def _inspector(self) -> QScrollArea:
        self.better, self.unknown = wrapped(), wrapped()
        frames = "Write all frames of the plan to a folder, as a job"
        self.forms[2].fold_line(button("Simulate frames …", frames, self._asking("frames")))
        inner = QWidget()
        above = (self._numbers(), self.better, self.forms[0], heading("Effects that this H needs"))
        self.measure_button = button("Measure them …", MEASURE, self._asking("measure"))
        below = (self.unknown, line(self.measure_button), *self.forms[1:], self._files())
        column = column_of(*above, self.table, *below, of=inner, spacing=6)
        column.setContentsMargins(4, 0, 4, 0)
        column.addStretch()
        area = scrolling(inner)
        area.setProperty(INSPECTOR, True)
        area.setMinimumWidth(WIDTH)
        return area

    def _numbers(self) -> QGridLayout:
        self.seconds, self.error = QLabel(), QLabel()
        self.seconds_words, self.error_words = wrapped(), wrapped()
        grid = QGridLayout()
        grid.setVerticalSpacing(0)
        for k, (number, words) in enumerate(((self.seconds, self.seconds_words), (self.error, self.error_words))):
            number.setProperty("role", "big")
            grid.addWidget(number, 0, k)
            grid.addWidget(words, 1, k)
            grid.setColumnStretch(k, 1)
        return grid

    def _files(self) -> Folded:
        fold = Folded("Magnitudes in a file", "Magnitudes and settings of effects, for other projects and commands")
        self.reset_button = button("Reset all", RESET, self._asking("reset"))
        asking = (
            button("Import …", IMPORT, self._asking("import")),
            button("Export …", EXPORT, self._asking("export")),
        )
        fold.column.addLayout(line(*asking, self.reset_button))
        return fold

    # -- showing ---------------------------------------------------------------------------------------
    def show_settings(self, settings: SimulateSettings) -> None:
        """Show the fields of the tasks."""
        for form in self.forms:
            form.set_values({key: model.shown(key, settings) for key in form.fields})
        self.forms[1].set_enabled(
            "store_tolerance", not settings.progressive, "H computed in passes is stored without loss"
        )

    def show_verdict(self, verdict: EffectsVerdict) -> None:
        """Show the planner's answer: a row for each effect."""
        self.table.show_verdict(verdict)
        self.unknown.setText(verdict.unknown)
        self.unknown.setToolTip(measurement_words(verdict.missing))
        self.unknown.setVisible(bool(verdict.unknown))
        self.measure_button.setVisible(bool(verdict.missing.measurements))
        self.place.show_plan(verdict.plan)
        self.effect.show_row(verdict.row(self.table.selected))

    def show_cost(
        self, curve: Curve | None, settings: SimulateSettings, forecast: float | None, paced: Callable[[float], float]
    ) -> None:
        """Show the measured part of the curve, and time and error of the settings.

        Parameters
        ----------
        curve, settings, paced
            As in `better_words`.
        forecast
            Processor time of H (s) if it was not measured.
        """
        point = model.used_point(curve, settings)
        if curve is not None:
            self.curve.set_labels(*axis_labels(curve))
        points = () if curve is None else points_of(curve, point)
        self.curve.show_points(points, math.log10(100 * settings.tolerance))
        seconds = forecast if point is None else point.cost
        numbers = model.numbers_of(point, settings, None if seconds is None else paced(seconds))
        labels = (self.seconds, self.seconds_words, self.error, self.error_words)
        for label, text in zip(labels, numbers, strict=True):
            label.setText(text)
        self.better.setText(model.better_words(curve, point, paced))
        self.better.setVisible(bool(self.better.text()))

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        self.view.apply_theme()
        self.curve.apply_theme()
        for part, name in ((self.effect, "influence"), (self.frame, "view")):
            if name in vars(part):
                getattr(part, name).apply_theme()

    @property
    def pattern_shown(self) -> bool:
        """Whether the pattern is displayed."""
        return self.tabs.currentWidget() is self.view

    def show_effect(self) -> None:
        """Show the selected effect, and set the focus to its magnitudes."""
        self.tabs.setCurrentWidget(self.effect)
        self.effect.form.focus_first()

    def show_frame_tab(self) -> None:
        """Show the sensor frame."""
        self.tabs.setCurrentWidget(self.frame)
