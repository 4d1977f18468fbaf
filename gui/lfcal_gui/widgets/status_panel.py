"""A panel that shows the progress and the end of a job."""

from __future__ import annotations

from PySide6.QtWidgets import QProgressBar, QVBoxLayout, QWidget

from lfcal_gui.models import JobState, WindowJob, said_in_window, unbroken
from lfcal_gui.widgets.cards import wrapped
from lfcal_gui.widgets.words import set_role


class StatusPanel(QWidget):
    """Widgets of a page with a job; `add_status` adds a progress bar and a text."""

    def add_status(self, column: QVBoxLayout) -> None:
        """Add the progress bar and the text to a ``column``, hidden at first."""
        self.bar, self.status = QProgressBar(textVisible=False), wrapped()
        column.addWidget(self.bar)
        column.addWidget(self.status)
        self.show_status("")

    def show_status(self, words: str, fraction: float | None = None, *, bad: bool = False, busy: bool = False) -> None:
        """Show a text and, while ``busy``, the completed fraction (None: unknown)."""
        set_role(self.status, "error" if bad else "hint")
        self.status.setText(unbroken(words))
        self.status.setVisible(bool(words))
        self.bar.setVisible(busy)
        self.bar.setRange(0, 0 if fraction is None else 1000)
        if fraction is not None:
            self.bar.setValue(round(1000 * fraction))

    def show_progress(self, job: WindowJob) -> None:
        """Show the progress of a running job."""
        record = job.progress
        if job.active and record is not None:
            words = "stopping …" if job.stopping else f"{record.stage}: {record.done} of {record.total}"
            self.show_status(words, record.fraction, busy=True)

    def show_end(self, job: WindowJob) -> None:
        """Show why a job failed, or that it was stopped; a text about its result remains."""
        if job.state is JobState.FAILED:
            self.show_status(said_in_window(job.error), bad=True)
        elif job.state is not JobState.DONE:
            self.show_status("stopped")
        elif self.bar.isVisibleTo(self):
            self.show_status("")
