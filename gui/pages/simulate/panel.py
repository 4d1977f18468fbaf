"""Simulate: effects on the left; preview and accuracy against time on the right."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtGui import QColor
from PySide6.QtWidgets import (
    QAbstractItemView,
    QComboBox,
    QFrame,
    QGridLayout,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QSlider,
    QTableWidget,
    QTableWidgetItem,
    QWidget,
)

from gui.pages.simulate.model import (
    LEVELS,
    STEPS,
    Z_STEPS,
    EffectRow,
    SimulateSettings,
    Verdict,
    tolerance_of,
    tolerance_step,
)
from gui.theme import current_theme
from gui.widgets.cards import card, choice_box, heading
from gui.widgets.image_view import ImageView
from gui.widgets.plots import LinePlot
from lfcal.units import format_seconds

__all__ = ["SimulatePanel"]

COLUMNS = ("Effect", "Choice", "Size", "Error if left out", "Costs")


class SimulatePanel(QWidget):
    """The page's widgets.

    Signals
    -------
    tolerance_asked(value), level_asked(name)
        Settings of the simulation.
    choice_asked(effect, choice)
        ``"auto"``, ``"on"`` or ``"off"`` for an effect.
    depth_moved()
        The preview's depth is dragged.
    """

    tolerance_asked = Signal(float)
    level_asked = Signal(str)
    choice_asked = Signal(str, str)
    depth_moved = Signal()

    def __init__(self) -> None:
        super().__init__()
        self._rows: tuple[EffectRow, ...] = ()
        grid = QGridLayout(self)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setSpacing(10)
        grid.addWidget(self._effects_card(), 0, 0, 2, 1)
        grid.addWidget(self._preview_card(), 0, 1)
        grid.addWidget(self._curve_card(), 1, 1)
        grid.setColumnStretch(0, 3)
        grid.setColumnStretch(1, 2)
        grid.setRowStretch(0, 1)
        grid.setRowStretch(1, 0)

    # -- building --------------------------------------------------------------------------------------
    def _effects_card(self) -> QFrame:
        frame, column = card("Effects")
        self.tolerance_label = QLabel()
        self.tolerance_slider = QSlider(Qt.Orientation.Horizontal)
        self.tolerance_slider.setRange(0, STEPS)
        self.tolerance_slider.setToolTip("Relative L1 error allowed for everything that is left out")
        self.tolerance_slider.valueChanged.connect(lambda step: self.tolerance_asked.emit(tolerance_of(step)))
        self.level_box = choice_box(LEVELS, "Level of the computation")
        self.level_box.currentIndexChanged.connect(lambda _: self.level_asked.emit(self.level_box.currentData()))
        row = QHBoxLayout()
        row.addWidget(self.tolerance_label)
        row.addWidget(self.tolerance_slider, 1)
        row.addWidget(QLabel("Level"))
        row.addWidget(self.level_box)
        self._build_table()
        self.why = QLabel("Choose an effect to see why it is on or off.")
        self.why.setProperty("role", "hint")
        self.why.setWordWrap(True)
        self.why.setMinimumHeight(54)
        self.why.setAlignment(Qt.AlignmentFlag.AlignTop)
        self.summary = QLabel()
        self.summary.setWordWrap(True)
        column.addLayout(row)
        column.addWidget(self.table, 1)
        column.addWidget(self.why)
        column.addWidget(self.summary)
        return frame

    def _build_table(self) -> None:
        self.table = QTableWidget(0, len(COLUMNS))
        self.table.setHorizontalHeaderLabels(COLUMNS)
        self.table.verticalHeader().hide()
        self.table.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
        self.table.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.table.itemSelectionChanged.connect(self._explain)
        self.table.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self.table.setWordWrap(False)
        header = self.table.horizontalHeader()
        for k in range(len(COLUMNS)):
            mode = QHeaderView.ResizeMode.Stretch if k == 2 else QHeaderView.ResizeMode.ResizeToContents
            header.setSectionResizeMode(k, mode)

    def _preview_card(self) -> QFrame:
        frame, column = card()
        self.preview_label = heading("")
        self.view = ImageView(value_label="share of the light")
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
        return frame

    def _curve_card(self) -> QFrame:
        frame, column = card("What accuracy costs")
        self.curve = LinePlot("processor time for the whole H (s)", "relative L1 error (%)", legend=True)
        self.curve.plot.setLogMode(True, True)
        self.curve.setMaximumHeight(250)
        self.curve_hint = QLabel("Measure accuracy to see time and error of every level for this camera.")
        self.curve_hint.setProperty("role", "hint")
        self.curve_hint.setWordWrap(True)
        column.addWidget(self.curve, 1)
        column.addWidget(self.curve_hint)
        return frame

    # -- showing ---------------------------------------------------------------------------------------
    def show_settings(self, settings: SimulateSettings) -> None:
        """Show tolerance and level."""
        self.tolerance_label.setText(f"Tolerance {100 * settings.tolerance:.2g} %")
        blockers = [QSignalBlocker(widget) for widget in (self.tolerance_slider, self.level_box)]
        self.tolerance_slider.setValue(tolerance_step(settings.tolerance))
        self.level_box.setCurrentIndex(max(0, self.level_box.findData(settings.level)))
        for blocker in blockers:
            blocker.unblock()

    def show_verdict(self, verdict: Verdict) -> None:
        """Show the planner's answer: a row for each effect."""
        theme = current_theme()
        self._rows = verdict.rows
        self.summary.setText(verdict.summary)
        self.table.setRowCount(len(verdict.rows))
        for k, row in enumerate(verdict.rows):
            texts = (row.name.replace("_", " "), "", row.size, row.error, row.seconds)
            for column, text in enumerate(texts):
                item = QTableWidgetItem(text)
                item.setToolTip(f"{row.reason}\n{row.formula}")
                item.setForeground(QColor(theme.text if row.on else theme.muted))
                self.table.setItem(k, column, item)
            self.table.setCellWidget(k, 1, self._choice(row))

    def _choice(self, row: EffectRow) -> QComboBox:
        found = f"auto ({'on' if row.on else 'off'})" if row.setting == "auto" else "auto"
        box = choice_box((("auto", found), ("on", "on"), ("off", "off")))
        box.setCurrentIndex(box.findData(row.setting))
        box.setAccessibleName(f"choice for {row.name}")
        box.activated.connect(lambda _=0, name=row.name, box=box: self.choice_asked.emit(name, box.currentData()))
        return box

    def show_preview(self, image: NDArray[np.float32]) -> None:
        """Show the pattern of a position ``(nt, ns)``."""
        self.view.set_image(image, name="preview")

    def show_ladder(self, ladder: Any) -> None:
        """Show measured time and error of every level, and the one that the tolerance picks."""
        self.curve.clear()
        rungs = [rung for rung in ladder.rungs if rung.error > 0]  # the axes are logarithmic
        seconds = [rung.whole_seconds for rung in rungs]
        self.curve.set_curve("measured", seconds, [100 * rung.error for rung in rungs], symbol="o")
        chosen = ladder.chosen
        if chosen is not None:
            self.curve.set_curve("chosen by the tolerance", [chosen.whole_seconds], [100 * chosen.error], symbol="star")
            self.curve_hint.setText(
                f"{chosen.label}: {100 * chosen.error:.2g} % error, about {format_seconds(chosen.whole_seconds)} for H"
            )

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        for widget in (self.view, self.curve):
            widget.apply_theme()

    def _explain(self) -> None:
        row = self.table.currentRow()
        if 0 <= row < len(self._rows):
            chosen = self._rows[row]
            self.why.setText(f"{chosen.name.replace('_', ' ')}: {chosen.reason}\nEstimate: {chosen.formula}")
