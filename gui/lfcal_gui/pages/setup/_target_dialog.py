"""Dialog for a target of many points: settings, planning as a job, images, costs, and saving."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import QSignalBlocker, Qt
from PySide6.QtWidgets import QComboBox, QDialog, QHBoxLayout, QLabel, QWidget

from lfcal.base import format_length
from lfcal.camera import ScanPlan
from lfcal.tasks import PlanTarget
from lfcal_gui.context import Context
from lfcal_gui.jobs import WindowJob
from lfcal_gui.models import ProjectState, fields_of, minus, rounded
from lfcal_gui.pages.setup import model_target
from lfcal_gui.pages.setup.model_target import PlaneDrawing, PlannedTarget, PlanSettings
from lfcal_gui.pages.setup.step import target_step
from lfcal_gui.saving import ask_target, write_file
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets import (
    FoldedForm,
    PeriodMap,
    Plot,
    RowsTable,
    WrappedLabel,
    button,
    card,
    column_area,
    column_of,
    line,
    name_controls,
    offer_menu,
    table_entries,
    theme_table,
    told_or_shown,
)

COLUMN_PX, MAP_PX, TABLE_PX = 346, 330, 186
FIRST, LAST = 40, 225
"""Positions of the first and the last frame on the colour map, whose ends are hard to see in one of the themes."""

NO_TARGET = "none: a single point"
POINT_WORDS = (
    "A single point: the scan as planned in Set up.\nFor many points in each frame, type "
    "array (lfcal proposes the pitch), or describe an array, such as array:4x4@1.7mm."
)
COSTS = (
    "Noise: expected error of a recorded pattern from sensor noise in the middle plane, as "
    "the sum of errors divided by the sum of light. Phases: percentage of positions that are "
    "covered, of all planes. Both are given for all frames and for the first half of them"
)
PLAN, STOP = "Search for the fewest frames that cover all phases", "Stop searching without creating a plan"
SAVE = "Save the positions of the target in all frames as a plan (.json). To record it, choose the file in Record > Rig"
PLANES = (
    "Number of frames of each plane, and the number if every frame showed the most points; points "
    "in each frame; fraction of the phases that are covered; crosstalk of neighbouring points"
)
NUMBERS = re.compile(r"\d+\.\d+")
READY_WORDS = "There is no plan yet.\nPress Plan target to search for the fewest frames that cover all phases."


def _rectangle(top: float, left: float, rows: float, columns: float, *, gap: bool = False) -> tuple[Any, Any]:
    """Return columns and rows of the corners of a rectangle, in order; with ``gap``, followed by a gap."""
    bottom, right, end = top + rows, left + columns, [np.nan] * gap
    return np.array([left, right, right, left, left, *end]), np.array([top, top, bottom, bottom, top, *end])


def _costs(found: PlannedTarget) -> str:
    head = "<tr><td></td><td style='padding-right:12px'>this target</td><td>single point</td></tr>"
    cells = "".join(
        f"<tr><td style='padding-right:12px'>{name.replace('  ', '&nbsp;&nbsp;')}</td><td><b>{ours}</b></td>"
        f"<td>{single}</td></tr>"
        for name, ours, single in found.summary()
    )
    return f"<table cellspacing='3'>{head}{cells}</table>"


def _covered(plane: PlaneDrawing) -> str:
    missing, most = int((plane.shown == 0).sum()), int(plane.shown.max())
    crossed = f"{missing:,} of {plane.shown.size:,} are not covered (grey). " if missing else ""
    return (
        f"{crossed}The brighter a position, the more frames show it (at most {most}). Click a "
        "position to read its number."
    )


def _note(found: PlannedTarget) -> str:
    from lfcal.targets import target_words

    missing = sum(int((plane.shown == 0).sum()) for plane in found.planes)
    words = NUMBERS.sub(lambda number: rounded(number[0]), target_words(found.plan.target))
    if missing:
        words += (
            f". {missing:,} phases are not covered: allow more frames, or fit the optics to the phases that are covered"
        )
    words += ". Crosstalk is computed from rays, without diffraction" if found.plan.tails == "geometric" else ""
    return f"{words}. {found.coding_briefly}".rstrip()


class TargetDialog(QDialog):
    """Dialog with the settings of a target and its plan; a plan for other settings is not shown."""

    def __init__(self, parent: QWidget, context: Context) -> None:
        super().__init__(parent)
        self.setWindowTitle("Target of many points")
        self.resize(980, 560)
        self.context = context
        self.found: PlannedTarget | None = None
        self._job = 0
        self._asked: tuple[ScanPlan, PlanSettings] | None = None
        some, rare = (fields_of(PlanTarget, without=model_target.HELD_OF_TARGET, more=more) for more in (False, True))
        some = tuple(replace(one, empty=NO_TARGET) if one.key == "source" else one for one in some)
        self.form = FoldedForm(some, rare, tip="Limits of the pose, and light level for coded frames")
        self.form.set_defaults(PlanSettings().shown())
        self.form.own_line("source")
        self.form.own_line("pose")
        self.form.check = lambda *given: model_target.refused_setting(context.project, *given)
        self.form.edited.connect(lambda *given: context.edit(PlanSettings.of(context.state), *given))
        self._build_images()
        self._build_map()
        self.table = RowsTable(model_target.TABLE, 0, range(1, len(model_target.TABLE)), spare=(2,))
        self.table.setAccessibleName("Planes of the target's plan")
        self.table.setToolTip(PLANES)
        self.message, self.stack = told_or_shown(POINT_WORDS, self._results())
        row = QHBoxLayout(self)
        row.setSpacing(10)
        row.addWidget(column_area(COLUMN_PX, self._form_card()))
        row.addWidget(self.stack, 1)
        name_controls(self)
        context.jobs.finished.connect(self._job_finished)
        self.show_state(context.state)

    # -- building --------------------------------------------------------------------------------------
    def _form_card(self) -> QWidget:
        frame, column = card()
        self.plan_button = button("Plan target", PLAN, self.plan_target)
        self.stop_button = button("Stop", STOP, lambda: self.context.jobs.cancel(self._job))
        self.save_button = button("Save target plan …", SAVE, self.save_target)
        self.costs = QLabel()
        self.costs.setToolTip(COSTS)
        self.costs.setTextFormat(Qt.TextFormat.RichText)
        self.costs.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.note = WrappedLabel("", role="hint")
        column.addWidget(self.form)
        column.addLayout(line(self.plan_button, self.stop_button))
        column.addWidget(self.save_button)
        column.addWidget(self.costs)
        column.addWidget(self.note)
        return frame

    def _build_images(self) -> None:
        self.graphics = pg.GraphicsView()
        self.graphics.setMinimumSize(120, 96)
        self.graphics.setToolTip(
            "Images of the points of the target in the frames; squares are the cutouts of the first frame"
        )
        self.graphics.setAccessibleName("Images of the target on the sensor")
        self.plot = Plot(margin=10)
        self.graphics.setCentralItem(self.plot)
        self.plot.vb.setAspectLocked(True)
        self.plot.vb.invertY(True)
        self.plot.name_axes("sensor column (px)", "sensor row (px)")
        self.sensor, self.cutouts = pg.PlotCurveItem(), pg.PlotCurveItem(connect="finite")
        self.points = pg.ScatterPlotItem(size=5, pen=None)
        for item in (self.sensor, self.cutouts, self.points):
            self.plot.addItem(item)
        offer_menu(self.graphics, lambda: "target", self._entries)
        self.graphics.setBackground(current_theme().panel)
        self.plot.apply_theme()

    def _build_map(self) -> None:
        self.map = PeriodMap()
        self.map.pointed = False
        self.map.setToolTip(
            "Number of frames that show each position. Grey: none within the tolerance. Click "
            "a position to read its number"
        )
        self.map.setAccessibleName("Number of frames at each position")
        self.map.chosen.connect(self._read)
        self.read = WrappedLabel("", role="hint")

    def _results(self) -> QWidget:
        self.plane = QComboBox()
        self.plane.setToolTip("Depth plane whose images and covered phases are shown. Each plane has separate frames")
        self.plane.setAccessibleName("Plane")
        self.plane.currentIndexChanged.connect(lambda _: self._draw())
        images, left = card("Images on the sensor")
        self.legend = WrappedLabel("", role="hint")
        left.addLayout(line("Plane", self.plane))
        left.addWidget(self.graphics, 1)
        left.addWidget(self.legend)
        phases, right = card("Phases covered")
        phases.setFixedWidth(MAP_PX)
        right.addWidget(self.map, 1)
        right.addWidget(self.read)
        planes, below = card("Planes")
        planes.setFixedHeight(TABLE_PX)
        below.addWidget(self.table)
        pictures = line(images, phases, stretch=0)
        pictures.setSpacing(10)
        holder = QWidget()
        column_of(pictures, planes, of=holder, spacing=10, stretch=0)
        return holder

    # -- showing ---------------------------------------------------------------------------------------
    def _show(self) -> None:
        """Show the settings, and whether the plan is being made."""
        asked, busy = PlanSettings.of(self.context.state), bool(self._job)
        self.form.set_values(asked.shown())
        for key in self.form.fields:
            self.form.set_enabled(key, key == "source" or asked.many)
        self.plan_button.setEnabled(asked.many and not busy)
        self.stop_button.setEnabled(busy)
        self.save_button.setEnabled(self.found is not None)
        if self.found is None:
            self.message.setText(
                "Searching for the fewest frames …" if busy else READY_WORDS if asked.many else POINT_WORDS
            )

    def show_planned(self, found: PlannedTarget | None) -> None:
        """Show a plan. None: there is none."""
        self.found = found
        self.stack.setCurrentIndex(int(found is not None))
        self.costs.setText("" if found is None else _costs(found))
        self.note.setText("" if found is None else _note(found))
        self.note.setToolTip("" if found is None else found.coding)
        if found is None:
            return
        self.table.show_rows(*model_target.table_rows(found))
        with QSignalBlocker(self.plane):
            self.plane.clear()
            self.plane.addItems([minus(format_length(depth)) for depth in found.plan.scan.depths_um])
            self.plane.setCurrentIndex(len(found.planes) // 2)
        self._draw()

    @property
    def shown(self) -> PlaneDrawing | None:
        """Drawing of the selected plane; None if there is no plan of the target."""
        return None if self.found is None else self.found.planes[max(0, self.plane.currentIndex())]

    def _draw(self) -> None:
        plane, found = self.shown, self.found
        if plane is None or found is None:
            return
        scan, drawn = found.plan.scan, plane.drawn()
        rows, columns = scan.camera.sensor.shape
        self.sensor.setData(*_rectangle(-0.5, -0.5, rows, columns))
        first = drawn[drawn[:, 0] == 0]
        height, width = scan.cutout
        squares = [np.array(_rectangle(r - height / 2, c - width / 2, height, width, gap=True)) for _, r, c in first]
        self.cutouts.setData(*(np.concatenate(squares, axis=1) if squares else np.zeros((2, 0))))
        self._paint(drawn, len(found.plan.offsets_px[self.plane.currentIndex()]))
        self.plot.vb.setRange(xRange=(-0.5, columns - 0.5), yRange=(-0.5, rows - 0.5), padding=0.02)
        self.map.set_values(plane.shown, plane.shown)
        self.read.setText(_covered(plane))

    def _paint(self, drawn: Any, frames: int) -> None:
        seen = int(drawn[-1, 0]) + 1 if len(drawn) else 0
        table, theme = theme_table("viridis"), current_theme()
        share = drawn[:, 0] / max(1, frames - 1)
        brushes = [pg.mkBrush(*table[k]) for k in (FIRST + (LAST - FIRST) * share).astype(int)]
        self.points.setData(drawn[:, 2], drawn[:, 1], brush=brushes)
        self.sensor.setPen(pg.mkPen(theme.muted, style=Qt.PenStyle.DashLine))
        self.cutouts.setPen(pg.mkPen(theme.muted))
        part = "" if seen == frames else f"; {seen} of {frames} are drawn"
        self.legend.setText(
            f"Dashed: the sensor. Squares: cutouts of frame 1. Dark to bright: frame 1 to {frames}{part}."
        )

    def _read(self, y: int, x: int) -> None:
        plane = self.shown
        if plane is not None:
            count = int(plane.shown[y, x])
            self.read.setText(f"Position y = {y}, x = {x}: shown by {count} frame{'s' * (count != 1)}.")

    def _entries(self) -> list[tuple[str, Any]]:
        plane = self.shown
        return (
            []
            if plane is None
            else table_entries(self, "target", lambda between: model_target.point_lines(plane, between))
        )

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        self.graphics.setBackground(current_theme().panel)
        self.plot.apply_theme()
        self.map.apply_theme()
        self._draw()

    # -- planning --------------------------------------------------------------------------------------
    def show_state(self, state: ProjectState) -> None:
        """Show the settings, and discard a plan that was made for other values."""
        if self._asked != (state.plan, PlanSettings.of(state)):
            self.forget()
        self._show()

    def forget(self) -> None:
        """Discard the plan, and stop planning."""
        job, self._job, self._asked = self._job, 0, None
        self.context.jobs.cancel(job)
        self.show_planned(None)

    def plan_target(self) -> None:
        """Plan the frames as a job."""
        plan, settings = self.context.state.plan, PlanSettings.of(self.context.state)
        if plan is None or not settings.many:
            self.message.setText("there is no target to plan; make a plan of the scan, and type a source such as array")
            return
        self.forget()
        # else the previous value would be used for the plan
        if refused := self.form.error:
            self.message.setText(refused)
            return
        self._asked = asked = (plan, settings)

        def done(found: PlannedTarget) -> None:
            if self._asked is asked:
                self.show_planned(found)

        self._job = self.context.jobs.start(
            f"Plan {settings.source}",
            "setup",
            lambda: model_target.iter_target(plan, settings),
            done,
            leave=True,
            at_once=True,
        )
        self._show()

    def _job_finished(self, job: WindowJob) -> None:
        if job.number != self._job:
            return
        self._job = 0
        self._show()
        if job.error:
            self.message.setText(job.error)

    def expect(self, scan: ScanPlan, settings: PlanSettings) -> None:
        """Treat the plan that is shown next as the plan of these values."""
        self.forget()
        self._asked = (scan, settings)

    def show_opened(self, found: PlannedTarget) -> None:
        """Show a plan from a file."""
        self.show_planned(found)
        self._show()
        self.show()

    def save_target(self, path: str = "") -> None:
        """Save the plan of the target as JSON."""
        found, state = self.found, self.context.state
        if found is None:
            self.message.setText("there is no target plan to save; press Plan target first")
            return
        path = path or ask_target(self, "Save target plan", "target_plan.json", "Plans (*.json)")
        text = found.plan.to_json()
        if path and write_file(self, path, lambda part: part.write_text(text, encoding="utf-8")):
            title = f"Save target plan {Path(path).name}"
            self.context.history.add(self.context.taken("setup", title, step=lambda: target_step(state, path)))
            self.context.message.emit(f"target plan saved as {path}; record it in Record > Rig, with Target …")
