"""Quality: is the PSF good, what is wrong if not, and what to record again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PySide6.QtWidgets import QFileDialog

from gui.base_page import BasePage
from gui.context import Context
from gui.jobs import Job, JobState
from gui.models.page import PageSpec
from gui.models.project import ProjectState
from gui.pages.quality.model import (
    Measured,
    iter_measure,
    iter_write_report,
    map_of,
    planes_of,
    report_files,
    rows_of,
    title_of,
    words_of,
    worst_positions,
)
from gui.pages.quality.panel import QualityPanel
from gui.saving import may_replace

if TYPE_CHECKING:
    from lfcal.psf.quality import Metric, QualityReport

__all__ = ["Page"]


class Page(BasePage):
    """Measures H once when the page is looked at, and whenever it is asked to."""

    def __init__(self, spec: PageSpec, context: Context) -> None:
        super().__init__(spec, context)
        self.report: QualityReport | None = None
        self._measured = ""
        self._running = ""
        self._row = self._z = self._job = 0
        self._depths: NDArray[np.float64] = np.zeros(0)
        self.tool_button("Measure again", "Measure H again", lambda: self.measure(force=True))
        self.redo_button = self.tool_button(
            "Send to Acquire", "Give the list of positions to record again to Acquire", self.send
        )
        self.report_button = self.tool_button(
            "Write report …",
            "An HTML page with all figures",
            self.write_report,
            primary=True,
        )
        self.panel = QualityPanel()
        self.panel.metric_chosen.connect(self._metric_chosen)
        self.panel.plane_chosen.connect(self._plane_chosen)
        self.panel.plane_asked.connect(lambda: self.context.go.emit("psf", (self._z, 0, 0)))
        self.panel.position_clicked.connect(self._position_clicked)
        self.set_panel(self.panel)
        context.theme_changed.connect(self._apply_theme)
        context.jobs.finished.connect(self._job_finished)
        self._follow()

    # -- project ---------------------------------------------------------------------------------------
    def state_changed(self, old: ProjectState, new: ProjectState) -> None:
        """Forget the report of another H."""
        if old.psf != new.psf:
            self._follow()

    def entered(self) -> None:
        """Measure when the page is first looked at."""
        self.measure()

    def _follow(self) -> None:
        psf = self.context.state.psf
        self.redo_button.setEnabled(False)
        self.report_button.setEnabled(bool(psf))
        if not psf or not Path(psf).exists():
            self.report = None
            self.show_empty(
                "No PSF to judge yet.\nAssemble frames, or open an H file on the PSF page.",
                {
                    "Frames": lambda: self.context.go.emit("frames", None),
                    "PSF": lambda: self.context.go.emit("psf", None),
                },
            )
        elif psf != self._measured:
            self.report = None
            self.show_empty("H has not been measured yet.", {"Measure": self.measure})
            if self.isVisible():
                self.measure()

    def measure(self, *, force: bool = False) -> None:
        """Inspect H as a job, once per H; the job opens it for itself, as other pages read other planes."""
        psf = self.context.state.psf
        if not psf or not Path(psf).exists() or self._running == psf or (psf == self._measured and not force):
            return
        self._running = psf
        self.show_empty("measuring …")

        def done(measured: Measured) -> None:
            if psf == self.context.state.psf:
                self._measured, self._depths = psf, measured.depths
                self._show(measured.report)

        title = f"Inspect {Path(psf).name}"
        self._job = self.context.jobs.start(title, "quality", lambda: iter_measure(psf), done, abandon=True)

    def _job_finished(self, job: Job) -> None:
        if job.number != self._job:
            return
        same, self._job, self._running = self._running == self.context.state.psf, 0, ""
        if same and job.state in (JobState.FAILED, JobState.CANCELLED):
            self.show_empty(job.error or "Stopped.", {"Try again": lambda: self.measure(force=True)})

    # -- showing ---------------------------------------------------------------------------------------
    def _show(self, report: QualityReport) -> None:
        self.report = report
        self.show_body()
        redo = worst_positions(report)
        self.redo_button.setEnabled(bool(redo))
        self.redo_button.setText(f"Send {len(redo)} to Acquire" if redo else "Send to Acquire")
        self.context.attention.emit("quality", report.merit == "bad")
        self.panel.show_rows(report.verdict, rows_of(report), planes_of(report))

    def chosen(self) -> Metric | None:
        """Return the metric looked at."""
        if self.report is None or not 0 <= self._row < len(self.report.metrics):
            return None
        return self.report.metrics[self._row]

    def _metric_chosen(self, row: int) -> None:
        self._row = row
        metric = self.chosen()
        if metric is None:
            return
        title = title_of(metric)
        self.panel.show_metric(title, words_of(metric))
        self._show_map()
        if metric.per_plane.size > 1 and metric.per_plane.size == len(self._depths):
            self.panel.show_curve(title, self._depths, metric.per_plane)

    def _plane_chosen(self, z: int) -> None:
        self._z = z
        self._show_map()

    def _show_map(self) -> None:
        metric = self.chosen()
        if metric is not None:
            self.panel.show_map(self._z, map_of(metric, self._z), metric.key)

    def _position_clicked(self, y: int, x: int) -> None:
        self.context.go.emit("frames" if self.context.state.frames else "psf", (self._z, y, x))

    # -- doing -----------------------------------------------------------------------------------------
    def send(self) -> None:
        """Hand the positions to be recorded again to Acquire."""
        if self.report is not None:
            redo = worst_positions(self.report)
            self.context.project.update("positions to record again", redo=redo)
            self.context.message.emit(f"{len(redo)} positions to be recorded again")
            self.context.go.emit("acquire", None)

    def write_report(self, folder: str = "") -> None:
        """Write the report as a job."""
        psf, asked = self.context.state.psf, not folder
        folder = folder or QFileDialog.getExistingDirectory(self, "Folder for the report")
        if not folder or not psf or (asked and not may_replace(self, report_files(folder))):
            return
        measured = self.report if psf == self._measured else None
        self.context.jobs.start(
            "Report",
            "quality",
            lambda: iter_write_report(psf, folder, measured),
            lambda page: self.context.message.emit(f"report written: {page}"),
            lambda job: self.notice.refuse(job.error),
            abandon=True,
        )

    def _apply_theme(self) -> None:
        self.panel.apply_theme()
        if self.report is not None:
            self._show(self.report)
