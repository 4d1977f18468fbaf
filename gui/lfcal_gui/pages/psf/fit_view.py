"""The fit of the optics in the inspector: its verdict, findings and parameters, convergence, and what is fitted."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QLabel, QProgressBar, QPushButton, QVBoxLayout, QWidget

from lfcal.base import Progress
from lfcal.fit import FitProgress
from lfcal_gui.pages.psf.fit_choices import ChoicesPanel
from lfcal_gui.pages.psf.model_fit_run import FoundFit
from lfcal_gui.pages.psf.model_fit_words import (
    COLUMNS,
    NUMBERS,
    SPARE,
    chi2_words,
    detail_of,
    findings_of,
    merit_of,
    parameter_rows,
    verdict_of,
)
from lfcal_gui.pages.psf.rounds_view import RoundsView
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets import Folded, RowsTable, line, name_controls, set_role

__all__ = ["FitView"]

READY = "Gap, focal lengths, iris and aberrations are found from the recorded positions of H."
LEGEND = "Crossed out in the map: left out as unlike the others. In a square: kept aside to judge the fit."
NO_ROUNDS = "Fitted while the session was recorded, which keeps no rounds."

ROWS = 130
"""Height of the tables (px)."""


class FitView(QWidget):
    """A fit, and what it is asked.

    Signals
    -------
    place_asked(place)
        Show the pattern of a position (z, y, x).
    """

    place_asked = Signal(tuple)

    def __init__(self) -> None:
        super().__init__()
        self._found: FoundFit | None = None
        self.choices = ChoicesPanel()
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(6)
        self._make_buttons()
        self.verdict, self.detail, self.sums = QLabel(), QLabel(), QLabel()
        for label, role in ((self.verdict, "value"), (self.detail, "hint"), (self.sums, "hint")):
            label.setWordWrap(True)
            label.setTextFormat(Qt.TextFormat.PlainText)
            label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
            label.setProperty("role", role)
        self.bar = QProgressBar()
        self.bar.setTextVisible(False)
        column.addLayout(line(self.fit_button, self.worst_button, self.use_button))
        for part in (self.verdict, self.bar, self.detail):
            column.addWidget(part)
        column.addWidget(self._results())
        column.addWidget(self.choices)
        self._rounds_at = column
        column.addStretch()

    def _make_buttons(self) -> None:
        self.fit_button, self.use_button = QPushButton("Fit"), QPushButton("Use camera")
        self.fit_button.setToolTip("Fit the recorded positions of H (F5)")
        self.worst_button = QPushButton("Worst")
        self.worst_button.setToolTip("Show the pattern that is explained worst (W)")
        self.model_button, self.save_button = QPushButton("Compute H …"), QPushButton("Save fit …")
        self.model_button.setToolTip("H of the fitted camera over all positions and depths, without noise")
        self.save_button.setToolTip(
            "Write camera, effects, H, numbers and report into a folder, as the command lfcal fit does"
        )
        self.report_button = QPushButton("Report")
        self.report_button.setToolTip("Open the fit as a page for people")
        for button in (self.model_button, self.save_button, self.report_button):
            button.setProperty("role", "tight")

    def _results(self) -> QWidget:
        self.results = QWidget()
        column = QVBoxLayout(self.results)
        column.setContentsMargins(0, 0, 0, 0)
        self.findings = RowsTable(("Findings",), 0, brief=(0,))
        self.findings.setAccessibleName("findings")
        self.findings.setWordWrap(True)
        self.findings.itemSelectionChanged.connect(self._finding_chosen)
        self.findings.cellClicked.connect(lambda *_: self._finding_chosen())  # also where it is selected already
        self.parameters = RowsTable(COLUMNS, 0, NUMBERS, spare=SPARE)
        self.parameters.setAccessibleName("parameters")
        legend = QLabel(LEGEND)
        legend.setWordWrap(True)
        legend.setProperty("role", "hint")
        column.addLayout(line(self.model_button, self.save_button, self.report_button))
        for table in (self.findings, self.parameters):
            table.setFixedHeight(ROWS)
            column.addWidget(table)
        column.addWidget(self.sums)
        column.addWidget(legend)
        return self.results

    @cached_property
    def rounds(self) -> RoundsView:
        """The convergence of a fit; made when one is at work or found."""
        folded = Folded("Convergence", "The error round by round: whether it settled, and which unknowns helped")
        made = RoundsView()
        folded.column.addWidget(made)
        self._rounds_at.insertWidget(self._rounds_at.count() - 2, folded)
        name_controls(folded)
        return made

    # -- states ----------------------------------------------------------------------------------------
    def show_ready(self, words: str = "", *, failed: bool = False) -> None:
        """Show that nothing was fitted yet; ``words``: why not, as an error where it ``failed``."""
        self._found = None
        self.parameters.show_rows([])
        self.findings.show_rows([])
        self.results.hide()
        self._say(words or READY, "", "bad" if failed else "")

    def show_running(self, words: str, record: Progress | None, rounds: Sequence[FitProgress]) -> None:
        """Show how far a fit is."""
        self._say(words, "", "")
        self.bar.show()
        total = 0 if record is None else record.total
        self.bar.setRange(0, total)
        if record is not None and total:
            self.bar.setValue(record.done)
        self.rounds.show_rounds(rounds)

    def show_found(self, found: FoundFit, rounds: Sequence[FitProgress], note: str = "") -> None:
        """Show what a fit found; ``note``: what was done or chosen since."""
        if found is not self._found:
            self._found = found
            self.sums.setText(chi2_words(found))
            self._show_rows(found)
        self.rounds.show_rounds(rounds, NO_ROUNDS)
        self._say(verdict_of(found.fit), "\n".join(filter(None, (detail_of(found), note))), merit_of(found.fit))
        self.results.show()

    def _say(self, words: str, detail: str, merit: str) -> None:
        self.verdict.setText(words)
        set_role(self.verdict, merit or "value")
        self.detail.setText(detail)
        self.detail.setVisible(bool(detail))
        self.bar.hide()

    def _show_rows(self, found: FoundFit) -> None:
        rows = parameter_rows(found.fit)
        theme = current_theme()
        self.parameters.show_rows(
            [row.texts for row in rows],
            [row.numbers for row in rows],
            lambda k, column: theme.accent if column == 5 and rows[k].far else "",
        )
        self.findings.show_rows([(f"{one.kind}: {one.text}",) for one in findings_of(found.fit)])
        self.findings.resizeRowsToContents()

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Wrap the findings again."""
        super().resizeEvent(event)
        self.findings.resizeRowsToContents()

    def _finding_chosen(self) -> None:
        found, row = self._found, self.findings.chosen()
        if found is not None and row >= 0:
            place = findings_of(found.fit)[row].place
            if place is not None:
                self.place_asked.emit(place)

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        if "rounds" in self.__dict__:
            self.rounds.apply_theme()
        if self._found is not None:
            self._show_rows(self._found)
