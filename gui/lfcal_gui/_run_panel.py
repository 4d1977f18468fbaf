"""A run in units, watched in the window: the same table as ``lfcal status`` shows."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtCore import Qt, QTimer
from PySide6.QtWidgets import QLabel, QWidget

from lfcal.work import HEADER, JOURNAL, RunTable, parts_folder, read_run, run_table
from lfcal_gui.jobs import Jobs
from lfcal_gui.widgets import HeadedCard, RowsTable

EVERY_MS = 1000
"""Between two looks at the journal of a run (ms)."""

HEIGHT = 160
"""Of the table (pixels)."""


def look(run: Path) -> RunTable:
    """Return where the run of a folder, or of the file it makes, stands; one that is over and gone says so.

    Raises
    ------
    InputError
        If there is no run, and nothing that one made.
    """
    named = run.suffix == ".parts" or not run.name or (run / JOURNAL).exists()
    folder = run if named else parts_folder(run)
    if run.name and not folder.exists() and (made := folder.with_suffix("")).exists():
        return RunTable(f"{made.name}: is complete; no run is active", "", (), "")
    return run_table(read_run(folder))


class RunView(HeadedCard):
    """One run, looked at every second until it is dismissed."""

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
        self.table.setFixedHeight(HEIGHT)
        self.column.addWidget(self.table)
        self._timer = QTimer(self)
        self._timer.setInterval(EVERY_MS)
        self._timer.timeout.connect(self.refresh)
        self._timer.start()
        self.refresh()

    def refresh(self) -> None:
        """Look at the journal, in the background."""
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
