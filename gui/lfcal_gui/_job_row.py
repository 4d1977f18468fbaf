"""One job in the status area: how far it is, what can be done with it, and errors in words."""

from __future__ import annotations

from collections.abc import Callable

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QProgressBar, QPushButton

from lfcal.base import format_seconds
from lfcal_gui._job_log import JobLogView
from lfcal_gui.jobs import Jobs, JobState, WindowJob
from lfcal_gui.widgets import HeadedCard, WrappedLabel

__all__ = ["JobRow"]

GO_ON = "Go on from what is kept of it. Once the window is closed: begin the same work under the same name again"

BAR = 150
"""Width of the bar of a job's progress (px)."""


class JobRow(HeadedCard):
    """A job that waits, runs, or has ended."""

    gone = Signal(int)
    """The user wants to see it no longer; its number."""

    def __init__(self, jobs: Jobs, job: WindowJob) -> None:
        super().__init__(job.title)
        self._jobs, self._job = jobs, job
        self._view: JobLogView | None = None
        self.bar = QProgressBar()
        self.bar.setTextVisible(False)
        self.bar.setFixedWidth(BAR)
        self.bar.setAccessibleName(f"progress of {job.title}")
        self.head.insertWidget(1, self.bar)
        number = job.number
        self.up = self._button("Up", "Do this before the job that waits above it", lambda: jobs.move(number, -1))
        self.down = self._button("Down", "Do this after the job that waits below it", lambda: jobs.move(number, 1))
        self.go_on = self._button("Go on", GO_ON, lambda: jobs.go_on(number))
        self.log = self._button("Log", "What it did and when, what it warned of; to copy and to save", self.show_log)
        self.button = self._button("Stop", "", self._pressed)
        self.error = WrappedLabel()
        self.error.setProperty("role", "error")
        self.error.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.error.hide()
        self.column.addWidget(self.error)

    def _button(self, text: str, tip: str, action: Callable[[], object]) -> QPushButton:
        button = self.add_button(text, tip, action)
        button.setAccessibleName(f"{text}: {self._job.title}")
        return button

    @property
    def job(self) -> WindowJob:
        """The job as it was shown last."""
        return self._job

    def show_job(self, job: WindowJob) -> None:
        """Show the job as it is now."""
        self._job = job if job.active else job.remembered()
        record, place = job.progress, self._place()
        self.bar.setVisible(job.active and not place)
        self.bar.setRange(0, 1000 if record is not None and record.total else 0)
        if record is not None and record.total:
            self.bar.setValue(round(1000 * record.fraction))
        self.status.setText(self._words(place))
        self.up.setVisible(place > 1)
        self.down.setVisible(0 < place < len(self._jobs.waiting()))
        self.go_on.setVisible(bool(job.kept))
        self.go_on.setEnabled(True)
        self._show_button()
        self.error.setText(job.error)
        self.error.setVisible(bool(job.error))

    def _place(self) -> int:
        """Return the job's place among those that wait, from 1; 0 where it does not."""
        waiting = self._jobs.waiting()
        return waiting.index(self._job.number) + 1 if self._job.number in waiting else 0

    def _words(self, place: int) -> str:
        job, record = self._job, self._job.progress
        if place:
            return "waits: next" if place == 1 else f"waits: number {place} in the queue"
        if job.active and job.stopping:
            return "stopping …"
        if job.state is JobState.RUNNING and record is not None:
            eta = record.eta_seconds
            left = f", about {format_seconds(eta)} to go" if eta is not None and record.done < record.total else ""
            # of work in units the stage is that of one of them, the count that of all
            count = f", {record.count} done" if record.per > 1 else f" {record.count}".rstrip()
            return record.stage + count + left
        if job.state in (JobState.DONE, JobState.CANCELLED):
            return job.ended_words() + self._warned()
        return job.state.value + (f"; {job.kept} are kept" if job.kept else "")

    def _warned(self) -> str:
        count = self._jobs.log(self._job.number).warned
        return "" if not count else f", {count} warning{'s' if count > 1 else ''}: see its log"

    def _show_button(self) -> None:
        """Name the last button by what it does now."""
        job = self._job
        text, tip = "Dismiss", "Take it out of this list"
        if job.active:
            text, tip = "Stop", "Stop this job; it cleans up behind itself"
        elif job.kept:
            text, tip = "Discard", f"Free what is kept of it, {job.kept}"
        self.button.setText(text)
        self.button.setToolTip(tip)
        self.button.setAccessibleName(f"{text}: {job.title}")
        self.button.setEnabled(not (job.active and job.stopping))

    def show_log(self) -> JobLogView:
        """Show its log beside the window."""
        if self._view is None:
            self._view = JobLogView(self._jobs.log(self._job.number), self.window())
        self._view.show()
        self._view.raise_()
        return self._view

    def _pressed(self) -> None:
        self.button.setEnabled(False)
        if self._job.active:
            self._jobs.cancel(self._job.number)
        elif self._job.kept:
            self.go_on.setEnabled(False)
            self._jobs.discard(self._job.number)
        else:
            self.gone.emit(self._job.number)
