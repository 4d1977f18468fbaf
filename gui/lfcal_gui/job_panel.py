"""Jobs in the window: a line in the status bar, and the list of all jobs with their logs and runs in units."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from PySide6.QtCore import QEvent, QObject, QPoint, QSize, Qt, QTimer, Signal
from PySide6.QtGui import QFontDatabase, QHideEvent, QKeyEvent, QShowEvent
from PySide6.QtWidgets import (
    QApplication,
    QDialog,
    QFileDialog,
    QFrame,
    QHBoxLayout,
    QLabel,
    QMainWindow,
    QPlainTextEdit,
    QProgressBar,
    QPushButton,
    QScrollArea,
    QSizePolicy,
    QToolButton,
    QVBoxLayout,
    QWidget,
)

from lfcal.work import HEADER, JOURNAL, RunTable, parts_folder, read_run, run_table
from lfcal_gui.jobs import Jobs, JobState, WindowJob
from lfcal_gui.models import JobLog, rough_seconds
from lfcal_gui.saving import ask_target, write_file
from lfcal_gui.theme import style_sheet
from lfcal_gui.widgets import HeadedCard, RowsTable, WrappedLabel, button, line, lines_px, set_role

LOOK_MS = 1000
"""Interval between two readings of the journal of a run (ms)."""

UNITS_PX = 160
"""Height of the table of units (px)."""


def look(run: Path) -> RunTable:
    """Return the progress of the run in a folder, or of the run that makes a file.

    A run that was completed and removed is reported as complete if its file exists.

    Raises
    ------
    InputError
        If there is neither a run nor a file that it made.
    """
    named = run.suffix == ".parts" or not run.name or (run / JOURNAL).exists()
    folder = run if named else parts_folder(run)
    if run.name and not folder.exists() and (made := folder.with_suffix("")).exists():
        return RunTable(f"{made.name}: complete; no run is active", "", (), "")
    return run_table(read_run(folder))


class RunView(HeadedCard):
    """View of one run, updated every second until it is closed."""

    def __init__(self, jobs: Jobs, run: Path, parent: QWidget | None = None) -> None:
        super().__init__(run.name, parent)
        self._jobs, self._run = jobs, run
        self._rows: tuple[tuple[str, ...], ...] = ()
        self._gone = False
        self.add_button("Dismiss", "Remove this run from the list. The run continues", self._dismiss)
        self.place = QLabel("")
        self.place.setOpenExternalLinks(True)
        self.place.setTextInteractionFlags(Qt.TextInteractionFlag.TextBrowserInteraction)
        self.place.hide()
        self.column.addWidget(self.place)
        self.table = RowsTable(HEADER, wide=5)
        self.table.setAccessibleName(f"Units of {run.name}")
        self.table.setFixedHeight(UNITS_PX)
        self.column.addWidget(self.table)
        self._timer = QTimer(self, interval=LOOK_MS)
        self._timer.timeout.connect(self.refresh)
        self._timer.start()
        self.refresh()

    def refresh(self) -> None:
        """Read the journal in the background."""
        self._jobs.compute(f"run {self._run}", lambda: look(self._run), self.show_table, self._lost)

    def show_table(self, found: RunTable) -> None:
        """Show the progress of the run."""
        if self._gone:  # dismissed while its journal was read
            return
        self.title.setText(found.headline)
        self.status.setText(found.pace)
        self.place.setText(f'watch its workers at <a href="{found.place}">{found.place}</a>' if found.place else "")
        self.place.setVisible(bool(found.place))
        if found.rows != self._rows:  # else the sorting that the user chose would be lost every second
            self._rows = found.rows
            self.table.show_rows(found.rows)
        self.table.setVisible(bool(found.rows))

    def _lost(self, words: str) -> None:
        if not self._gone:
            self.status.setText(words)

    def _dismiss(self) -> None:
        self._gone = True
        self._timer.stop()
        self.leave()


LOG_MS = 500
"""Interval between two updates of a log (ms)."""

LOG_SIZE = (820, 460)


class JobLogView(QDialog):
    """Show a `JobLog`, and update it until the window is closed."""

    def __init__(self, log: JobLog, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._log, self._shown = log, ""
        self.setWindowTitle(f"Log of {log.title}")
        self.resize(*LOG_SIZE)
        self.view = QPlainTextEdit(readOnly=True)
        self.view.setLineWrapMode(QPlainTextEdit.LineWrapMode.NoWrap)
        self.view.setAccessibleName(f"Log of {log.title}")
        self.view.setToolTip("Steps and warnings of the job with their times, updated while it runs")
        self.view.setFont(QFontDatabase.systemFont(QFontDatabase.SystemFont.FixedFont))
        self.copy, self.keep, close = QPushButton("Copy text"), QPushButton("Save …"), QPushButton("Close")
        self.copy.setToolTip("Copy the log, for example for a bug report")
        self.keep.setToolTip("Save the log as a text file. Logs that are not saved are lost when lfcal closes")
        close.setToolTip("Close this window. The job continues, and its log is kept")
        self.copy.clicked.connect(lambda: QApplication.clipboard().setText(self._log.text()))
        self.keep.clicked.connect(lambda: self.save())
        close.clicked.connect(self.close)
        column = QVBoxLayout(self)
        column.addWidget(self.view, 1)
        column.addLayout(line(QWidget(), self.copy, self.keep, close, stretch=0))
        self._timer = QTimer(self, interval=LOG_MS)
        self._timer.timeout.connect(self.refresh)

    def showEvent(self, event: QShowEvent) -> None:
        """Update the log while it is visible."""
        self.setStyleSheet(style_sheet())
        first = not self._shown
        self.refresh()
        if first:  # keep the width that the user chose
            margins = self.layout().contentsMargins()
            self.resize(max(self.width(), lines_px(self.view) + margins.left() + margins.right()), self.height())
        self._timer.start()
        super().showEvent(event)

    def hideEvent(self, event: QHideEvent) -> None:
        """Stop updating."""
        self._timer.stop()
        super().hideEvent(event)

    def refresh(self) -> None:
        """Add new lines of the log. The view scrolls only if it shows the end."""
        text = self._log.text()
        if text == self._shown:
            return
        self._shown = text
        bar = self.view.verticalScrollBar()
        place, at_end = bar.value(), bar.value() >= bar.maximum()
        self.view.setPlainText(text)
        bar.setValue(bar.maximum() if at_end else place)

    def save(self, path: str = "") -> None:
        """Write the log to a file; without a path, ask for one."""
        name = re.sub(r"[^\w.-]+", "_", self._log.title).strip("_")
        path = path or ask_target(self, "Save log", f"{name}.txt", "text (*.txt)")
        if path:
            write_file(self, path, lambda part: part.write_text(self._log.text(), encoding="utf-8"))


GO_ON = (
    "Continue after the parts that are complete. If lfcal was closed in the meantime, start "
    "the job again with the same file name"
)

BAR = 150
"""Width of the bar of a job's progress (px)."""


