"""How a fit converges: chi² and the error of left-out patterns, round by round."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import pyqtgraph as pg
from PySide6.QtWidgets import QLabel, QVBoxLayout, QWidget

from lfcal.fit import FitProgress
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets import LINES, DecadeAxis, LinePlot, line_px

__all__ = ["RoundsView"]

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
        self.plot.setAxisItems({"left": DecadeAxis("left")})
        self.plot.getAxis("left").setWidth(LEFT)
        self.plot.showGrid(x=True, y=True, alpha=0.15)
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
            self.plot.setYRange(middle - 1.1 * half, middle + 1.1 * half, padding=0)
            self.plot.setXRange(-0.3, max(4, len(values) - 1) + 0.3, padding=0)

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
            return
        parts = [f"{rounds[-1].stage}: {rounds[-1].note}."]
        if any(one.below_noise for one in rounds):
            parts.append("Hollow: less than the noise hides, which is drawn.")
        parts.append("χ² counts what the computation errs by as noise; it may rise where the fit goes on finer.")
        self.words.setText(" ".join(parts))

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        self.error.apply_theme()
        self.chi2.apply_theme()
        self.show_rounds(self._rounds)
