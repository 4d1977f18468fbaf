"""Curves of error against cost of a reconstruction, measured with this H; a click on a point uses its settings."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property
from typing import Any

from PySide6.QtCore import QObject

from lfcal.accuracy import CostPoint, Curve
from lfcal_gui.context import Context
from lfcal_gui.jobs import JobState, WindowJob
from lfcal_gui.models import axis_labels, iter_measure, points_of, subject_of
from lfcal_gui.pages.reconstruct.model import ReconstructSettings
from lfcal_gui.pages.reconstruct.panel import ReconstructPanel
from lfcal_gui.widgets import CostCurve

SECONDS = 10.0
"""Approximate duration of the measurement of a curve (s)."""

USES = {"solvers": ("solver", "iterations"), "projection": ("method", "double", "threshold")}
"""Settings that a point of each part sets."""


class Costing(QObject):
    """Show the curves of solvers and projectors, measure them as a job, and apply a chosen point.

    Parameters
    ----------
    context, panel, parent
        Context, panel and parent widget of the page.
    use
        Function that changes settings; called with the label of the change and the values by name.
    """

    def __init__(
        self, context: Context, panel: ReconstructPanel, use: Callable[[str, dict[str, Any]], None], parent: QObject
    ) -> None:
        super().__init__(parent)
        self._context, self._panel, self._use = context, panel, use
        self._job, self._error = 0, 0.01
        self._shown: Curve | None = None
        panel.part.currentIndexChanged.connect(lambda _: self.show())
        panel.more.head.toggled.connect(lambda _: self.show())
        context.jobs.changed.connect(self._job_changed)
        context.jobs.finished.connect(self._job_finished)

    @property
    def part(self) -> str:
        """The displayed part."""
        found: str = self._panel.part.currentData()
        return found

    @cached_property
    def _chart(self) -> CostCurve:
        """Chart of the panel, which is created when it is first shown."""
        chart = self._panel.curve
        chart.chosen.connect(self.take)
        chart.moved.connect(self._move)
        chart.measure_asked.connect(self.measure)
        return chart

    def show(self) -> None:
        """Show the measured part of the curve of this H."""
        if not self._panel.more.head.isChecked():
            return
        curves, key = self._context.curves, subject_of(self._context.state, "psf")
        self._shown = curve = curves.of(key).get(self.part)
        if curve is not None:
            self._chart.set_labels(*axis_labels(curve))
        points = () if curve is None else points_of(curve, self._picked(curve))
        self._chart.show_points(points, math.log10(100 * self._error), "error")
        took = curves.took(key, self.part)
        self._chart.show_status(took, "" if self._job else "Measure again" if took else "Measure")

    def _picked(self, curve: Curve) -> CostPoint | None:
        """Return the point in use; None if it was not measured."""
        settings = ReconstructSettings.of(self._context.state)
        wanted = {name: getattr(settings, name) for name in USES[self.part]}
        return next(
            (point for point in curve.points if {name: point.settings.get(name) for name in wanted} == wanted), None
        )

    def _move(self, error: float) -> None:
        self._error = error
        self.show()

    def measure(self) -> None:
        """Measure the displayed part as a job."""
        state, kept, part = self._context.state, self._context.curves, self.part
        if self._job or not state.psf:
            return
        kept.forget(subject_of(state, "psf"), (part,))
        self._job = self._context.jobs.start(
            f"What accuracy costs: {self._panel.part.currentText().lower()}",
            "reconstruct",
            lambda: iter_measure(state, "psf", SECONDS, (part,), kept),
            abandon=True,
            needs=(state.psf,),
        )
        self.show()

    def take(self, number: int) -> None:
        """Use the settings of a point."""
        curve = self._shown
        if curve is not None and 0 <= number < len(curve.points):
            settings = curve.points[number].settings
            self._use(curve.points[number].label, {name: settings[name] for name in USES[curve.part]})
            self.show()

    def _job_changed(self, job: WindowJob) -> None:
        if job.number == self._job and job.state is JobState.RUNNING:
            self.show()

    def _job_finished(self, job: WindowJob) -> None:
        if job.number == self._job:
            self._job = 0
            self.show()