class JobRow(HeadedCard):
    """Row of a job that is queued, running or finished."""

    gone = Signal(int)
    """Number of a job; the user removed its row."""

    def __init__(self, jobs: Jobs, job: WindowJob) -> None:
        super().__init__(job.title)
        self._jobs, self._job = jobs, job
        self._view: JobLogView | None = None
        self.bar = QProgressBar(textVisible=False)
        self.bar.setFixedWidth(BAR)
        self.bar.setAccessibleName(f"Progress of {job.title}")
        self.head.insertWidget(1, self.bar)
        number = job.number
        self.up = self._button("Up", "Run this job before the one above it", lambda: jobs.move(number, -1))
        self.down = self._button("Down", "Run this job after the one below it", lambda: jobs.move(number, 1))
        self.go_on = self._button("Resume", GO_ON, lambda: jobs.go_on(number))
        self.log = self._button("Log", "Show the steps and warnings of the job, to copy or save them", self.show_log)
        self.button = self._button("Stop", "", self._pressed)
        self.error = WrappedLabel(role="error")
        self.error.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.error.hide()
        self.column.addWidget(self.error)

    def _button(self, text: str, tip: str, action: Callable[[], object]) -> QPushButton:
        button = self.add_button(text, tip, action)
        button.setAccessibleName(f"{text}: {self._job.title}")
        return button

    @property
    def job(self) -> WindowJob:
        """The job as last shown."""
        return self._job

    def show_job(self, job: WindowJob) -> None:
        """Show the state of the job."""
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
        """Return the job's position in the queue, from 1; 0 if it is not queued."""
        waiting = self._jobs.waiting()
        return waiting.index(self._job.number) + 1 if self._job.number in waiting else 0

    def _words(self, place: int) -> str:
        job, record = self._job, self._job.progress
        if place:
            return "waiting: next in the queue" if place == 1 else f"waiting: number {place} in the queue"
        if job.active and job.stopping:
            return "stopping …"
        if job.state is JobState.RUNNING and record is not None:
            eta = record.eta_seconds
            left = f", {rough_seconds(eta)} left" if eta is not None and record.done < record.total else ""
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
        """Set the text of the last button to its current action."""
        job = self._job
        text, tip = "Dismiss", "Remove this job from the list"
        if job.active:
            text, tip = "Stop", "Stop this job. Removing its temporary files may take a moment"
        elif job.kept:
            text, tip = "Discard", f"Delete the parts of this job that are kept: {job.kept}"
        self.button.setText(text)
        self.button.setToolTip(tip)
        self.button.setAccessibleName(f"{text}: {job.title}")
        self.button.setEnabled(not (job.active and job.stopping))

    def show_log(self) -> JobLogView:
        """Show the log of the job in a separate window."""
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


KEPT = 20
"""Number of finished jobs that are listed."""

ROWS = 2
"""Number of jobs that are visible in the lowest window; the others scroll."""


