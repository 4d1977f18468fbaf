"""What a fit found: patterns, parameters, findings, convergence."""

from __future__ import annotations

from collections.abc import Sequence

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QTabWidget

from lfcal.fit import FitProgress
from lfcal_gui.pages.fit.model_run import FoundFit, Place
from lfcal_gui.pages.fit.model_words import COLUMNS, NUMBERS, findings_of, parameter_rows
from lfcal_gui.pages.fit.patterns_view import PatternsView
from lfcal_gui.pages.fit.rounds_view import RoundsView
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets import RowsTable

__all__ = ["FoundTabs"]


class FoundTabs(QTabWidget):
    """Four views of one fit.

    Signals
    -------
    place_asked(place)
        Show the pattern of a position (z, y, x).
    """

    place_asked = Signal(tuple)

    def __init__(self) -> None:
        super().__init__()
        self._found: FoundFit | None = None
        self.patterns, self.rounds = PatternsView(), RoundsView()
        self.patterns.place_asked.connect(self.place_asked.emit)
        self.parameters = RowsTable(COLUMNS, len(COLUMNS) - 1, NUMBERS)
        self.parameters.setAccessibleName("parameters")
        self.findings = RowsTable(("Kind", "What the fit says"), 1)
        self.findings.setAccessibleName("findings")
        self.findings.itemSelectionChanged.connect(self._finding_chosen)
        self.findings.cellClicked.connect(lambda *_: self._finding_chosen())  # also where it is selected already
        self.setDocumentMode(True)
        self.tabBar().setDrawBase(False)
        for widget, title, tip in (
            (
                self.patterns,
                "Patterns",
                "Does the model look like what was recorded? Each pattern, model and what is left",
            ),
            (self.parameters, "Parameters", "What was found, how sure it is, and how far from the description"),
            (self.findings, "Findings", "What the fit noticed: doubtful patterns, limits, what the model lacks"),
            (self.rounds, "Convergence", "Did it settle, and which unknowns helped? The error round by round"),
        ):
            self.setTabToolTip(self.addTab(widget, title), tip)

    def show_found(self, found: FoundFit, rounds: Sequence[FitProgress]) -> None:
        """Show what a fit found, and its rounds."""
        self._found = found
        self.patterns.show_found(found)
        self.rounds.show_rounds(rounds, "Fitted while the session was recorded, which keeps no rounds.")
        self._show_rows(found)

    def _show_rows(self, found: FoundFit) -> None:
        rows = parameter_rows(found.fit)
        theme = current_theme()
        self.parameters.show_rows(
            [row.texts for row in rows],
            [row.numbers for row in rows],
            lambda k, column: theme.accent if column == 5 and rows[k].far else "",
        )
        self.findings.show_rows([(one.kind, one.text) for one in findings_of(found.fit)])

    def forget(self) -> None:
        """Let go of the fit: its patterns may be large, and belong to another H."""
        self._found = None
        self.patterns.clear()
        self.parameters.show_rows([])
        self.findings.show_rows([])

    # -- choosing --------------------------------------------------------------------------------------
    def show_place(self, place: Place) -> None:
        """Show the pattern of a position (z, y, x)."""
        self.patterns.show_place(place)
        self.setCurrentWidget(self.patterns)

    def _finding_chosen(self) -> None:
        found, row = self._found, self.findings.number_of(self.findings.currentRow())
        if found is not None and row >= 0 and self.findings.selectedIndexes():
            place = findings_of(found.fit)[row].place
            if place is not None:
                self.place_asked.emit(place)

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        self.patterns.apply_theme()
        self.rounds.apply_theme()
        if self._found is not None:
            self._show_rows(self._found)
