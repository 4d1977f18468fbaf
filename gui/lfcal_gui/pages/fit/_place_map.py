"""chi² of the patterns of a plane at their positions in the period; a click chooses one."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import QRectF, Signal
from PySide6.QtWidgets import QVBoxLayout, QWidget

from lfcal_gui.pages.fit.model_run import FoundFit, Place
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets import (
    ColourBar,
    count_pixels,
    offer_menu,
    pixel_axes,
    style_axes,
    table_entries,
    theme_plot,
    theme_table,
)

__all__ = ["PlaceMap"]

SYMBOLS = {"fitted": "o", "kept aside": "s", "left out": "x"}
COLOURS = "viridis"
LEAST = (0.8, 1.5)
"""χ² at the ends of the colours, at least: what noise alone scatters is no pattern."""


class PlaceMap(QWidget):
    """A dot for each pattern: round where it was fitted, square where it was kept aside, a cross where left out.

    Signals
    -------
    chosen(place)
        The dot of a position (z, y, x) was clicked.
    """

    chosen = Signal(tuple)

    def __init__(self) -> None:
        super().__init__()
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        self.graphics = pg.GraphicsLayoutWidget()
        self.graphics.setMinimumSize(120, 110)
        column.addWidget(self.graphics)
        self.plot: pg.PlotItem = self.graphics.addPlot(row=0, col=0, axisItems=pixel_axes(), enableMenu=False)
        self.plot.setAspectLocked(True)
        self.plot.invertY(True)
        self.plot.hideButtons()
        self.plot.setMouseEnabled(False, False)
        style_axes(self.plot, "source x (px)", "source y (px)")
        self.bar = ColourBar(LEAST, label="χ²")
        self.graphics.addItem(self.bar, row=0, col=1)
        self.places: tuple[Place, ...] = ()
        self._tips: dict[Place, str] = {}
        self._shown: tuple[FoundFit, int] | None = None
        self.dots = pg.ScatterPlotItem(hoverable=True, tip=lambda x, y, data: self._tips[data])
        self.dots.sigClicked.connect(self._clicked)
        self.ring = pg.ScatterPlotItem(size=19, symbol="o", brush=None)
        for item in (self.ring, self.dots):
            self.plot.addItem(item)
        offer_menu(self, lambda: "chi2", self._entries)
        self.setToolTip("Click a position to see its pattern")
        self.apply_theme()

    def show_plane(self, found: FoundFit, z: int) -> None:
        """Show the patterns of a plane; colours mean the same in all planes."""
        self._shown = (found, z)
        ny, nx = found.measured.plan.period
        self.places = tuple(place for place in found.places if place[0] == z)
        self._tips = {
            (z, y, x): f"y {y}, x {x}\nχ² {found.chi2[z, y, x]:.3g}\n{found.fate((z, y, x))}" for z, y, x in self.places
        }
        kept = [value for place, value in found.chi2.items() if found.fate(place) != "left out"]
        levels = (min(LEAST[0], *kept), max(LEAST[1], *kept)) if kept else LEAST
        self.bar.set_levels(levels)
        theme, table, spots = current_theme(), theme_table(COLOURS), []
        for place in self.places:
            fate = found.fate(place)
            share = (found.chi2[place] - levels[0]) / (levels[1] - levels[0])
            colour = theme.bad if fate == "left out" else tuple(table[round(255 * float(np.clip(share, 0, 1)))])
            spot = {"pos": (place[2], place[1]), "data": place, "size": 10, "symbol": SYMBOLS[fate]}
            spots.append({**spot, "brush": pg.mkBrush(colour), "pen": pg.mkPen(theme.muted, width=0.6)})
        self.dots.setData(spots)
        count_pixels(self.plot, (ny, nx))
        self.plot.setRange(QRectF(-1.5, -1.5, nx + 2, ny + 2), padding=0)

    def _entries(self) -> list[tuple[str, Any]]:
        return table_entries(self, "chi2", self._lines) if self._shown is not None else []

    def _lines(self, between: str) -> Iterator[str]:
        """Yield χ² and the fate of each pattern of the plane."""
        assert self._shown is not None
        yield between.join(("z", "y", "x", "chi2", "fate")) + "\n"
        for place in self.places:
            found = self._shown[0]
            yield between.join((*map(str, place), f"{found.chi2[place]:.7g}", found.fate(place))) + "\n"

    def show_place(self, place: Place | None) -> None:
        """Put the ring about a position; None: nowhere."""
        self.ring.setData([] if place is None else [place[2]], [] if place is None else [place[1]])

    def clear(self) -> None:
        """Show nothing."""
        self.places, self._tips, self._shown = (), {}, None
        self.dots.setData([])
        self.show_place(None)

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        theme_plot(self.graphics, self.plot)
        self.bar.apply_theme()
        self.bar.set_colours(theme_table(COLOURS))
        if self._shown is not None:
            self.show_plane(*self._shown)
        self.ring.setPen(pg.mkPen(current_theme().accent, width=2))

    def _clicked(self, _: Any, spots: Any, *__: Any) -> None:
        if len(spots):
            self.chosen.emit(spots[0].data())