class JobPanel(QWidget):
    """List of all jobs: running ones, queued ones in their order, then finished ones, newest first."""

    def __init__(self, jobs: Jobs, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._jobs = jobs
        self._rows: dict[int, JobRow] = {}
        self._shown: list[int] = []
        outer = QHBoxLayout(self)
        outer.setContentsMargins(0, 0, 8, 0)
        outer.setSpacing(2)
        self.area = QScrollArea(widgetResizable=True)
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
        watch = button(
            "Watch a run …",
            "Watch a run of lfcal on this machine or on a cluster. Choose the folder that contains its parts",
            self._ask,
        )
        side = QVBoxLayout()
        side.setContentsMargins(0, 4, 0, 4)
        side.addWidget(watch)
        side.addStretch()
        outer.addLayout(side)
        jobs.changed.connect(self._show)
        jobs.queued.connect(self._show_queue)

    def minimumSizeHint(self) -> QSize:
        """Return a size with room for `ROWS` jobs."""
        height = self.fontMetrics().height() + 28
        return QSize(super().minimumSizeHint().width(), ROWS * height)

    def watch(self, run: Path) -> RunView:
        """Show the units of a run (its folder ``H.h5.parts``, or its output) until the view is closed."""
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
        """Show the order of the queued jobs."""
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
        """Remove the oldest finished jobs without partial results."""
        over = sorted(number for number, row in self._rows.items() if not row.job.active and not row.job.kept)
        for number in over[: max(0, len(self._rows) - KEPT)]:
            self._take_out(number)

    def _take_out(self, number: int) -> None:
        self._rows.pop(number).leave()
        if number in self._shown:
            self._shown.remove(number)


SHORT_BAR, LINE_PX = 90, 17
"""Width of the bar, and height of the text: the status bar is as low as without it (px)."""

SHEET = (900, 300)
"""Largest size of the list (px)."""

NAMED, LONGEST = 2, 44
"""Largest number of jobs named in the line, and of letters of a name that is not shortened."""


def shortened(title: str, most: int) -> str:
    """Return a title; if it has more than ``most`` letters, its middle is replaced by an ellipsis."""
    half = (most - 1) // 2
    return title if len(title) <= most else f"{title[:half]}…{title[-half:]}"


def jobs_words(active: list[WindowJob], failed: list[WindowJob]) -> str:
    """Return the text of the status bar: a failed job, or the running jobs and the time left."""
    if failed:
        others = f", {len(failed) - 1} more" if len(failed) > 1 else ""
        return f"Failed: {shortened(failed[-1].title, LONGEST)}{others}"
    if not active:
        return "No jobs running"
    most = LONGEST // min(NAMED, len(active))
    names = ", ".join(shortened(job.title, most) for job in active[:NAMED]) + (", …" if len(active) > NAMED else "")
    first = active[0].progress
    eta = None if first is None else first.eta_seconds
    left = "" if eta is None or first is None or first.done >= first.total else f", {rough_seconds(eta, '')} left"
    return f"{names}{left}" if len(active) == 1 else f"{len(active)} jobs: {names}{left}"


class JobsLine(QWidget):
    """Progress bar and text in the status bar; a click opens the list of jobs.

    A failed job stays in red until the list is opened, the same job succeeds, or another project is opened.
    """

    def __init__(self, jobs: Jobs, window: QMainWindow) -> None:
        super().__init__(window)
        self._jobs = jobs
        self._failed: list[WindowJob] = []
        self.sheet = JobsSheet(JobPanel(jobs), window)
        self.bar = QProgressBar(textVisible=False)
        self.bar.setFixedWidth(SHORT_BAR)
        self.bar.setAccessibleName("Progress of the running job")
        self.button = QToolButton()
        self.button.setAutoRaise(True)
        self.button.setFixedHeight(LINE_PX)
        self.button.setToolTip("Show all jobs with their progress and logs, and stop or resume them (Ctrl+J)")
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
        self.sheet.setVisible(self.sheet.isHidden())
        self.forget_failed()

    def forget_failed(self) -> None:
        """Show no failed jobs, because the user has seen them, or another project was opened."""
        self._failed.clear()
        self.refresh()

    def refresh(self) -> None:
        """Show the running jobs."""
        active = [job for job in self._jobs.jobs() if job.active]
        active.sort(key=lambda job: job.state is JobState.WAITING)
        words = jobs_words(active, self._failed)
        self.button.setText(words)
        self.button.setAccessibleName(f"Jobs: {words}")
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
        elif job.state is JobState.DONE:
            self._failed = [one for one in self._failed if (one.page, one.title) != (job.page, job.title)]
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
        """Keep the list above the status bar when the window changes."""
        if event.type() == QEvent.Type.Resize and self.isVisible():
            self._place()
        return False

    def showEvent(self, event: Any) -> None:
        """Move to its place, and take the keyboard focus."""
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
        """Close the list when Escape is pressed."""
        if event.key() == Qt.Key.Key_Escape:
            self.hide()
        else:
            super().keyPressEvent(event)
