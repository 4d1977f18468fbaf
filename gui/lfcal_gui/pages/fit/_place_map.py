"""chi² of the patterns of a plane at their positions in the period; a click chooses one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from PySide6.QtCore import Signal

from lfcal_gui.models import Shot, Symbols
from lfcal_gui.pages.fit.model_run import FoundFit, Place
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets import Picture, table_entries, theme_table

__all__ = ["PlaceMap"]

SYMBOLS = {"fitted": "o", "kept aside": "s", "left out": "x"}
COLOURS = "cividis"
LEAST = (0.8, 1.5)
"""χ² at the ends of the colours, at least: what noise alone scatters is no pattern."""


class PlaceMap(Picture):
    """A mark for each pattern: round where it was fitted, square where it was kept aside, a cross where left out.

    Signals
    -------
    chosen(place)
        The mark of a position (z, y, x) was clicked.
    """

    chosen = Signal(tuple)

    def __init__(self) -> None:
        self.places: tuple[Place, ...] = ()
        self._found: FoundFit | None = None
        super().__init__("χ²", axes=("source x (px)", "source y (px)"), colour_map=COLOURS)
        self.box.setMouseEnabled(False, False)
        self.setToolTip("Click a position to see its pattern")
        self.clicked.connect(self._choose)
        self.hovered.connect(self._tip)

    def show_plane(self, found: FoundFit, z: int) -> None:
        """Show the patterns of a plane; colours mean the same in all planes."""
        self._found = found
        self.places = tuple(place for place in found.places if place[0] == z)
        kept = [value for place, value in found.chi2.items() if found.fate(place) != "left out"]
        low, high = (min(LEAST[0], *kept), max(LEAST[1], *kept)) if kept else LEAST
        table = theme_table(COLOURS)

        def colour(place: Place) -> str:
            if found.fate(place) == "left out":
                return current_theme().bad
            share = float(np.clip((found.chi2[place] - low) / (high - low), 0, 1))
            return "#{:02x}{:02x}{:02x}".format(*table[round(255 * share)][:3])

        overlays = []
        for fate, symbol in SYMBOLS.items():
            shown = [place for place in self.places if found.fate(place) == fate]
            points = np.array([place[1:] for place in shown], float).reshape(-1, 2)
            overlays.append(Symbols(points, symbol, [colour(place) for place in shown], 9, filled=symbol != "x"))
        ground = np.full(found.measured.plan.period, np.nan)
        self.set_shot(Shot(ground, name="chi2", levels=(low, high), overlays=tuple(overlays)))

    def show_place(self, place: Place | None) -> None:
        """Point out a position; None: none."""
        self.set_cross(*((None, None) if place is None else place[1:]))

    def clear(self) -> None:
        """Show nothing."""
        self.places, self._found = (), None
        self.set_shot(None)

    def entries(self) -> list[tuple[str, Callable[[], Any]]]:
        """Return what a menu offers."""
        return table_entries(self, "chi2", self._lines) if self._found is not None else []

    def _lines(self, between: str) -> Iterator[str]:
        """Yield χ² and the fate of each pattern of the plane."""
        assert self._found is not None
        yield between.join(("z", "y", "x", "chi2", "fate")) + "\n"
        for place in self.places:
            yield between.join((*map(str, place), f"{self._found.chi2[place]:.7g}", self._found.fate(place))) + "\n"

    def _nearest(self, row: int, column: int) -> Place | None:
        """Return the position whose mark is nearest, where it is no farther than its size."""
        units = self.box.viewRect().width() / max(1.0, self.box.width())
        near = [(float(np.hypot(y - row, x - column)), (z, y, x)) for z, y, x in self.places]
        distance, place = min(near, default=(np.inf, None))
        return place if distance <= max(0.75, 9 * units) else None

    def _choose(self, row: int, column: int) -> None:
        place = self._nearest(row, column)
        if place is not None:
            self.chosen.emit(place)

    def _tip(self, row: int, column: int, _: float) -> None:
        found, place = self._found, self._nearest(row, column) if row >= 0 else None
        if found is None or place is None:
            self.setToolTip("Click a position to see its pattern")
        else:
            self.setToolTip(f"y {place[1]}, x {place[2]}\nχ² {found.chi2[place]:.3g}\n{found.fate(place)}")
