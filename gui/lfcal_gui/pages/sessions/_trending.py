"""Sessions: the quality reports of the gallery over time, and what is chosen of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from lfcal_gui.context import Context
from lfcal_gui.pages.sessions.model_trend import curve_of, merits_of, rows_of, trend_of, trend_words
from lfcal_gui.pages.sessions.trend_panel import TrendPanel
from lfcal_gui.saving import ask_target

if TYPE_CHECKING:
    from lfcal.judge import StoredResult, Trend

__all__ = ["Trending"]

PICTURES = "Pictures (*.png *.svg)"


class Trending:
    """What got worse over the reports of the gallery.

    Parameters
    ----------
    panel, context
        What shows it, and the window.
    """

    def __init__(self, panel: TrendPanel, context: Context) -> None:
        self._panel, self._context = panel, context
        self.found: Trend | None = None
        self._asked: Sequence[StoredResult] | None = None
        panel.picture_asked.connect(self.save_picture)
        panel.row_chosen.connect(self._row_chosen)

    def show_results(self, reports: Sequence[StoredResult]) -> None:
        """Read these reports, unless they are shown."""
        if reports == self._asked:
            return
        self.found, self._asked = None, reports
        folders = [Path(one.path) for one in reports]
        self._panel.show_message("Reading …")
        self._context.jobs.drop("sessions trend")
        self._context.jobs.load("sessions trend", lambda: trend_of(folders), self._read, self._panel.show_message)

    def _read(self, found: Trend) -> None:
        self.found = found
        self.show()

    def show(self) -> None:
        """Show what was read."""
        if self.found is not None:
            self._panel.show_rows(trend_words(self.found), rows_of(self.found), merits_of(self.found))

    def _row_chosen(self, row: int) -> None:
        if self.found is not None and row >= 0:
            self._panel.show_curve(curve_of(self.found, row))

    def save_picture(self, path: str = "") -> None:
        """Draw all courses into a file; without one it is asked for."""
        from lfcal.judge import draw_trend

        found = self.found
        if found is None:
            return
        path = path or ask_target(self._panel, "Save picture", "trend.png", PICTURES)
        if path:  # it appears whole or not at all
            self._context.jobs.compute(
                "sessions trend picture",
                lambda: draw_trend(found, path),
                lambda _: self._context.message.emit(f"picture written: {path}"),
            )
