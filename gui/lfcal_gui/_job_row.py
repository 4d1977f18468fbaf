"""One job in the status area: how far it is, what can be done with it, errors in words, and its log."""

from __future__ import annotations

import re
from collections.abc import Callable

from PySide6.QtCore import Qt, QTimer, Signal
from PySide6.QtGui import QFontDatabase, QHideEvent, QShowEvent
from PySide6.QtWidgets import QApplication, QDialog, QPlainTextEdit, QProgressBar, QPushButton, QVBoxLayout, QWidget

from lfcal.base import format_seconds
from lfcal_gui.jobs import Jobs, JobState, WindowJob
from lfcal_gui.models import JobLog
from lfcal_gui.saving import ask_target, write_file
from lfcal_gui.theme import style_sheet
from lfcal_gui.widgets import HeadedCard, WrappedLabel, line, lines_px

EVERY_MS = 500
"""Between two looks at a log that may grow (ms)."""

SIZE = (820, 460)


class JobLogView(QDialog):
    """Show a `JobLog`, and update it until the window is closed."""

    def __init__(self, log: JobLog, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._log, self._shown = log, ""
        self.setWindowTitle(f"Log of {log.title}")
        self.resize(*SIZE)
        self.view = QPlainTextEdit()
        self.view.setReadOnly(True)
        self.view.setLineWrapMode(QPlainTextEdit.LineWrapMode.NoWrap)
        self.view.setAccessibleName(f"log of {log.title}")
        self.view.setToolTip("Steps and warnings of the job with their times, updated while it runs")
        self.view.setFont(QFontDatabase.systemFont(QFontDatabase.SystemFont.FixedFont))
        self.copy, self.keep, close = QPushButton("Copy text"), QPushButton("Save …"), QPushButton("Close")
        self.copy.setToolTip("Copy the log, for example for a bug report")
        self.keep.setToolTip("Save the log as a text file. It is lost when lfcal is closed")
        close.setToolTip("Close this window. The job continues, and its log is kept")
        self.copy.clicked.connect(lambda: QApplication.clipboard().setText(self._log.text()))
        self.keep.clicked.connect(lambda: self.save())
        close.clicked.connect(self.close)
        column = QVBoxLayout(self)
        column.addWidget(self.view, 1)
        column.addLayout(line(QWidget(), self.copy, self.keep, close, stretch=0))
        self._timer = QTimer(self)
        self._timer.setInterval(EVERY_MS)
        self._timer.timeout.connect(self.refresh)

    def showEvent(self, event: QShowEvent) -> None:
        """Follow the job while the log is seen."""
        self.setStyleSheet(style_sheet())
        first = not self._shown
        self.refresh()
        if first:  # keep the width that the user chose
            margins = self.layout().contentsMargins()
            self.resize(max(self.width(), lines_px(self.view) + margins.left() + margins.right()), self.height())
        self._timer.start()
        super().showEvent(event)

    def hideEvent(self, event: QHideEvent) -> None:
        """Look no more."""
        self._timer.stop()
        super().hideEvent(event)

    def refresh(self) -> None:
        """Show what was said since the last look; the place that is read stays, unless that is the end."""
        text = self._log.text()
        if text == self._shown:
            return
        self._shown = text
        bar = self.view.verticalScrollBar()
        place, at_end = bar.value(), bar.value() >= bar.maximum()
        self.view.setPlainText(text)
        bar.setValue(bar.maximum() if at_end else place)

    def save(self, path: str = "") -> None:
        """Write the log; asks for the file unless it is given."""
        name = re.sub(r"[^\w.-]+", "_", self._log.title).strip("_")
        path = path or ask_target(self, "Save log", f"{name}.txt", "text (*.txt)")
        if path:
            write_file(self, path, lambda part: part.write_text(self._log.text(), encoding="utf-8"))


GO_ON = "Resume from the parts that are done. After the window was closed, start the same work with the same file name"

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
        self.up = self._button("Up", "Run this job before the one above it", lambda: jobs.move(number, -1))
        self.down = self._button("Down", "Run this job after the one below it", lambda: jobs.move(number, 1))
        self.go_on = self._button("Resume", GO_ON, lambda: jobs.go_on(number))
        self.log = self._button("Log", "Show steps and warnings of the job, to copy or save", self.show_log)
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
            # for work in units, the stage is that of one unit, the count that of all units
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
        text, tip = "Dismiss", "Remove this job from the list"
        if job.active:
            text, tip = "Stop", "Stop this job. It may take a moment to clean up"
        elif job.kept:
            text, tip = "Discard", f"Delete what is kept of this job: {job.kept}"
        self.button.setText(text)
        self.button.setToolTip(tip)
        self.button.setAccessibleName(f"{text}: {job.title}")
        self.button.setEnabled(not (job.active and job.stopping))

    def show_log(self) -> JobLogView:
        """Show its log in a separate window."""
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
