"""The fit of the optics in the inspector: its verdict, findings and parameters, convergence, and what is fitted."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import cached_property

import pyqtgraph as pg
from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QLabel, QProgressBar, QPushButton, QVBoxLayout, QWidget

from lfcal.base import Progress
from lfcal.fit import FitProgress
from lfcal_gui.pages.h.fit_choices import ChoicesPanel
from lfcal_gui.pages.h.model_fit_run import FoundFit
from lfcal_gui.pages.h.model_fit_words import (
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
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets import LINES, DecadeAxis, Folded, LinePlot, RowsTable, line, line_px, name_controls, set_role

FLOOR = 1e-6
"""Least value that is drawn: a logarithm has no zero."""

LEFT = 64
"""Width of the vertical axes (px): both plots begin at the same place, and none jumps."""

MANY = 12
"""Number of rounds above which only every fifth has its number."""

HEIGHT = 130
"""Height of a plot (px)."""


class DecadePlot(LinePlot):
    """Positive values over whole numbers, on a scale of decades; hollow where a value is only a limit."""

    def __init__(self, label: str, colour: str) -> None:
        super().__init__("", label)
        self._y, self._colour = label, colour
        self._values: list[float] = []
        self.plot.set_axes(DecadeAxis("left"))
        self.plot.getAxis("left").setWidth(LEFT)
        self.blank.show_blank(False)
        self.blank.show_blank(True)
        self.line, self.dots = pg.PlotDataItem(pen=pg.mkPen(colour, width=line_px(1.8))), pg.ScatterPlotItem(size=8)
        for item in (self.line, self.dots):
            self.plot.addItem(item)
        self.set_labels("round of derivatives", label)

    def show_values(self, values: Sequence[float], limits: Sequence[bool]) -> None:
        """Show values from round 0, the start; those that are ``limits`` are hollow, NaN are left out."""
        self._values = list(values)
        self.blank.show_blank(not self._values)
        theme = current_theme()
        points = [(k, math.log10(max(v, FLOOR)), limits[k]) for k, v in enumerate(values) if not math.isnan(v)]
        self.line.setData([x for x, _, _ in points], [y for _, y, _ in points])
        pen = pg.mkPen(self._colour, width=line_px(1.6))
        fill = {True: pg.mkBrush(theme.panel), False: pg.mkBrush(self._colour)}
        self.dots.setData([{"pos": (x, y), "pen": pen, "brush": fill[limit]} for x, y, limit in points])
        self.plot.getAxis("bottom").setTickSpacing(5 if len(values) > MANY else 1, 1)
        if points:
            low, high = min(y for _, y, _ in points), max(y for _, y, _ in points)
            # a decade at least, or noise fills the plot
            middle, half = (low + high) / 2, max(0.5, (high - low) / 2)
            self.plot.vb.setYRange(middle - 1.1 * half, middle + 1.1 * half, padding=0)
            self.plot.vb.setXRange(-0.3, max(4, len(values) - 1) + 0.3, padding=0)

    def table_lines(self, between: str) -> Iterator[str]:
        """Yield round and value."""
        yield f"# round, {self._y}\n"
        yield from (f"{k}{between}{value:.9g}\n" for k, value in enumerate(self._values))


class RoundsView(QWidget):
    """Two curves, one below the other."""

    def __init__(self) -> None:
        super().__init__()
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 6, 0, 0)
        self.error = DecadePlot("error of left-out patterns (%)", LINES[0])
        self.chi2 = DecadePlot("χ² of fitted patterns", LINES[1])
        self._rounds: tuple[FitProgress, ...] = ()
        for plot in (self.error, self.chi2):
            plot.setFixedHeight(HEIGHT)
            column.addWidget(plot)
        self.words = QLabel()
        self.words.setWordWrap(True)
        self.words.setProperty("role", "hint")
        column.addWidget(self.words)

    def show_rounds(self, rounds: Sequence[FitProgress], none: str = "The start is being computed …") -> None:
        """Show the start and the rounds that are done; ``none`` are the words where there are none."""
        self._rounds = tuple(rounds)
        self.error.show_values([100 * one.held_out for one in rounds], [one.below_noise for one in rounds])
        self.chi2.show_values([one.chi2 for one in rounds], [False] * len(rounds))
        if not rounds:
            self.words.setText(none)
            for plot in (self.error, self.chi2):
                plot.blank.words = none
            return
        parts = [f"{rounds[-1].stage}: {rounds[-1].note}."]
        if any(one.below_noise for one in rounds):
            parts.append("Hollow: the error is below the noise; the noise limit is drawn.")
        parts.append("χ² includes the numerical error as noise; it may rise when the fit continues at finer sampling.")
        self.words.setText(" ".join(parts))

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        self.error.apply_theme()
        self.chi2.apply_theme()
        self.show_rounds(self._rounds)


READY = "Gap, focal lengths, iris and aberrations are found from the recorded positions of H."
LEGEND = "Crossed out in the map: left out as an outlier. In a square: held out to judge the fit."
NO_ROUNDS = "Fitted during the recording; rounds of such a fit are not kept."

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
