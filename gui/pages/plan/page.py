"""Plan: planes, cutout and order; the region on the lattice with the scan path; what it costs."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import pyqtgraph as pg
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QFileDialog, QFrame, QHBoxLayout, QLabel, QScrollArea, QVBoxLayout, QWidget

from gui.base_page import StagePage
from gui.context import Context
from gui.models.page import Stage
from gui.models.project import SessionState
from gui.pages.camera.optics_view import TYPE_COLOURS
from gui.pages.plan import model as plan_form
from gui.widgets.form import Field, Form
from gui.widgets.plots import style_axes, theme_plot
from lfcal.camera import ScanPlan
from lfcal.errors import LfcalError
from lfcal.files import replace_whole, storage_errors

__all__ = ["Page"]


class Page(StagePage):
    """A form on the left, the region in the middle, the forecast on the right; all live."""

    def __init__(self, stage: Stage, context: Context) -> None:
        super().__init__(stage, context)
        self.tool_button("Open …", "A saved plan (.json)", self.open_file)
        self.tool_button("Save …", "Write this plan as JSON, for lfcal acquire and lfcal assemble", self.save_file)
        self.tool_button("Default", "Planes, cutout and anchor as the camera's geometry suggests", self.make_default)
        self.form = Form(tuple(Field(**asdict(spec)) for spec in plan_form.FIELDS))
        self.form.check = self._check
        self.form.edited.connect(self._edited)
        self.forecast = QLabel()
        self.forecast.setTextFormat(Qt.TextFormat.RichText)
        self.forecast.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self._build_region()
        row = QHBoxLayout(self.body)
        row.setContentsMargins(0, 0, 0, 0)
        row.setSpacing(10)
        area = QScrollArea()
        area.setWidgetResizable(True)
        area.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        area.setWidget(_card("Scan", self.form))
        area.setFixedWidth(330)
        row.addWidget(area)
        row.addWidget(_card("Representative region and scan path", self.graphics, stretch=True), 1)
        side = _card("Forecast", self.forecast)
        side.setFixedWidth(280)
        row.addWidget(side)
        context.theme_changed.connect(lambda: theme_plot(self.graphics, self.plot))
        self._show(context.state)

    def _build_region(self) -> None:
        self.graphics = pg.GraphicsLayoutWidget()
        self.plot: pg.PlotItem = self.graphics.addPlot()
        self.plot.setAspectLocked(True)
        self.plot.invertY(True)
        self.plot.setMenuEnabled(False)
        self.plot.hideButtons()
        style_axes(self.plot, "sensor column (px)", "sensor row (px)")
        self.lenslets = pg.ScatterPlotItem(pxMode=False)
        self.path = pg.PlotCurveItem(pen=pg.mkPen("#8b97a8", width=1))
        self.start = pg.ScatterPlotItem(size=10, symbol="o", pen=None, brush=pg.mkBrush("#c62828"))
        self.cell = pg.PlotCurveItem(pen=pg.mkPen("#c62828", width=1.5, style=Qt.PenStyle.DashLine))
        for item in (self.lenslets, self.path, self.cell, self.start):
            self.plot.addItem(item)
        theme_plot(self.graphics, self.plot)

    # -- session -> widgets ------------------------------------------------------------------------------
    def state_changed(self, old: SessionState, new: SessionState) -> None:
        """Show the plan if it changed."""
        if old.plan != new.plan or old.camera != new.camera:
            self._show(new)

    def _show(self, state: SessionState) -> None:
        if state.plan is None:
            self.show_empty(
                "No plan yet for this camera.\nThe plan says where the point source goes and what it costs.",
                {"Make a plan": self.make_default, "Open a plan …": self.open_file},
            )
            return
        self.show_body()
        self.form.set_values(plan_form.values_of(state.plan))
        rows = plan_form.forecast_rows(state.plan)
        cells = "".join(
            f"<tr><td style='padding-right:12px'>{name.replace('  ', '&nbsp;&nbsp;')}</td><td><b>{value}</b></td></tr>"
            for name, value in rows
        )
        self.forecast.setText(f"<table cellspacing='3'>{cells}</table>")
        self._draw(state.plan)

    def _draw(self, plan: ScanPlan) -> None:
        drawing = plan_form.region_drawing(plan)
        brushes = [pg.mkBrush(f"{TYPE_COLOURS[k]}66") for k in drawing.types]
        pens = [pg.mkPen(TYPE_COLOURS[k]) for k in drawing.types]
        self.lenslets.setData(
            drawing.lenslets[:, 1], drawing.lenslets[:, 0], size=2 * drawing.radius_px, brush=brushes, pen=pens
        )
        self.path.setData(drawing.path[:, 1], drawing.path[:, 0])
        self.start.setData(drawing.path[:1, 1], drawing.path[:1, 0])
        top, left = drawing.corner[0] - 0.5, drawing.corner[1] - 0.5
        bottom, right = top + drawing.size[0], left + drawing.size[1]
        self.cell.setData([left, right, right, left, left], [top, top, bottom, bottom, top])
        points = drawing.lenslets
        if len(points):
            low, high = points.min(0) - drawing.radius_px, points.max(0) + drawing.radius_px
            self.plot.setRange(xRange=(low[1], high[1]), yRange=(low[0], high[0]), padding=0.02)

    # -- widgets -> session ------------------------------------------------------------------------------
    def _check(self, key: str, value: Any) -> str:
        plan = self.context.state.plan
        return "" if plan is None else plan_form.apply_change(plan, key, value)[1]

    def _edited(self, key: str, value: Any) -> None:
        plan = self.context.state.plan
        changed = None if plan is None else plan_form.apply_change(plan, key, value)[0]
        if changed is not None:
            self.context.session.update(f"change of {key.replace('_', ' ')}", plan=changed)

    def make_default(self) -> None:
        """Make the plan that the camera's geometry suggests."""
        try:
            self.context.session.update("default plan", plan=plan_form.default_plan(self.context.state.camera))
        except LfcalError as error:
            self.context.message.emit(str(error))

    def open_file(self, path: str = "") -> None:
        """Take a plan, and its camera, from a file."""
        path = path or QFileDialog.getOpenFileName(self, "Open plan", "", "Plans (*.json)")[0]
        if not path:
            return
        try:
            with storage_errors(Path(path)):
                plan = ScanPlan.from_json(Path(path).read_text(encoding="utf-8", errors="replace"))
        except LfcalError as error:
            self.context.message.emit(str(error))
            return
        self.context.session.update(f"plan {Path(path).name}", plan=plan, camera=plan.camera)

    def save_file(self, path: str = "") -> None:
        """Write the plan as JSON."""
        plan = self.context.state.plan
        if plan is None:
            return
        path = path or QFileDialog.getSaveFileName(self, "Save plan", "plan.json", "Plans (*.json)")[0]
        if not path:
            return
        try:
            with replace_whole(path) as part:
                part.write_text(plan.to_json(), encoding="utf-8")
            self.context.message.emit(f"plan saved as {path}")
        except LfcalError as error:
            self.context.message.emit(str(error))

    def accept_drop(self, paths: list[str]) -> bool:
        """Take a dropped plan."""
        if len(paths) == 1 and paths[0].endswith(".json"):
            self.open_file(paths[0])
            return True
        return False


def _card(title: str, content: QWidget, *, stretch: bool = False) -> QFrame:
    frame = QFrame()
    frame.setProperty("role", "card")
    column = QVBoxLayout(frame)
    column.setContentsMargins(14, 10, 14, 12)
    heading = QLabel(title)
    heading.setProperty("role", "heading")
    column.addWidget(heading)
    column.addWidget(content, 1 if stretch else 0)
    if not stretch:
        column.addStretch()
    return frame
