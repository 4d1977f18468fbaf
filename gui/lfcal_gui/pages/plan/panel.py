"""Plan: the scan (a form, the region with the path, the forecast), and the target that stands for it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pyqtgraph as pg
from numpy.typing import NDArray
from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QFrame, QHBoxLayout, QLabel, QScrollArea, QTabWidget, QVBoxLayout, QWidget

from lfcal.base import LfcalError
from lfcal.camera import ScanPlan
from lfcal.tasks import PlanScan
from lfcal_gui.models import fields_of
from lfcal_gui.pages.plan._target_panel import TargetPanel
from lfcal_gui.pages.plan.model import (
    HELD,
    RegionDrawing,
    forecast_rows,
    half_of,
    path_lines,
    region_drawing,
    values_of,
)
from lfcal_gui.pages.plan.model_target import PlanSettings
from lfcal_gui.theme import TYPE_COLOURS
from lfcal_gui.widgets import Folded, Form, WrappedLabel, card, offer_menu, style_axes, table_entries, theme_plot

__all__ = ["PlanPanel"]

COLUMN_PX, LIST_PX = 360, 310
"""Widths of the form, and of fields of several numbers: four depths of eight digits are seen whole."""

SCAN = "One point, moved from position to position: planes, cutout, order and cost"
TARGET = "Many points in every frame, for the same positions in far fewer frames"


class PlanPanel(QWidget):
    """The page's widgets.

    Parameters
    ----------
    check
        Returns why a field cannot take a value, or an empty string.

    Signals
    -------
    edited(key, value)
        The user changed a field, and it passes.
    """

    edited = Signal(str, object)

    def __init__(self, check: Callable[[str, Any], str]) -> None:
        super().__init__()
        self.form, self.more = (Form(fields_of(PlanScan, without=HELD, more=more)) for more in (False, True))
        for form in (self.form, self.more):
            form.check = check
            form.edited.connect(self.edited.emit)
        for key in ("virtual_depths", "depths"):
            self.form.own_line(key, LIST_PX)
        self._plan: ScanPlan | None = None
        self._half: NDArray[np.intp] | None = None
        """Positions of a half-cell scan; None: all are recorded."""
        self.refused = WrappedLabel()
        self.refused.setProperty("role", "error")
        self.target = TargetPanel()
        self.forecast = QLabel()
        self.forecast.setTextFormat(Qt.TextFormat.RichText)
        self.forecast.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self._build_region()
        self.tabs = QTabWidget()
        for tab, title, tip in ((self._scan_tab(), "Scan", SCAN), (self.target, "Target of many points", TARGET)):
            self.tabs.setTabToolTip(self.tabs.addTab(tab, title), tip)
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        column.addWidget(self.tabs)

    def _scan_tab(self) -> QWidget:
        tab = QWidget()
        row = QHBoxLayout(tab)
        row.setContentsMargins(0, 8, 0, 0)
        row.setSpacing(10)
        area = QScrollArea()
        area.setWidgetResizable(True)
        area.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        more = Folded("More settings", "Order, stage axes, half-cell scan, and the speeds that the forecast assumes")
        more.column.addWidget(self.more)
        area.setWidget(_titled("Scan", self.form, more))
        area.setFixedWidth(COLUMN_PX)
        row.addWidget(area)
        row.addWidget(_titled("Representative region and scan path", self.graphics, stretch=1), 1)
        side = _titled("Forecast", self.forecast, self.refused)
        side.setFixedWidth(310)
        row.addWidget(side)
        return tab

    def _build_region(self) -> None:
        self.graphics = pg.GraphicsLayoutWidget()
        self.plot: pg.PlotItem = self.graphics.addPlot(enableMenu=False)
        self.plot.setAspectLocked(True)
        self.plot.invertY(True)
        self.plot.hideButtons()
        style_axes(self.plot, "sensor column (px)", "sensor row (px)")
        self.lenslets = pg.ScatterPlotItem(pxMode=False)
        self.path = pg.PlotCurveItem(pen=pg.mkPen("#8b97a8", width=1))
        self.start = pg.ScatterPlotItem(size=10, symbol="o", pen=None, brush=pg.mkBrush("#c62828"))
        self.cell = pg.PlotCurveItem(pen=pg.mkPen("#c62828", width=1.5, style=Qt.PenStyle.DashLine))
        for item in (self.lenslets, self.path, self.cell, self.start):
            self.plot.addItem(item)
        offer_menu(self.graphics, lambda: "region", self._entries)
        theme_plot(self.graphics, self.plot)

    def _entries(self) -> list[tuple[str, Any]]:
        plan, half = self._plan, self._half
        return [] if plan is None else table_entries(self, "scan path", lambda between: path_lines(plan, between, half))

    def show_plan(self, plan: ScanPlan, settings: PlanSettings) -> None:
        """Show a plan: its values, its region, what it costs."""
        self._plan, why = plan, ""
        try:
            self._half = half_of(plan) if settings.half_cell else None
        except LfcalError as error:
            self._half, why = None, str(error)
        self.refused.setText(why)
        self.refused.setVisible(bool(why))
        values = {**settings.shown(), **values_of(plan)}
        for form in (self.form, self.more):
            form.set_values({key: values[key] for key in form.fields})
        cells = "".join(
            f"<tr><td style='padding-right:12px'>{name.replace('  ', '&nbsp;&nbsp;')}</td><td><b>{value}</b></td></tr>"
            for name, value in forecast_rows(plan, settings.speed, settings.frame_rate, self._half)
        )
        self.forecast.setText(f"<table cellspacing='3'>{cells}</table>")
        self._draw(region_drawing(plan, self._half))

    def _draw(self, drawing: RegionDrawing) -> None:
        brushes = [pg.mkBrush(f"{TYPE_COLOURS[k]}66") for k in drawing.types]
        pens = [pg.mkPen(TYPE_COLOURS[k]) for k in drawing.types]
        self.lenslets.setData(
            drawing.lenslets[:, 1], drawing.lenslets[:, 0], size=2 * drawing.radius_px, brush=brushes, pen=pens
        )
        self.path.setData(drawing.path[:, 1], drawing.path[:, 0])
        self.start.setData(drawing.path[:1, 1], drawing.path[:1, 0])
        # pixel centres have whole numbers: the cell's edge lies half a pixel outside
        top, left = drawing.corner[0] - 0.5, drawing.corner[1] - 0.5
        bottom, right = top + drawing.size[0], left + drawing.size[1]
        self.cell.setData([left, right, right, left, left], [top, top, bottom, bottom, top])
        points = drawing.lenslets
        if len(points):
            low, high = points.min(0) - drawing.radius_px, points.max(0) + drawing.radius_px
            self.plot.setRange(xRange=(low[1], high[1]), yRange=(low[0], high[0]), padding=0.02)

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        theme_plot(self.graphics, self.plot)
        self.target.apply_theme()


def _titled(title: str, *contents: QWidget, stretch: int = 0) -> QFrame:
    frame, column = card(title)
    for content in contents:
        column.addWidget(content, stretch)
    if not stretch:
        column.addStretch()
    return frame
