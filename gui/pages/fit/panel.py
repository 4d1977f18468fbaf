"""Fit: choices on the left; verdict, patterns, parameters, findings and convergence on the right."""

from __future__ import annotations

from collections.abc import Sequence

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import (
    QFrame,
    QHBoxLayout,
    QLabel,
    QProgressBar,
    QStackedWidget,
    QTabWidget,
    QVBoxLayout,
    QWidget,
)

from gui.pages.fit.choices_panel import ChoicesPanel
from gui.pages.fit.model_run import Found, Place
from gui.pages.fit.model_words import (
    COLUMNS,
    NUMBERS,
    detail_of,
    findings_of,
    merit_of,
    parameter_rows,
    verdict_of,
)
from gui.pages.fit.patterns_view import PatternsView
from gui.pages.fit.rounds_view import RoundsView
from gui.theme import current_theme
from gui.widgets.cards import card
from gui.widgets.rows_table import RowsTable
from lfcal.fit import FitProgress
from lfcal.progress import Progress

__all__ = ["FitPanel"]

READY = "Press Fit (F5).\nGap, focal lengths, iris and aberrations are found from the recorded positions of H."


class FitPanel(QWidget):
    """The page's widgets.

    Signals
    -------
    place_asked(place)
        Show the pattern of a position (z, y, x).
    """

    place_asked = Signal(tuple)

    def __init__(self) -> None:
        super().__init__()
        self._found: Found | None = None
        self.choices = ChoicesPanel()
        self.patterns, self.rounds, self.running = PatternsView(), RoundsView(), RoundsView()
        self.patterns.place_asked.connect(self.place_asked.emit)
        self.parameters = RowsTable(COLUMNS, len(COLUMNS) - 1, NUMBERS)
        self.parameters.setAccessibleName("parameters")
        self.findings = RowsTable(("Kind", "What the fit says"), 1)
        self.findings.setAccessibleName("findings")
        self.findings.itemSelectionChanged.connect(self._finding_chosen)
        self.findings.cellClicked.connect(lambda *_: self._finding_chosen())  # also where it is selected already
        self.tabs = self._tabs()
        self.ready = QLabel(READY)
        self.ready.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self.ready.setWordWrap(True)
        self.ready.setProperty("role", "hint")
        self.stack = QStackedWidget()
        for content in (self.ready, self.running, self.tabs):
            self.stack.addWidget(content)
        right = QWidget()
        column = QVBoxLayout(right)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(8)
        column.addWidget(self._status_card())
        below, inner = card()
        inner.addWidget(self.stack)
        column.addWidget(below, 1)
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        row.setSpacing(8)
        row.addWidget(self.choices)
        row.addWidget(right, 1)

    def _tabs(self) -> QTabWidget:
        tabs = QTabWidget()
        tabs.setDocumentMode(True)
        tabs.tabBar().setDrawBase(False)
        for widget, title in (
            (self.patterns, "Patterns"),
            (self.parameters, "Parameters"),
            (self.findings, "Findings"),
            (self.rounds, "Convergence"),
        ):
            tabs.addTab(widget, title)
        return tabs

    def _status_card(self) -> QFrame:
        self.status, column = card()
        self.verdict, self.detail = QLabel(), QLabel()
        self.bar = QProgressBar()
        self.bar.setTextVisible(False)
        for label, role in ((self.verdict, "value"), (self.detail, "hint")):
            label.setWordWrap(True)
            label.setTextFormat(Qt.TextFormat.PlainText)
            label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
            label.setProperty("role", role)
            column.addWidget(label)
        column.addWidget(self.bar)
        return self.status

    # -- states ----------------------------------------------------------------------------------------
    def resizeEvent(self, event: QResizeEvent) -> None:
        """Give the choices more width where there is more."""
        super().resizeEvent(event)
        self.choices.fit_width(self.width())

    def show_ready(self, words: str = "", *, failed: bool = False) -> None:
        """Show that nothing was fitted yet; ``words``: why not, as an error where it ``failed``."""
        self._forget()
        self._say(words, "", "bad" if failed else "")
        self.stack.setCurrentWidget(self.ready)

    def show_running(self, words: str, record: Progress | None, rounds: Sequence[FitProgress]) -> None:
        """Show how far a fit is."""
        self._say(words, "", "")
        self.bar.show()
        total = 0 if record is None else record.total
        self.bar.setRange(0, total)
        if record is not None and total:
            self.bar.setValue(record.done)
        self.running.show_rounds(rounds)
        self.stack.setCurrentWidget(self.running)

    def show_found(self, found: Found, rounds: Sequence[FitProgress], note: str = "") -> None:
        """Show what a fit found; ``note``: what was done or chosen since."""
        if found is not self._found:
            self._found = found
            self.patterns.show_found(found)
            self.rounds.show_rounds(rounds, "Fitted while the session was recorded, which keeps no rounds.")
            self._show_rows(found)
        self._say(verdict_of(found.fit), "\n".join(filter(None, (detail_of(found), note))), merit_of(found.fit))
        self.stack.setCurrentWidget(self.tabs)

    def _say(self, words: str, detail: str, merit: str) -> None:
        theme = current_theme()
        colour = {"good": theme.good, "fair": theme.fair, "bad": theme.bad}.get(merit, theme.text)
        self.verdict.setText(words)
        self.verdict.setStyleSheet(f"color: {colour};")
        self.detail.setText(detail)
        self.detail.setVisible(bool(detail))
        self.bar.hide()
        self.status.setVisible(bool(words))

    def _show_rows(self, found: Found) -> None:
        rows = parameter_rows(found.fit)
        theme = current_theme()
        self.parameters.show_rows(
            [row.texts for row in rows],
            [row.numbers for row in rows],
            lambda k, column: theme.accent if column == 5 and rows[k].far else "",
        )
        self.findings.show_rows([(one.kind, one.text) for one in findings_of(found.fit)])

    def _forget(self) -> None:
        """Let go of the fit: its patterns may be large, and belong to another H."""
        if self._found is not None:
            self._found = None
            self.patterns.clear()
            self.parameters.show_rows([])
            self.findings.show_rows([])

    # -- choosing --------------------------------------------------------------------------------------
    def show_place(self, place: Place) -> None:
        """Show the pattern of a position (z, y, x)."""
        self.patterns.show_place(place)
        self.tabs.setCurrentWidget(self.patterns)

    def _finding_chosen(self) -> None:
        found, row = self._found, self.findings.number_of(self.findings.currentRow())
        if found is not None and row >= 0 and self.findings.selectedIndexes():
            place = findings_of(found.fit)[row].place
            if place is not None:
                self.place_asked.emit(place)

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        for widget in (self.patterns, self.rounds, self.running):
            widget.apply_theme()
        if self._found is not None:
            self._show_rows(self._found)
