"""Sessions: the quality reports of the gallery over time, as a table and the curve of a selected row."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtWidgets import QHBoxLayout, QLabel, QSplitter, QVBoxLayout, QWidget

from lfcal_gui.context import Context
from lfcal_gui.pages.sessions import model_trend
from lfcal_gui.pages.sessions.model_trend import TrendCurve
from lfcal_gui.saving import ask_target
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets import LINES, LinePlot, RowsTable, WrappedLabel, button, card, split, told_or_shown

if TYPE_CHECKING:
    from lfcal.judge import StoredResult, Trend


class TrendPanel(QWidget):
    """Tab with the quality reports over time: a table, and the curve of the selected row."""

    picture_asked = Signal()
    """Request to save a picture of all curves."""
    row_chosen = Signal(int, arguments=["row"])
    """A row of the table was selected."""

    def __init__(self) -> None:
        super().__init__()
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 8, 0, 0)
        column.setSpacing(8)
        column.addLayout(self._head())
        self.message, self.stack = told_or_shown("", self._content())
        column.addWidget(self.stack, 1)

    def _head(self) -> QHBoxLayout:
        self.verdict, self.notes = QLabel(), QLabel()
        for label, role in ((self.verdict, "value"), (self.notes, "hint")):
            label.setWordWrap(True)
            label.setProperty("role", role)
        words = QVBoxLayout()
        words.setSpacing(2)
        words.addWidget(self.verdict)
        words.addWidget(self.notes)
        self.picture_button = button(
            "Save image …",
            "Save the curves of the checks that were not good in at least one session (.png, .svg)",
            self.picture_asked.emit,
        )
        self.picture_button.setEnabled(False)
        row = QHBoxLayout()
        row.addLayout(words, 1)
        row.addWidget(self.picture_button, 0, Qt.AlignmentFlag.AlignTop)
        return row

    def _content(self) -> QSplitter:
        left, column = card("Faults and checks")
        self.table = RowsTable(model_trend.TREND_COLUMNS, 0)
        self.table.setAccessibleName("Faults and checks over time")
        self.table.setSelectionMode(RowsTable.SelectionMode.SingleSelection)
        self.table.verticalHeader().setDefaultSectionSize(24)
        self.table.itemSelectionChanged.connect(self._chosen)
        column.addWidget(self.table)
        self.title = WrappedLabel("Over time")
        right, column = card(self.title)
        self.curve = LinePlot("days since the first session", "value", legend=True)
        column.addWidget(self.curve)
        return split(left, right, sizes=(690, 370))

    # -- showing ---------------------------------------------------------------------------------------
    def show_message(self, words: str) -> None:
        """Show a message in place of the table."""
        self.message.setText(words)
        for label in (self.verdict, self.notes):
            label.setText("")
        self.picture_button.setEnabled(False)
        self.stack.setCurrentIndex(0)

    def show_rows(self, words: tuple[str, str], rows: Sequence[tuple[str, ...]], merits: Sequence[str]) -> None:
        """Show a summary and all rows; the first row is selected."""
        theme = current_theme()
        colours = {"good": theme.good, "fair": theme.fair, "bad": theme.bad, "unknown": theme.muted}
        self.verdict.setText(words[0])
        self.notes.setText(words[1])
        with QSignalBlocker(self.table):
            self.table.show_rows(rows, colour=lambda row, column: colours[merits[row]] if column == 2 else "")
            self.table.clearSelection()
        for column in (3, 4):  # what is known for no row is not shown
            self.table.setColumnHidden(column, not any(row[column] for row in rows))
        self.picture_button.setEnabled(True)
        self.stack.setCurrentIndex(1)
        self.table.selectRow(0)

    def show_curve(self, curve: TrendCurve) -> None:
        """Show a curve with the limits of good and bad."""
        self.title.setText(curve.label)
        self.curve.clear()
        self.curve.set_labels(f"{curve.unit} since the first session", curve.label)
        ends = np.array([curve.times.min(), max(curve.times.max(), curve.times.min() + 1)])
        theme = current_theme()
        drawn = [("limit of good values", curve.good, theme.good), ("limit of bad values", curve.bad, theme.bad)]
        if curve.good == curve.bad:  # one line would hide the other
            drawn = [("limit of good and bad values", curve.bad, theme.bad)]
        for name, limit, colour in drawn:
            if np.isfinite(limit):
                self.curve.set_curve(name, ends, np.full(2, limit), colour=colour, dashed=True)
        self.curve.set_curve("value", curve.times, curve.values, symbol="o", colour=LINES[0])
        self.curve.plot.vb.autoRange()
        limits = [limit for limit in (curve.good, curve.bad) if np.isfinite(limit)]
        every = np.concatenate([curve.values, limits])
        if every.min() >= 0:  # counts and sizes begin at zero
            self.curve.plot.vb.setYRange(0.0, 1.05 * every.max() or 1.0, padding=0.02)

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        self.curve.apply_theme()

    def _chosen(self) -> None:
        rows = {index.row() for index in self.table.selectedIndexes()}
        if rows:
            self.row_chosen.emit(self.table.number_of(rows.pop()))


PICTURES = "Images (*.png *.svg)"


class Trending:
    """Controller of the reports of the gallery over time.

    Parameters
    ----------
    panel, context
        Panel that shows the table, and context of the window.
    """

    def __init__(self, panel: TrendPanel, context: Context) -> None:
        self._panel, self._context = panel, context
        self.found: Trend | None = None
        self._asked: Sequence[StoredResult] | None = None
        panel.picture_asked.connect(self.save_picture)
        panel.row_chosen.connect(self._row_chosen)

    def show_results(self, reports: Sequence[StoredResult]) -> None:
        """Read these reports, unless they are displayed already."""
        if reports == self._asked:
            return
        self.found, self._asked = None, reports
        folders = [Path(one.path) for one in reports]
        self._panel.show_message("Reading …")
        self._context.jobs.drop("sessions trend")
        self._context.jobs.load(
            "sessions trend", lambda: model_trend.trend_of(folders), self._read, self._panel.show_message
        )

    def _read(self, found: Trend) -> None:
        self.found = found
        self.show()

    def show(self) -> None:
        """Show the reports that were read."""
        if self.found is not None:
            self._panel.show_rows(
                model_trend.trend_words(self.found), model_trend.rows_of(self.found), model_trend.merits_of(self.found)
            )

    def _row_chosen(self, row: int) -> None:
        if self.found is not None and row >= 0:
            self._panel.show_curve(model_trend.curve_of(self.found, row))

    def save_picture(self, path: str = "") -> None:
        """Save a picture of all curves; without a path, ask for one."""
        from lfcal.judge import draw_trend

        found = self.found
        if found is None:
            return
        path = path or ask_target(self._panel, "Save image", "trend.png", PICTURES)
        if path:  # it appears whole or not at all
            self._context.jobs.compute(
                "sessions trend picture",
                lambda: draw_trend(found, path),
                lambda _: self._context.message.emit(f"image written: {path}"),
            )
