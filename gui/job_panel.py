"""The status area: every job with its progress, time to go, stop button, and errors in words."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtCore import Qt
from PySide6.QtWidgets import (
    QApplication,
    QFileDialog,
    QFrame,
    QHBoxLayout,
    QLabel,
    QProgressBar,
    QPushButton,
    QScrollArea,
    QSizePolicy,
    QVBoxLayout,
    QWidget,
)

from gui.jobs import Job, Jobs, JobState
from gui.run_panel import RunView
from lfcal.units import format_seconds

__all__ = ["JobPanel"]

KEPT = 20


class _Row(QFrame):
    def __init__(self, jobs: Jobs, job: Job) -> None:
        super().__init__()
        self._jobs, self._number = jobs, job.number
        self._details = ""
        self.setProperty("role", "card")
        outer = QVBoxLayout(self)
        outer.setContentsMargins(10, 6, 10, 6)
        outer.setSpacing(4)
        line = QHBoxLayout()
        self.title = QLabel(job.title)
        self.title.setProperty("role", "heading")
        self.status = QLabel("")
        self.status.setProperty("role", "hint")
        self.button = QPushButton("Stop")
        self.button.clicked.connect(self._pressed)
        line.addWidget(self.title)
        line.addWidget(self.status, 1)
        line.addWidget(self.button)
        outer.addLayout(line)
        self.bar = QProgressBar()
        self.bar.setTextVisible(False)
        outer.addWidget(self.bar)
        self.error = QLabel("")
        self.error.setProperty("role", "error")
        self.error.setWordWrap(True)
        self.error.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.error.hide()
        outer.addWidget(self.error)

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
        elif job.state is JobState.DONE and record is not None:
            words = f"done in {format_seconds(record.seconds)}"
        if job.active and job.stopping:
            words = "stopping …"
            self.button.setEnabled(False)
        self.status.setText(words)
        if not job.active:
            self.button.setEnabled(True)
            self.bar.hide()
            self.button.setText("Copy details" if job.details else "Dismiss")
        self._details = job.details
        self.error.setText(job.error)
        self.error.setVisible(bool(job.error))

    def _pressed(self) -> None:
        if self.button.text() == "Stop":
            self.button.setEnabled(False)
            self._jobs.cancel(self._number)
            return
        if self._details:
            QApplication.clipboard().setText(f"{self.error.text()}\n\n{self._details}")
            self.button.setText("Dismiss")
            self._details = ""
            return
        self.setParent(None)
        self.deleteLater()


class JobPanel(QWidget):
    """All jobs, newest first."""

    def __init__(self, jobs: Jobs, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._jobs = jobs
        self._rows: dict[int, _Row] = {}
        outer = QVBoxLayout(self)
        outer.setContentsMargins(0, 0, 0, 0)
        area = QScrollArea()
        area.setWidgetResizable(True)
        inner = QWidget()
        self._column = QVBoxLayout(inner)
        self._column.setContentsMargins(8, 6, 8, 6)
        self._column.setSpacing(6)
        self._empty = QLabel("No jobs yet. Assembly, export, simulation and reports run here.")
        self._empty.setProperty("role", "hint")
        self._column.addWidget(self._empty)
        self._column.addStretch()
        area.setWidget(inner)
        area.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        outer.addWidget(area)
        watch = QPushButton("Watch a run …")
        watch.setToolTip("A run of lfcal in units, of this machine or a cluster: name the folder of its parts")
        watch.clicked.connect(self._ask)
        outer.addWidget(watch, 0, Qt.AlignmentFlag.AlignRight)
        jobs.changed.connect(self._show)

    def watch(self, run: Path) -> RunView:
        """Show the units of a run (``H.h5.parts``, or what it makes) until they are dismissed."""
        view = RunView(self._jobs, run)
        self._column.insertWidget(0, view)
        return view

    def _ask(self) -> None:
        found = QFileDialog.getExistingDirectory(self, "Folder of a run's parts (H.h5.parts)")
        if found:
            self.watch(Path(found))

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
            row = self._rows.pop(number)
            row.setParent(None)
            row.deleteLater()
