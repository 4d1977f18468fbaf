"""The status area: every job with its progress, time to go, stop button, log, and errors in words."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtCore import QSize, Qt
from PySide6.QtWidgets import (
    QFileDialog,
    QHBoxLayout,
    QLabel,
    QProgressBar,
    QPushButton,
    QScrollArea,
    QSizePolicy,
    QVBoxLayout,
    QWidget,
)

from gui.job_log import JobLogView
from gui.jobs import Job, Jobs, JobState
from gui.run_panel import RunView
from gui.widgets.headed_card import HeadedCard
from lfcal.units import format_seconds

__all__ = ["ROWS", "JobPanel"]

KEPT = 20
ROWS = 2
"""Jobs that are seen whole in the dock, however low it is made; the others scroll."""

BAR = 150
"""Width of the bar of a job's progress (px)."""


class _Row(HeadedCard):
    def __init__(self, jobs: Jobs, job: Job) -> None:
        super().__init__(job.title)
        self._jobs, self._number = jobs, job.number
        self._view: JobLogView | None = None
        self.bar = QProgressBar()
        self.bar.setTextVisible(False)
        self.bar.setFixedWidth(BAR)
        self.bar.setAccessibleName(f"progress of {job.title}")
        self.head.insertWidget(1, self.bar)
        self.log = self.add_button("Log", "What it did and when, what it warned of; to copy and to save", self.show_log)
        self.button = self.add_button("Stop", "Stop this job; it cleans up behind itself", self._pressed)
        for button in (self.log, self.button):
            button.setAccessibleName(f"{button.text()}: {job.title}")
        self.error = QLabel("")
        self.error.setProperty("role", "error")
        self.error.setWordWrap(True)
        self.error.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.error.hide()
        self.column.addWidget(self.error)

    def show_job(self, job: Job) -> None:
        """Show the job as it is now."""
        record = job.progress
        self.bar.setRange(0, 1000 if record is not None and record.total else 0)
        if record is not None and record.total:
            self.bar.setValue(round(1000 * record.fraction))
        words = job.state.value
        if job.state is JobState.RUNNING and record is not None:
            eta = record.eta_seconds
            left = f", about {format_seconds(eta)} to go" if eta is not None and record.done < record.total else ""
            count = f" {record.done} of {record.total}" if record.total else ""
            words = f"{record.stage}{count}{left}"
        elif job.state in (JobState.DONE, JobState.CANCELLED):
            words = job.ended_words() + self._warned()
        if job.active and job.stopping:
            words = "stopping …"
            self.button.setEnabled(False)
        self.status.setText(words)
        if not job.active:
            self.button.setEnabled(True)
            self.bar.hide()
            self.button.setText("Dismiss")
            self.button.setToolTip("Take it out of this list")
            self.button.setAccessibleName(f"Dismiss: {job.title}")
        self.error.setText(job.error)
        self.error.setVisible(bool(job.error))

    def _warned(self) -> str:
        count = self._jobs.log(self._number).warned
        return "" if not count else f", {count} warning{'s' if count > 1 else ''}: see its log"

    def show_log(self) -> JobLogView:
        """Show its log beside the window."""
        if self._view is None:
            self._view = JobLogView(self._jobs.log(self._number), self.window())
        self._view.show()
        self._view.raise_()
        return self._view

    def _pressed(self) -> None:
        if self.button.text() == "Stop":
            self.button.setEnabled(False)
            self._jobs.cancel(self._number)
        else:
            self.leave()


class JobPanel(QWidget):
    """All jobs, newest first."""

    def __init__(self, jobs: Jobs, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._jobs = jobs
        self._rows: dict[int, _Row] = {}
        outer = QHBoxLayout(self)
        outer.setContentsMargins(0, 0, 8, 0)
        outer.setSpacing(2)
        self.area = QScrollArea()
        self.area.setWidgetResizable(True)
        inner = QWidget()
        self._column = QVBoxLayout(inner)
        self._column.setContentsMargins(8, 4, 6, 4)
        self._column.setSpacing(4)
        self._empty = QLabel("No jobs yet. Assembly, export, simulation and reports run here.")
        self._empty.setProperty("role", "hint")
        self._column.addWidget(self._empty)
        self._column.addStretch()
        self.area.setWidget(inner)
        self.area.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        outer.addWidget(self.area, 1)
        watch = QPushButton("Watch a run …")
        watch.setToolTip("A run of lfcal in units, of this machine or a cluster: name the folder of its parts")
        watch.clicked.connect(self._ask)
        side = QVBoxLayout()
        side.setContentsMargins(0, 4, 0, 4)
        side.addWidget(watch)
        side.addStretch()
        outer.addLayout(side)
        jobs.changed.connect(self._show)

    def minimumSizeHint(self) -> QSize:
        """Return room for `ROWS` jobs: the lowest that the dock can be made."""
        height = self.fontMetrics().height() + 28
        return QSize(super().minimumSizeHint().width(), ROWS * height)

    def watch(self, run: Path) -> RunView:
        """Show the units of a run (``H.h5.parts``, or what it makes) until they are dismissed."""
        view = RunView(self._jobs, run)
        self._column.insertWidget(0, view)
        return view

    def _ask(self) -> None:
        found = QFileDialog.getExistingDirectory(self, "Folder of a run's parts (H.h5.parts)")
        if found:
            self.watch(Path(found))

    def row(self, number: int) -> _Row:
        """Return the row of a job."""
        return self._rows[number]

    def _show(self, job: Job) -> None:
        row = self._rows.get(job.number)
        if row is None:
            row = _Row(self._jobs, job)
            number = job.number
            row.destroyed.connect(lambda: self._rows.pop(number, None))
            self._rows[job.number] = row
            self._column.insertWidget(0, row)
            self._trim()
        self._empty.setVisible(not self._rows)
        row.show_job(job)

    def _trim(self) -> None:
        for number in sorted(self._rows)[:-KEPT]:
            self._rows.pop(number).leave()
