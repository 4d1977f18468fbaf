"""Comparison of two results of the gallery: two H by their values, other results by their facts."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from lfcal.base import LfcalError, format_plane
from lfcal_gui.comparing import Comparing
from lfcal_gui.context import Context
from lfcal_gui.models import Both, CompareRequest, Place, both_at, stamp_of, stated_order
from lfcal_gui.pages.sessions.model import Verdict, can_judge, fact_rows, pair_rows
from lfcal_gui.pages.sessions.panel import SessionsPanel

if TYPE_CHECKING:
    from lfcal.judge import Pair, StoredResult

NONE = "One of the two files no longer exists."


class Pairing(Comparing):
    """Comparison of the two selected results.

    Parameters
    ----------
    panel, context
        Panel that shows the comparison, and context of the window.
    """

    def __init__(self, panel: SessionsPanel, context: Context) -> None:
        super().__init__(panel.compare, context, "sessions")
        self._whole = panel
        self._files: tuple[str, str] = ("", "")
        self._by_number = False
        self._pair: Pair | None = None
        context.matrices.changed.connect(self._matrix_changed)

    def request(self) -> CompareRequest | None:
        """Return the request to compare the two files; None if one is missing."""
        first, second = (stamp_of(path) for path in self._files)
        if first is None or second is None:
            return None
        state = self._context.state
        orders = stated_order(state, first[0]), stated_order(state, second[0])
        return CompareRequest(first, second, self._by_number, orders)

    def missing(self) -> str:
        """Return the message for a file that no longer exists."""
        return NONE

    def pairing_chosen(self, by_number: bool) -> None:
        """Pair planes by number or by depth, as chosen."""
        self._by_number = by_number
        self.follow()

    def begin(self, first: StoredResult, second: StoredResult, verdicts: dict[Path, Verdict]) -> None:
        """Compare two results, and show the comparison."""
        if can_judge(first) and can_judge(second):
            self._forget()
            self._files = str(first.path), str(second.path)
            self._whole.compare.show_second(second.name, by_number=self._by_number)
            self._whole.show_compared()
            self.follow()
            self.compare()
            return
        names = _names(first.path, second.path)

        def read() -> list[tuple[str, str, str, str]]:
            from lfcal.judge import detailed

            return pair_rows(*(fact_rows(detailed(one), verdicts) for one in (first, second)))

        def refused(words: str) -> None:
            self._context.message.emit(words)
            self._whole.show_pair(names, pair_rows(fact_rows(first, verdicts), fact_rows(second, verdicts)))

        self._context.jobs.drop("sessions pair")
        self._context.jobs.load("sessions pair", read, lambda rows: self._whole.show_pair(names, rows), refused)

    def release(self) -> None:
        """Discard the comparison, and stop a running one."""
        super().release()
        self._pair = None

    def show_place(self, place: Place) -> None:
        """Show a position of both H."""
        from lfcal.judge.report import map_levels

        found, panel = self.found, self._whole.compare
        if found is None:
            return
        self._place = place
        k = place[0]
        plane = format_plane(found.planes[k].depths_um[0], found.planes[k].planes[0], "z")
        error = 100 * found.error[k]
        panel.show_map(k, f"Difference by position, {plane}", error, map_levels(error))
        pair = self._opened()
        if pair is None:
            return
        where = f"at ({found.pair.planes[k][0]}, {place[1]}, {place[2]})"

        def read(both: Both) -> None:
            if self.found is found:
                panel.show_both(both, where)

        def failed(words: str) -> None:
            if self._pair is pair:  # else the files changed meanwhile
                self._context.message.emit(words)

        self._context.jobs.compute("sessions both", lambda: both_at(pair, place), read, failed)

    def _opened(self) -> Pair | None:
        """Return both H if they are open in the window, else None."""
        from lfcal.judge import pair

        if self._pair is None and self._asked is not None:
            a, b = (self._context.matrix(path) for path in (self._asked.first[0], self._asked.second[0]))
            if a is not None and b is not None:
                try:
                    self._pair = pair(a, b, by_number=self._asked.by_number)
                except LfcalError:  # the files were replaced since the comparison; `follow` discards it
                    return None
        return self._pair

    def _matrix_changed(self, path: str) -> None:
        if self._asked is not None and path in (self._asked.first[0], self._asked.second[0]):
            self._pair = None
            if self.found is not None:
                self.show_place(self._place)

    def let_go(self) -> None:
        """Discard the comparison, and close its files."""
        self.release()
        self._forget()
        self._files = ("", "")

    def _forget(self) -> None:
        """Close the compared files, except those of the project."""
        state = self._context.state
        for path in self._files:
            if path and path not in (state.psf, state.reference):
                self._context.forget(path)


def _names(first: Path, second: Path) -> tuple[str, str]:
    """Return the names of two results, with their folders if the names are equal."""
    if first.name != second.name:
        return first.name, second.name
    return f"{first.parent.name}/{first.name}", f"{second.parent.name}/{second.name}"
