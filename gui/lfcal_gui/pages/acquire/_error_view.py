"""The error of H against positions recorded, falling towards the wanted one."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import Qt

from lfcal_gui.pages.acquire.model_until import ErrorCurve
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets import LINES, DecadeAxis, LinePlot

__all__ = ["TITLE", "ErrorView"]

LEAST = 1e-3
"""Least error that is drawn (%): a logarithm has no zero."""

FEW = 24
"""Positions that the axis spans at least."""

STATED, ASIDE = LINES[0], LINES[1]

TITLE = (
    f"Error of H <span style='font-weight: normal'> <span style='color: {STATED}'>●</span> stated "
    f"<span style='color: {ASIDE}'>◆</span> kept aside</span>"
)
"""Title of a card with the plot: in a narrow one a legend would hide what it is about."""


class ErrorView(LinePlot):
    """What each fit states, what positions kept aside tell of it, and the error that ends the recording."""

    # before the rest is made the plot takes the theme's colours
    curve: ErrorCurve | None = None

    def __init__(self) -> None:
        super().__init__("positions recorded", "error of H (%)")
        self.plot.setAxisItems({"left": DecadeAxis("left")})
        self.plot.showGrid(x=True, y=True, alpha=0.15)
        self.blank.show_blank(False)
        self.blank.show_blank(True)
        self.set_labels("positions recorded", "error of H (%)")
        self.setToolTip(
            "Stated: what the unknowns' standard deviations make of H (relative L2). Kept aside: off at positions that "
            "are never fitted, ± 2 standard deviations; hollow: a limit. The session ends below the dashed line"
        )
        # behind the dots: both fits of one count are seen
        self.bars = pg.ErrorBarItem(x=np.zeros(0), y=np.zeros(0), beam=0.6, pen=pg.mkPen(ASIDE, width=1.4))
        self.stated = self.plot.plot(
            [],
            [],
            pen=pg.mkPen(STATED, width=1.8),
            symbol="o",
            symbolSize=7,
            symbolBrush=STATED,
            symbolPen=None,
        )
        self.aside = pg.ScatterPlotItem(size=9, symbol="d", pen=pg.mkPen(ASIDE), brush=ASIDE)
        self.wanted = pg.InfiniteLine(
            0.0,
            angle=0,
            pen=pg.mkPen(LINES[2], width=1.6, style=Qt.PenStyle.DashLine),
            label="wanted",
            labelOpts={"position": 0.06, "anchors": [(0, 1), (0, 1)], "color": LINES[2]},
        )
        for item in (self.bars, self.aside, self.wanted):
            self.plot.addItem(item)
        self.apply_theme()

    def show_curve(self, curve: ErrorCurve) -> None:
        """Show what is known after the fits that are done."""
        self.curve = curve
        self.blank.show_blank(False)
        x = np.array(curve.positions, float)
        stated, aside, wanted = (_log(np.array(v, float)) for v in (curve.stated, curve.aside, [curve.wanted]))
        self.stated.setData(x, stated)
        limit = np.isnan(np.array(curve.below, float))
        fill = {True: pg.mkBrush(current_theme().panel), False: pg.mkBrush(ASIDE)}
        pen = pg.mkPen(ASIDE, width=1.6)
        self.aside.setData(
            [
                {"pos": place, "pen": pen, "brush": fill[bool(only)]}
                for *place, only in zip(x.tolist(), aside.tolist(), limit.tolist(), strict=True)
            ]
        )
        known = ~limit
        values, below, above = (np.array(v, float)[known] for v in (curve.aside, curve.below, curve.above))
        self.bars.setData(
            x=x[known],
            y=aside[known],
            top=_log(values + above) - aside[known],
            bottom=aside[known] - _log(values - below),
        )
        self.wanted.setValue(float(wanted[0]))
        # before the first fit there is room above, for it begins far away
        every = np.concatenate([stated, aside, wanted, [] if len(x) else wanted + 1.0])
        low, high = float(every.min()) - 0.15, float(every.max()) + 0.15
        self.plot.setYRange(min(low, high - 0.8), high, padding=0)
        self.plot.setXRange(0.0, 1.08 * max([FEW, *curve.positions]), padding=0)

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        super().apply_theme()
        if self.curve is not None:
            self.show_curve(self.curve)

    def table_lines(self, between: str) -> Iterator[str]:
        """Yield what is known after each fit."""
        curve = self.curve
        rows = [] if curve is None else zip(curve.positions, curve.stated, curve.aside, curve.above, strict=True)
        yield "# positions recorded, error of H stated (%), error at positions kept aside (%), ± (%); 0: a limit\n"
        for n, *errors in rows:
            yield between.join((str(n), *(f"{error:.6g}" for error in errors))) + "\n"


def _log(values: np.ndarray) -> np.ndarray:
    return np.log10(np.maximum(values, LEAST))
