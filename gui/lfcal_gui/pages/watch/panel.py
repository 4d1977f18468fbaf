"""Watch: frames and settings at the left; verdict, table of frames and recalibration at the right."""

from __future__ import annotations

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QWidget

from lfcal.recalibrate import DriftWatch
from lfcal_gui.models import unbroken
from lfcal_gui.pages.watch.model import FIELDS, HEADER, MORE, rows_of, trend_words
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets import (
    FoldedForm,
    RowsTable,
    StatusPanel,
    WrappedLabel,
    button,
    card,
    column_area,
    line,
    row_of,
    wrapped,
)

FILES = "Choose images of any structured objects, in the order of recording"
FOLDER = "Choose a folder of frames"
CHECK = "Measure the shift of the array and the change of the gap in each frame, as a job (F5)"
STOP = "Stop (Esc)"
RECALIBRATE = (
    "Recalibrate the camera on the first frames that show the drift, compute its H in a folder, and use that H in the "
    "project"
)
NOTHING = "No frame has been checked yet."


class WatchPanel(StatusPanel):
    """The page's widgets."""

    pressed = Signal(str, arguments=["key"])
    """A button: ``"files"``, ``"folder"``, ``"check"``, ``"stop"`` or ``"recalibrate"``."""

    def __init__(self) -> None:
        super().__init__()
        row_of(column_area(330, self._settings_card(), dense=True), self._found_card(), of=self, spacing=8, stretch=1)
        self.show_found(None)

    def _button(self, text: str, tip: str, key: str) -> QWidget:
        return button(text, tip, lambda: self.pressed.emit(key))

    def _settings_card(self) -> QWidget:
        frame, column = card("Frames")
        column.addLayout(line(self._button("Files …", FILES, "files"), self._button("Folder …", FOLDER, "folder")))
        self.frames = WrappedLabel("none yet", role="hint")
        column.addWidget(self.frames)
        self.form = FoldedForm(FIELDS, MORE)
        for field in (*FIELDS, *MORE):
            self.form.own_line(field.key)
        column.addWidget(self.form)
        self._go = "check"
        self.go = button("Check frames", CHECK, lambda: self.pressed.emit(self._go))
        column.addLayout(line(self.go))
        self.add_status(column)
        return frame

    def _found_card(self) -> QWidget:
        frame, column = card("Is H still valid?")
        self.verdict = wrapped("value")
        self.table = RowsTable(HEADER, 6, (1, 2, 3, 4, 5), brief=(6,))
        self.table.setAccessibleName("Frames")
        self.trend = wrapped("hint")
        self.recalibrate = button("Recalibrate …", RECALIBRATE, lambda: self.pressed.emit("recalibrate"))
        column.addWidget(self.verdict)
        column.addWidget(self.table, 1)
        column.addWidget(self.trend)
        column.addLayout(line(self.recalibrate))
        return frame

    def show_go(self, *, running: bool, enabled: bool) -> None:
        """Set the text of the main button to its current action."""
        self._go = "stop" if running else "check"
        self.go.setText("Stop" if running else "Check frames")
        self.go.setToolTip(STOP if running else CHECK)
        self.go.setEnabled(running or enabled)
        self.form.setEnabled(not running)

    def show_found(self, found: DriftWatch | None) -> None:
        """Show the verdict and the frames; None: nothing has been checked."""
        self._found = found
        rows = [] if found is None else rows_of(found)
        theme = current_theme()
        alarms = [row[0][-1] for row in rows]
        self.table.show_rows(
            [row[0] for row in rows],
            [row[1] for row in rows],
            lambda row, column: theme.bad if column == 6 and alarms[row] != "valid" else "",
        )
        self.verdict.setText(NOTHING if found is None else unbroken(found.verdict))
        self.trend.setText("" if found is None else unbroken(trend_words(found)))
        self.recalibrate.setEnabled(found is not None and found.moved)

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        self.show_found(self._found)
