"""Jobs in the status bar, and the list of all jobs, which opens over the page and moves nothing."""

from __future__ import annotations

from typing import Any

from PySide6.QtCore import QEvent, QObject, QPoint, Qt
from PySide6.QtGui import QKeyEvent
from PySide6.QtWidgets import QFrame, QHBoxLayout, QMainWindow, QProgressBar, QToolButton, QVBoxLayout, QWidget

from lfcal.base import format_seconds
from lfcal_gui.job_panel import JobPanel
from lfcal_gui.jobs import Jobs, JobState, WindowJob
from lfcal_gui.widgets import set_role

BAR, HEIGHT = 90, 17
"""Width of the bar, and height of the text: the status bar is as low as without it (px)."""

SHEET = (900, 300)
"""Greatest size of the sheet (px)."""

NAMED = 2
"""Jobs that the line names."""


def jobs_words(active: list[WindowJob], failed: list[WindowJob]) -> str:
    """Return the text of the status bar: a failed job, or the running jobs and the time left."""
    if failed:
        others = f", {len(failed) - 1} more" if len(failed) > 1 else ""
        return f"Failed: {failed[-1].title}{others}"
    if not active:
        return "No jobs running"
    names = ", ".join(job.title for job in active[:NAMED]) + (", …" if len(active) > NAMED else "")
    first = active[0].progress
    eta = None if first is None else first.eta_seconds
    left = "" if eta is None or first is None or first.done >= first.total else f", {format_seconds(eta)} left"
    return f"{names}{left}" if len(active) == 1 else f"{len(active)} jobs: {names}{left}"


class JobsLine(QWidget):
    """Progress bar and text; a click opens the list. A failed job stays in red until the list was opened."""

    def __init__(self, jobs: Jobs, window: QMainWindow) -> None:
        super().__init__(window)
        self._jobs = jobs
        self._failed: list[WindowJob] = []
        self.sheet = JobsSheet(JobPanel(jobs), window)
        self.bar = QProgressBar()
        self.bar.setTextVisible(False)
        self.bar.setFixedWidth(BAR)
        self.bar.setAccessibleName("progress of the running job")
        self.button = QToolButton()
        self.button.setAutoRaise(True)
        self.button.setFixedHeight(HEIGHT)
        self.button.setToolTip("All jobs: progress and log of each, and buttons to stop or continue it (Ctrl+J)")
        self.button.clicked.connect(lambda _=False: self.toggle())
        row = QHBoxLayout(self)
        row.setContentsMargins(6, 0, 6, 0)
        row.setSpacing(6)
        row.addWidget(self.button)
        row.addWidget(self.bar)
        jobs.changed.connect(self._changed)
        jobs.queued.connect(self.refresh)
        self.refresh()

    def toggle(self) -> None:
        """Open or close the list; failed jobs count as read."""
        self._failed.clear()
        self.sheet.setVisible(self.sheet.isHidden())
        self.refresh()

    def refresh(self) -> None:
        """Show which jobs run now."""
        active = [job for job in self._jobs.jobs() if job.active]
        active.sort(key=lambda job: job.state is JobState.WAITING)
        words = jobs_words(active, self._failed)
        self.button.setText(words)
        self.button.setAccessibleName(f"jobs: {words}")
        set_role(self.button, "error" if self._failed else "")
        record = active[0].progress if active else None
        known = record is not None and record.total > 0
        self.bar.setVisible(bool(active))
        self.bar.setRange(0, 1000 if known else 0)
        if record is not None and known:
            self.bar.setValue(round(1000 * record.fraction))

    def _changed(self, job: WindowJob) -> None:
        if (
            job.state is JobState.FAILED
            and self.sheet.isHidden()
            and all(job.number != one.number for one in self._failed)
        ):
            self._failed.append(job)
        self.refresh()


class JobsSheet(QFrame):
    """The list over the lower right of the page; Esc closes it."""

    def __init__(self, panel: JobPanel, window: QMainWindow) -> None:
        super().__init__(window)
        self.panel, self._window = panel, window
        self.setProperty("role", "card")
        self.setProperty("overlay", True)
        self.setAutoFillBackground(True)
        column = QVBoxLayout(self)
        column.setContentsMargins(4, 4, 4, 4)
        column.addWidget(panel)
        window.installEventFilter(self)
        self.hide()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Stay above the status bar."""
        if event.type() == QEvent.Type.Resize and self.isVisible():
            self._place()
        return False

    def showEvent(self, event: Any) -> None:
        """Take its place and the keyboard."""
        self._place()
        self.raise_()
        self.setFocus(Qt.FocusReason.OtherFocusReason)
        super().showEvent(event)

    def _place(self) -> None:
        above = self._window.statusBar().mapTo(self._window, QPoint(0, 0))
        width = min(SHEET[0], self._window.width() - 16)
        height = min(max(SHEET[1], self.panel.minimumSizeHint().height()), above.y() - 8)
        self.setGeometry(self._window.width() - width - 8, above.y() - height - 4, width, height)

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Close it at Esc."""
        if event.key() == Qt.Key.Key_Escape:
            self.hide()
        else:
            super().keyPressEvent(event)
