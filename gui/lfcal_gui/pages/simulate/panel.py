"""Simulate: effects on the left; the selected one, the response, a frame, and accuracy on the right."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtWidgets import (
    QFrame,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QSlider,
    QTabWidget,
    QVBoxLayout,
    QWidget,
)

from lfcal.base import format_seconds
from lfcal_gui.jobs import Jobs
from lfcal_gui.models import Shot
from lfcal_gui.pages.simulate._effect_panel import EffectPanel
from lfcal_gui.pages.simulate._effects_table import EffectsTable
from lfcal_gui.pages.simulate._frame_panel import FramePanel
from lfcal_gui.pages.simulate.model import (
    FIELDS,
    STEPS,
    Z_STEPS,
    SimulateSettings,
    refusal,
    shown,
    tolerance_of,
    tolerance_step,
)
from lfcal_gui.pages.simulate.model_effects import EffectsVerdict
from lfcal_gui.widgets import Folded, Form, LinePlot, Picture, card, heading, line, split

__all__ = ["SimulatePanel"]


TAB_TIPS = (
    "The effect chosen on the left: its magnitudes, and what it does to H",
    "One pattern of H as it is computed now, while settings are changed",
    "A whole sensor frame with noise, as the camera would record it",
    "Time and error of every way to compute: which one is worth its time",
)
NOT_MEASURED = "Measure accuracy to see time and error of every level for this camera."


class SimulatePanel(QWidget):
    """The page's widgets.

    Signals
    -------
    edited(name, value)
        A field of the tasks; see `lfcal_gui.pages.simulate.model.FIELDS`.
    choice_asked(effect, choice)
        ``"auto"``, ``"on"`` or ``"off"`` for an effect.
    depth_moved()
        The preview's depth is dragged.
    import_asked(), export_asked(), reset_asked()
        Magnitudes and settings from a file, to a file, or taken back.
    """

    edited = Signal(str, object)
    choice_asked = Signal(str, str)
    depth_moved = Signal()
    import_asked = Signal()
    export_asked = Signal()
    reset_asked = Signal()

    def __init__(self, jobs: Jobs) -> None:
        super().__init__()
        self.effect, self.frame = EffectPanel(), FramePanel(jobs)
        self.tabs = QTabWidget()
        self.tabs.setDocumentMode(True)
        self.tabs.tabBar().setDrawBase(False)
        self._response = self._preview()
        titles = ((self.effect, "Effect"), (self._response, "Response"), (self.frame, "Frame"))
        for (content, title), tip in zip((*titles, (self._curve(), "Accuracy")), TAB_TIPS, strict=True):
            self.tabs.setTabToolTip(self.tabs.addTab(content, title), tip)
        right, column = card()
        column.addWidget(self.tabs)
        both = split(self._effects_card(), right, sizes=(640, 435))
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(both)

    # -- building --------------------------------------------------------------------------------------
    def _effects_card(self) -> QFrame:
        frame, column = card("Effects")
        self.tolerance_slider = QSlider(Qt.Orientation.Horizontal)
        self.tolerance_slider.setRange(0, STEPS)
        self.tolerance_slider.setAccessibleName("tolerance by slider")
        self.tolerance_slider.setToolTip("Tolerance from 0.1 % (slow) to 50 % (fast)")
        self.tolerance_slider.valueChanged.connect(lambda step: self.edited.emit("tolerance", tolerance_of(step)))
        self.forms = tuple(Form(fields, dense=True) for fields in FIELDS)
        for form in self.forms:
            form.check = refusal
            form.edited.connect(self.edited.emit)
        more = Folded("More settings", "Loss in the file of H; seed and brightness of simulated frames")
        more.column.addWidget(self.forms[1])
        row = QHBoxLayout()
        row.addWidget(self.forms[0], 1)
        row.addWidget(self.tolerance_slider, 1, Qt.AlignmentFlag.AlignTop)
        self.table = EffectsTable()
        self.table.choice_asked.connect(self.choice_asked.emit)
        self.table.edit_asked.connect(self.show_effect)
        self.summary = QLabel()
        self.summary.setWordWrap(True)
        column.addLayout(row)
        column.addWidget(more)
        column.addWidget(self.table, 1)
        column.addWidget(self.summary)
        column.addLayout(self._magnitude_buttons())
        return frame

    def _magnitude_buttons(self) -> QHBoxLayout:
        self.import_button, self.export_button = QPushButton("Import …"), QPushButton("Export …")
        self.reset_button = QPushButton("Reset all")
        tips = (
            "Take magnitudes and settings from a JSON file, as lfcal simulate --effect reads it",
            "Write the magnitudes and settings given here to a JSON file for lfcal simulate --effect",
            "Take back every magnitude and setting",
        )
        buttons = (self.import_button, self.export_button, self.reset_button)
        for button, tip, signal in zip(
            buttons, tips, (self.import_asked, self.export_asked, self.reset_asked), strict=True
        ):
            button.setToolTip(tip)
            button.clicked.connect(lambda _=False, signal=signal: signal.emit())
        return line("Magnitudes", *buttons)

    def _preview(self) -> QWidget:
        inner = QWidget()
        column = QVBoxLayout(inner)
        column.setContentsMargins(0, 6, 0, 0)
        self.preview_label = heading("")
        self.view = Picture("share of the light")
        self.z_slider = QSlider(Qt.Orientation.Horizontal)
        self.z_slider.setRange(0, Z_STEPS)
        self.z_slider.setToolTip("Depth of the preview: rays while you drag, the chosen level when you stop")
        self.z_slider.valueChanged.connect(lambda _: self.depth_moved.emit())
        column.addWidget(self.preview_label)
        column.addWidget(self.view, 1)
        row = QHBoxLayout()
        row.addWidget(QLabel("z"))
        row.addWidget(self.z_slider, 1)
        column.addLayout(row)
        return inner

    def _curve(self) -> QWidget:
        inner = QWidget()
        column = QVBoxLayout(inner)
        column.setContentsMargins(0, 6, 0, 0)
        self.curve = LinePlot("processor time for the whole H (s)", "relative L1 error (%)", legend=True)
        self.curve.set_decades(x=True, y=True)
        self.curve_hint = QLabel(NOT_MEASURED)
        self.curve_hint.setProperty("role", "hint")
        self.curve_hint.setWordWrap(True)
        column.addWidget(self.curve, 1)
        column.addWidget(self.curve_hint)
        return inner

    # -- showing ---------------------------------------------------------------------------------------
    def show_settings(self, settings: SimulateSettings) -> None:
        """Show the fields of the tasks."""
        for form in self.forms:
            form.set_values({key: shown(key, settings) for key in form.fields})
        self.forms[1].set_enabled("store_tolerance", not settings.progressive, "H in passes is stored in full")
        blocker = QSignalBlocker(self.tolerance_slider)
        self.tolerance_slider.setValue(tolerance_step(settings.tolerance))
        blocker.unblock()

    def show_verdict(self, verdict: EffectsVerdict) -> None:
        """Show the planner's answer: a row for each effect."""
        self.summary.setText(verdict.summary)
        self.table.show_verdict(verdict)
        self.effect.show_plan(verdict.plan)
        self.effect.show_row(verdict.row(self.table.selected))

    def show_preview(self, image: NDArray[np.float32]) -> None:
        """Show the pattern of a position ``(nt, ns)``."""
        self.view.set_shot(Shot(image, name="preview"))

    def show_ladder(self, ladder: Any) -> None:
        """Show measured time and error of every level, and the one that the tolerance picks.

        Rungs are of different engines: no line leads from one to the next.
        """
        self.curve.clear()
        rungs = [rung for rung in ladder.rungs if rung.error > 0]  # the axes are logarithmic
        seconds = [rung.whole_seconds for rung in rungs]
        errors = [100 * rung.error for rung in rungs]
        self.curve.set_curve("measured", seconds, errors, symbol="o", line=False)
        chosen = ladder.chosen
        if chosen is not None and chosen.error > 0:
            x, y = [chosen.whole_seconds], [100 * chosen.error]
            self.curve.set_curve("chosen by the tolerance", x, y, symbol="star", line=False)
        self.curve.plot.autoRange(padding=0.1)
        if chosen is not None:
            self.curve_hint.setText(
                f"{chosen.label}: {100 * chosen.error:.2g} % error, about {format_seconds(chosen.whole_seconds)} "
                "for H. On the page Accuracy every point has its name, and a click uses it."
            )

    def show_no_ladder(self) -> None:
        """Take away what was measured: it is of another plan."""
        self.curve.clear()
        self.curve_hint.setText(NOT_MEASURED)

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        for widget in (self.view, self.curve, self.effect.influence, self.frame):
            widget.apply_theme()

    @property
    def preview_shown(self) -> bool:
        """Whether the response is looked at."""
        return self.tabs.currentWidget() is self._response

    def show_effect(self) -> None:
        """Look at the selected effect, with the keyboard in its magnitudes."""
        self.tabs.setCurrentWidget(self.effect)
        self.effect.form.focus_first()

    def show_frame_tab(self) -> None:
        """Look at the sensor frame."""
        self.tabs.setCurrentWidget(self.frame)

    def show_accuracy_tab(self) -> None:
        """Look at error against time."""
        self.tabs.setCurrentIndex(self.tabs.count() - 1)
