"""Simulate: only the effects the scene calls for, and what accuracy costs in time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import Qt
from PySide6.QtGui import QColor
from PySide6.QtWidgets import (
    QAbstractItemView,
    QComboBox,
    QFileDialog,
    QFrame,
    QGridLayout,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QSlider,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
)

from gui.base_page import StagePage
from gui.context import Context
from gui.models.page import Stage
from gui.models.project import SessionState
from gui.pages.simulate.model import STEPS, Verdict, preview, tolerance_of, tolerance_step, verdict_of
from gui.theme import current_theme
from gui.widgets.image_view import ImageView
from gui.widgets.plots import LinePlot
from lfcal.units import format_length, format_seconds

__all__ = ["Page"]

LEVELS = (
    ("auto", "auto: what the effects call for"),
    ("geometric", "geometric: rays, instant"),
    ("wave", "wave: per lenslet"),
    ("microscope", "microscope: coherent"),
)
COLUMNS = ("Effect", "Choice", "Size", "Error if left out", "Costs")
Z_STEPS = 200


class Page(StagePage):
    """Effects on the left; preview and accuracy against time on the right."""

    def __init__(self, stage: Stage, context: Context) -> None:
        super().__init__(stage, context)
        self.verdict: Verdict | None = None
        self._z = 0.0
        self.tool_button(
            "Measure the ladder", "Time and error of every level and sampling for this camera", self.ladder
        )
        self.tool_button("Simulate H …", "Compute the whole H of the plan as a job", self.simulate, primary=True)
        self._build()
        context.theme_changed.connect(self._apply_theme)
        self._show(context.state)

    # -- building --------------------------------------------------------------------------------------
    def _build(self) -> None:
        self.table = QTableWidget(0, len(COLUMNS))
        self.table.setHorizontalHeaderLabels(COLUMNS)
        self.table.verticalHeader().hide()
        self.table.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
        self.table.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.table.itemSelectionChanged.connect(self._explain)
        self.table.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self.table.setWordWrap(False)
        header = self.table.horizontalHeader()
        for column in range(len(COLUMNS) - 1):
            header.setSectionResizeMode(column, QHeaderView.ResizeMode.ResizeToContents)
        header.setSectionResizeMode(2, QHeaderView.ResizeMode.Stretch)
        header.setSectionResizeMode(len(COLUMNS) - 1, QHeaderView.ResizeMode.ResizeToContents)
        self.why = QLabel("Choose an effect to see why it is on or off.")
        self.why.setProperty("role", "hint")
        self.why.setWordWrap(True)
        self.why.setMinimumHeight(54)
        self.why.setAlignment(Qt.AlignmentFlag.AlignTop)
        self.summary = QLabel()
        self.summary.setWordWrap(True)
        self.view = ImageView(value_label="share of the light")
        self.preview_label = QLabel()
        self.preview_label.setProperty("role", "heading")
        self.z_slider = QSlider(Qt.Orientation.Horizontal)
        self.z_slider.setRange(0, Z_STEPS)
        self.z_slider.setToolTip("Depth of the preview: rays while you drag, the chosen level when you stop")
        self.z_slider.valueChanged.connect(self._drag)
        self.curve = LinePlot("processor time for the whole H (s)", "relative L1 error (%)", legend=True)
        self.curve.plot.setLogMode(True, True)
        self.curve.setMaximumHeight(250)
        grid = QGridLayout(self.body)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setSpacing(10)
        grid.addWidget(self._effects_card(), 0, 0, 2, 1)
        grid.addWidget(self._preview_card(), 0, 1)
        grid.addWidget(self._curve_card(), 1, 1)
        grid.setColumnStretch(0, 3)
        grid.setColumnStretch(1, 2)
        grid.setRowStretch(0, 1)
        grid.setRowStretch(1, 0)

    def _effects_card(self) -> QFrame:
        frame, column = _card("Effects")
        row = QHBoxLayout()
        self.tolerance_label = QLabel()
        self.tolerance_slider = QSlider(Qt.Orientation.Horizontal)
        self.tolerance_slider.setRange(0, STEPS)
        self.tolerance_slider.setToolTip("Relative L1 error allowed for all that is left out")
        self.tolerance_slider.valueChanged.connect(self._tolerance)
        self.level_box = QComboBox()
        for value, text in LEVELS:
            self.level_box.addItem(text, value)
        self.level_box.setToolTip("Level of the computation")
        self.level_box.currentIndexChanged.connect(self._level)
        row.addWidget(self.tolerance_label)
        row.addWidget(self.tolerance_slider, 1)
        row.addWidget(QLabel("Level"))
        row.addWidget(self.level_box)
        column.addLayout(row)
        column.addWidget(self.table, 1)
        column.addWidget(self.why)
        column.addWidget(self.summary)
        return frame

    def _preview_card(self) -> QFrame:
        frame, column = _card("")
        column.addWidget(self.preview_label)
        column.addWidget(self.view, 1)
        row = QHBoxLayout()
        row.addWidget(QLabel("z"))
        row.addWidget(self.z_slider, 1)
        column.addLayout(row)
        return frame

    def _curve_card(self) -> QFrame:
        frame, column = _card("What accuracy costs")
        self.curve_hint = QLabel("Measure the ladder to see time and error of every level for this camera.")
        self.curve_hint.setProperty("role", "hint")
        self.curve_hint.setWordWrap(True)
        column.addWidget(self.curve, 1)
        column.addWidget(self.curve_hint)
        return frame

    # -- session -> widgets ------------------------------------------------------------------------------
    def state_changed(self, old: SessionState, new: SessionState) -> None:
        """Plan again if camera, plan or settings changed."""
        if old.plan != new.plan or old.simulate != new.simulate:
            self._show(new)

    def _show(self, state: SessionState) -> None:
        if state.plan is None:
            self.show_empty(
                "The simulation needs a scan plan: which positions, planes and cutout.",
                {"Plan": lambda: self.context.go.emit("plan", None)},
            )
            return
        self.show_body()
        settings, plan = state.simulate, state.plan
        self.tolerance_label.setText(f"Tolerance {100 * settings.tolerance:.2g} %")
        for widget, value in ((self.tolerance_slider, tolerance_step(settings.tolerance)),):
            widget.blockSignals(True)
            widget.setValue(value)
            widget.blockSignals(False)
        self.level_box.blockSignals(True)
        self.level_box.setCurrentIndex(max(0, self.level_box.findData(settings.level)))
        self.level_box.blockSignals(False)
        self.context.jobs.compute(
            "simulate plan", lambda: verdict_of(plan, settings), self._planned, self.context.message.emit
        )

    def _planned(self, verdict: Verdict) -> None:
        self.verdict = verdict
        theme = current_theme()
        self.summary.setText(verdict.summary)
        self.table.setRowCount(len(verdict.rows))
        for k, row in enumerate(verdict.rows):
            texts = (row.name.replace("_", " "), "", row.size, row.error, row.seconds)
            for column, text in enumerate(texts):
                item = QTableWidgetItem(text)
                item.setToolTip(f"{row.reason}\n{row.formula}")
                item.setForeground(QColor(theme.text if row.on else theme.muted))
                self.table.setItem(k, column, item)
            self.table.setCellWidget(k, 1, self._choice(row.name, row.setting, row.on))
        self._preview(fine=True)

    def _explain(self) -> None:
        row = self.table.currentRow()
        if self.verdict is not None and 0 <= row < len(self.verdict.rows):
            chosen = self.verdict.rows[row]
            self.why.setText(f"{chosen.name.replace('_', ' ')}: {chosen.reason}\nEstimate: {chosen.formula}")

    def _choice(self, name: str, setting: str, on: bool) -> QComboBox:
        box = QComboBox()
        for value, text in (("auto", f"auto ({'on' if on else 'off'})"), ("on", "on"), ("off", "off")):
            box.addItem(text if value != "auto" or setting == "auto" else "auto", value)
        box.setCurrentIndex(box.findData(setting))
        box.setAccessibleName(f"choice for {name}")
        box.activated.connect(lambda _=0, name=name, box=box: self._override(name, box.currentData()))
        return box

    # -- widgets -> session ------------------------------------------------------------------------------
    def _tolerance(self, step: int) -> None:
        settings = replace(self.context.state.simulate, tolerance=tolerance_of(step))
        self.context.session.merge("tolerance", simulate=settings)

    def _level(self, _: int) -> None:
        settings = replace(self.context.state.simulate, level=self.level_box.currentData())
        self.context.session.update("level of simulation", simulate=settings)

    def _override(self, name: str, choice: str) -> None:
        settings = self.context.state.simulate.with_override(name, choice)
        self.context.session.update(f"choice for {name}", simulate=settings)

    # -- preview -----------------------------------------------------------------------------------------
    def _depth(self) -> float:
        plan = self.context.state.plan
        assert plan is not None
        low, high = min(plan.depths_um), max(plan.depths_um)
        if low == high:
            low, high = low - abs(low or 100) / 2, high + abs(high or 100) / 2
        return low + (high - low) * self.z_slider.value() / Z_STEPS

    def _drag(self, _: int) -> None:
        if self.context.state.plan is not None:
            self._preview(fine=False)

    def _preview(self, *, fine: bool) -> None:
        """Show rays at once; when nothing newer came, the chosen level."""
        plan, verdict = self.context.state.plan, self.verdict
        if plan is None or verdict is None:
            return
        settings, z = self.context.state.simulate, self._depth()
        level = settings.level if fine else "geometric"
        effects = verdict.effects if fine else ()
        virtual = plan.camera.virtual_depth(z)
        title = f"Preview at z = {format_length(z)}, v = {virtual:.2f}: {'level ' + level if fine else 'rays …'}"
        self.preview_label.setText(title)
        self.context.jobs.compute(
            "simulate preview",
            lambda: preview(plan, z, effects, level, settings.tolerance),
            lambda image: self._previewed(image, fine),
            self.preview_label.setText,
        )

    def _previewed(self, image: NDArray[np.float32], fine: bool) -> None:
        self.view.set_image(image, name="preview")
        if not fine:
            self._preview(fine=True)

    # -- work --------------------------------------------------------------------------------------------
    def simulate(self, path: str = "") -> None:
        """Simulate the whole H as a job."""
        from lfcal.simulate.simulate import iter_simulate_psf

        plan, verdict = self.context.state.plan, self.verdict
        if plan is None or verdict is None:
            return
        path = path or QFileDialog.getSaveFileName(self, "Simulate H", "simulated.h5", "H file (*.h5)")[0]
        if not path:
            return
        settings = self.context.state.simulate
        self.context.forget(path)
        self.context.jobs.start(
            f"Simulate {Path(path).name}",
            "simulate",
            lambda: iter_simulate_psf(
                plan.camera, plan, verdict.effects, settings.level, tolerance=settings.tolerance, out=path
            ),
            self._simulated,
        )

    def _simulated(self, matrix: Any) -> None:
        path = matrix.path
        matrix.close()
        self.context.message.emit(f"simulated {path}")
        changes = {"reference": path} if self.context.state.psf else {"psf": path, "reference": path}
        self.context.session.update("simulation", **changes)

    def ladder(self) -> None:
        """Measure time and error of every level, as a job."""
        from lfcal.simulate.accuracy.ladder import iter_ladder

        plan = self.context.state.plan
        if plan is not None:
            tolerance = self.context.state.simulate.tolerance
            self.context.jobs.start(
                "Accuracy against time", "simulate", lambda: iter_ladder(plan.camera, plan, tolerance), self._climbed
            )

    def _climbed(self, ladder: Any) -> None:
        self.curve.clear()
        rungs = [rung for rung in ladder.rungs if rung.error > 0]
        seconds = [rung.whole_seconds for rung in rungs]
        errors = [100 * rung.error for rung in rungs]
        self.curve.set_curve("measured", seconds, errors, symbol="o")
        chosen = ladder.chosen
        if chosen is not None:
            self.curve.set_curve("picked by the tolerance", [chosen.whole_seconds], [100 * chosen.error], symbol="star")
            self.curve_hint.setText(
                f"{chosen.label}: {100 * chosen.error:.2g} % error, about {format_seconds(chosen.whole_seconds)} for H"
            )

    def _apply_theme(self) -> None:
        for widget in (self.view, self.curve):
            widget.apply_theme()
        if self.verdict is not None:
            self._planned(self.verdict)


def _card(title: str) -> tuple[QFrame, QVBoxLayout]:
    frame = QFrame()
    frame.setProperty("role", "card")
    column = QVBoxLayout(frame)
    column.setContentsMargins(12, 8, 12, 10)
    if title:
        heading = QLabel(title)
        heading.setProperty("role", "heading")
        column.addWidget(heading)
    return frame, column
