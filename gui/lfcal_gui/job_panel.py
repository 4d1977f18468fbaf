"""The status area: what is at work, the queue, and how jobs ended."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtCore import QSize
from PySide6.QtWidgets import (
    QFileDialog,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QScrollArea,
    QSizePolicy,
    QVBoxLayout,
    QWidget,
)

from lfcal_gui._job_row import JobRow
from lfcal_gui._run_panel import RunView
from lfcal_gui.jobs import Jobs, WindowJob

KEPT = 20
"""Jobs that have ended and are still listed."""

ROWS = 2
"""Jobs that are seen whole in the lowest window; the others scroll."""


class JobPanel(QWidget):
    """All jobs: those at work, those that wait in their order, those that have ended, newest first."""

    def __init__(self, jobs: Jobs, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._jobs = jobs
        self._rows: dict[int, JobRow] = {}
        self._shown: list[int] = []
        outer = QHBoxLayout(self)
        outer.setContentsMargins(0, 0, 8, 0)
        outer.setSpacing(2)
        self.area = QScrollArea()
        self.area.setWidgetResizable(True)
        inner = QWidget()
        self._runs = QVBoxLayout()
        self._column = QVBoxLayout()
        whole = QVBoxLayout(inner)
        whole.setContentsMargins(8, 4, 6, 4)
        for column in (whole, self._runs, self._column):
            column.setSpacing(4)
        self._empty = QLabel("No jobs yet. Assembly, export, simulation and reports run here.")
        self._empty.setProperty("role", "hint")
        whole.addLayout(self._runs)
        whole.addLayout(self._column)
        whole.addWidget(self._empty)
        whole.addStretch()
        self.area.setWidget(inner)
        for part in (inner, self.area.viewport()):
            part.setAutoFillBackground(False)
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
        jobs.queued.connect(self._show_queue)

    def minimumSizeHint(self) -> QSize:
        """Return room for `ROWS` jobs."""
        height = self.fontMetrics().height() + 28
        return QSize(super().minimumSizeHint().width(), ROWS * height)

    def watch(self, run: Path) -> RunView:
        """Show the units of a run (``H.h5.parts``, or what it makes) until they are dismissed."""
        view = RunView(self._jobs, run)
        self._runs.insertWidget(0, view)
        return view

    def _ask(self) -> None:
        found = QFileDialog.getExistingDirectory(self, "Folder of a run's parts (H.h5.parts)")
        if found:
            self.watch(Path(found))

    def row(self, number: int) -> JobRow:
        """Return the row of a job."""
        return self._rows[number]

    def listed(self) -> list[int]:
        """Return the numbers of the jobs, from the top."""
        return list(self._shown)

    def _show(self, job: WindowJob) -> None:
        row = self._rows.get(job.number)
        if row is None:
            row = JobRow(self._jobs, job)
            row.gone.connect(self._take_out)
            self._rows[job.number] = row
            self._trim()
        before = row.job.active
        row.show_job(job)
        if job.number not in self._shown or before != job.active:
            self._arrange()
        self._empty.setVisible(not self._rows)

    def _show_queue(self) -> None:
        """Show the order in which jobs wait."""
        self._arrange()
        for number in self._jobs.waiting():
            self._rows[number].show_job(self._rows[number].job)

    def _arrange(self) -> None:
        """Put the rows in their order."""
        waiting = self._jobs.waiting()

        def place(row: JobRow) -> tuple[int, int]:
            number = row.job.number
            if number in waiting:
                return 1, waiting.index(number)
            return (0 if row.job.active else 2), -number

        rows = sorted(self._rows.values(), key=place)
        order = [row.job.number for row in rows]
        if order == self._shown:
            return
        self._shown = order
        for at, row in enumerate(rows):
            if self._column.indexOf(row) != at:
                self._column.insertWidget(at, row)

    def _trim(self) -> None:
        """Take out the oldest that have ended and left nothing."""
        over = sorted(number for number, row in self._rows.items() if not row.job.active and not row.job.kept)
        for number in over[: max(0, len(self._rows) - KEPT)]:
            self._take_out(number)

    def _take_out(self, number: int) -> None:
        self._rows.pop(number).leave()
        if number in self._shown:
            self._shown.remove(number)
