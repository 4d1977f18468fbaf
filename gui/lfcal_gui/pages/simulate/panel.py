"""Record > Compute: what accuracy costs, pictures of one position, and the settings and effects at the right."""

from __future__ import annotations

import math
from collections.abc import Callable

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QFrame, QGridLayout, QLabel, QPushButton, QScrollArea, QTabWidget, QVBoxLayout, QWidget

from lfcal.accuracy import Curve
from lfcal_gui.jobs import Jobs
from lfcal_gui.models import axis_labels, points_of
from lfcal_gui.pages.simulate._effect_panel import EffectPanel
from lfcal_gui.pages.simulate._effects_table import EffectsTable
from lfcal_gui.pages.simulate._frame_panel import FramePanel
from lfcal_gui.pages.simulate._place_line import PlaceLine
from lfcal_gui.pages.simulate.model import (
    FIELDS,
    SimulateSettings,
    better_words,
    numbers_of,
    refusal,
    shown,
    used_rung,
)
from lfcal_gui.pages.simulate.model_effects import EffectsVerdict
from lfcal_gui.widgets import INSPECTOR, CostCurve, Folded, FoldedForm, Picture, card, heading, line, scrolling, split

WIDTH = 304
"""Least width of the settings (px)."""

TAB_TIPS = (
    "One pattern of H, computed with the present settings",
    "The effect chosen in the list: its magnitudes, and what it does to H",
    "A whole sensor frame with noise, as the camera would record it",
)


class SimulatePanel(QWidget):
    """The page's widgets.

    Signals
    -------
    edited(name, value)
        A field of the tasks; see `lfcal_gui.pages.simulate.model.FIELDS`.
    frames_asked(), import_asked(), export_asked(), reset_asked()
        Write the frames of the plan; magnitudes and settings from a file, to a file, or taken back.
    """

    edited = Signal(str, object)
    frames_asked = Signal()
    import_asked = Signal()
    export_asked = Signal()
    reset_asked = Signal()

    def __init__(self, jobs: Jobs) -> None:
        super().__init__()
        self.curve = CostCurve()
        self.view = Picture("share of the light")
        self.effect, self.frame, self.place = EffectPanel(), FramePanel(jobs), PlaceLine()
        self.table = EffectsTable()
        self.table.edit_asked.connect(self.show_effect)
        of_frames = "Sensor frames with noise, as a camera would record them on this plan"
        self.forms = (
            FoldedForm(FIELDS[0]),
            FoldedForm((), FIELDS[1], tip="Level, passes, and the loss in the file of H", framed=True),
            FoldedForm((), FIELDS[2], "Frames instead of H", of_frames, framed=True),
        )
        for form in self.forms:
            form.check = refusal
            form.set_defaults({key: shown(key, SimulateSettings()) for key in form.fields})
            form.edited.connect(self.edited.emit)
        left, column = card("What accuracy costs")
        column.addWidget(self.curve)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(split(left, self._pictures(), self._inspector(), sizes=(40, 34, 28)))

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
        self.better = _hint()
        self.unknown = _hint()
        inner = QWidget()
        column = QVBoxLayout(inner)
        column.setContentsMargins(4, 0, 4, 0)
        column.setSpacing(6)
        column.addLayout(self._numbers())
        for widget in (self.better, self.forms[0], heading("Effects that this H needs")):
            column.addWidget(widget)
        column.addWidget(self.table, 1)
        self._frames()
        for widget in (self.unknown, *self.forms[1:], self._files()):
            column.addWidget(widget)
        area = scrolling(inner)
        area.setProperty(INSPECTOR, True)
        area.setMinimumWidth(WIDTH)
        return area

    def _numbers(self) -> QGridLayout:
        self.seconds, self.error = QLabel(), QLabel()
        self.seconds_words, self.error_words = _hint(), _hint()
        grid = QGridLayout()
        grid.setVerticalSpacing(0)
        for k, (number, words) in enumerate(((self.seconds, self.seconds_words), (self.error, self.error_words))):
            number.setProperty("role", "big")
            grid.addWidget(number, 0, k)
            grid.addWidget(words, 1, k)
            grid.setColumnStretch(k, 1)
        return grid

    def _frames(self) -> None:
        button = QPushButton("Simulate frames …")
        button.setToolTip("Write the frames of the whole plan to a folder, as a job")
        button.clicked.connect(lambda _=False: self.frames_asked.emit())
        self.forms[2].fold_line(button)

    def _files(self) -> Folded:
        fold = Folded("Magnitudes in a file", "Magnitudes and settings of effects, for other projects and commands")
        self.import_button, self.export_button = QPushButton("Import …"), QPushButton("Export …")
        self.reset_button = QPushButton("Reset all")
        tips = (
            "Take magnitudes and settings from a JSON file, as lfcal simulate --effect reads it",
            "Write the magnitudes and settings given here to a JSON file for lfcal simulate --effect",
            "Set every magnitude and setting to its default",
        )
        buttons = (self.import_button, self.export_button, self.reset_button)
        signals = (self.import_asked, self.export_asked, self.reset_asked)
        for button, tip, signal in zip(buttons, tips, signals, strict=True):
            button.setToolTip(tip)
            button.clicked.connect(lambda _=False, signal=signal: signal.emit())
        fold.column.addLayout(line(*buttons))
        return fold

    # -- showing ---------------------------------------------------------------------------------------
    def show_settings(self, settings: SimulateSettings) -> None:
        """Show the fields of the tasks."""
        for form in self.forms:
            form.set_values({key: shown(key, settings) for key in form.fields})
        self.forms[1].set_enabled("store_tolerance", not settings.progressive, "H in passes is stored in full")

    def show_verdict(self, verdict: EffectsVerdict) -> None:
        """Show the planner's answer: a row for each effect."""
        self.table.show_verdict(verdict)
        self.unknown.setText(verdict.unknown)
        self.unknown.setVisible(bool(verdict.unknown))
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
            Processor time of H (s) where it was not measured.
        """
        rung = used_rung(curve, settings)
        if curve is not None:
            self.curve.set_labels(*axis_labels(curve))
        points = () if curve is None else points_of(curve, rung)
        self.curve.show_points(points, math.log10(100 * settings.tolerance))
        seconds = forecast if rung is None else rung.cost
        numbers = numbers_of(rung, settings, None if seconds is None else paced(seconds))
        labels = (self.seconds, self.seconds_words, self.error, self.error_words)
        for label, text in zip(labels, numbers, strict=True):
            label.setText(text)
        self.better.setText(better_words(curve, rung, paced))
        self.better.setVisible(bool(self.better.text()))

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        for widget in (self.view, self.curve, self.effect.influence, self.frame):
            widget.apply_theme()

    @property
    def pattern_shown(self) -> bool:
        """Whether the pattern is looked at."""
        return self.tabs.currentWidget() is self.view

    def show_effect(self) -> None:
        """Look at the selected effect, with the keyboard in its magnitudes."""
        self.tabs.setCurrentWidget(self.effect)
        self.effect.form.focus_first()

    def show_frame_tab(self) -> None:
        """Look at the sensor frame."""
        self.tabs.setCurrentWidget(self.frame)


def _hint() -> QLabel:
    label = QLabel()
    label.setProperty("role", "hint")
    label.setWordWrap(True)
    return label
