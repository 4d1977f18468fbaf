"""Comparison of the project's H with a second H."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PySide6.QtCore import QTimer
from PySide6.QtWidgets import QFileDialog, QVBoxLayout

from lfcal_gui.comparing import READY, Comparing
from lfcal_gui.models import CompareRequest, Place, ProjectState, stamp_of, stated_order
from lfcal_gui.pages.h.model import PositionMap
from lfcal_gui.pages.h.model_checks import QualitySettings
from lfcal_gui.widgets import ComparedNumbers, choice_box, line

FILES = "H files (*.h5 *.npy *.mat *.lfc);;All files (*)"
NONE = "Choose a second H to compare with this one: from another day, from a simulation, or from a fit."


SHOWN = (("measured", "this H"), ("reference", "the other H"), ("blink", "both, alternating"))
"""Contents of the pictures of H and HT, with their displayed names."""

BLINK_MS = 600


class ProjectComparing(Comparing):
    """Comparison of the project's H with a second H; the pictures of the page can show the patterns of either.

    Parameters
    ----------
    page
        The page H.
    """

    def __init__(self, page: Any) -> None:
        self.view = ComparedNumbers()
        super().__init__(self.view, page.context, page.spec.key)
        self._host = page
        self.shown = choice_box(
            SHOWN,
            "H in the images. Alternate to see shifts; use the view Difference to see missing light",
            "H that is shown",
        )
        self.shown.currentIndexChanged.connect(lambda _: self._show_other())
        column = self.view.layout()
        assert isinstance(column, QVBoxLayout)
        column.insertLayout(3, line("Images show", self.shown, stretch=1))
        self.blinking = QTimer(self.view, interval=BLINK_MS)
        self.blinking.timeout.connect(self._blink)
        self.view.choose_asked.connect(self.choose)
        self.view.show_message(NONE)
        self.follow()

    def entered(self) -> None:
        """Discard the comparison if the files have changed."""
        self.follow()

    begin = Comparing.compare

    def _show_buttons(self) -> None:
        super()._show_buttons()
        self._host.show_levels()

    # -- pictures --------------------------------------------------------------------------------------
    def _show_other(self) -> None:
        """Show the first H, the second, or both alternately."""
        shown = self.shown.currentData()
        self.blinking.stop()
        self._host.set_intent(show="reference" if shown == "reference" else "measured")
        if shown == "blink":
            self.blinking.start()

    def _blink(self) -> None:
        if not self._host.isVisible():
            return
        self._host.set_intent(show="measured" if self._host.intent.show == "reference" else "reference")

    def show_place(self, place: Place) -> None:
        """Show a compared position in the pictures; its first index counts the compared planes."""
        found = self.found
        if found is not None:
            self._place = place
            self.view.show_worst(place)
            self._host.set_intent(z=found.planes[place[0]].planes[0], y=place[1], x=place[2])
            self._host.show_map()

    def map_at(self, z: int) -> PositionMap | None:
        """Return the map of the differences in a plane; positions that were not compared are crossed out."""
        from lfcal.judge.report import map_levels

        found = self.found
        k = None if found is None else next((k for k, one in enumerate(found.planes) if one.planes[0] == z), None)
        if found is None or k is None:
            return None
        error = 100 * found.error[k]
        missing = np.argwhere(~np.isfinite(error))
        return PositionMap("Difference by position", error, "%", missing, name="difference", levels=map_levels(error))

    def request(self) -> CompareRequest | None:
        """Return the request to compare both files of the project; None if one is missing."""
        state = self._context.state
        first, second = stamp_of(state.psf), stamp_of(state.reference)
        settings = QualitySettings.of(state)
        orders = stated_order(state, state.psf), stated_order(state, state.reference)
        return None if first is None or second is None else CompareRequest(first, second, settings.by_number, orders)

    def missing(self) -> str:
        """Return which file must be chosen, or which no longer exists."""
        state = self._context.state
        return f"{Path(state.reference).name} no longer exists." if state.reference and state.psf else NONE

    def state_changed(self, old: ProjectState, new: ProjectState) -> None:
        """Update the view if the files or the order of their axes changed."""
        orders = [[stated_order(state, path) for path in (new.psf, new.reference)] for state in (old, new)]
        if (old.psf, old.reference) != (new.psf, new.reference) or orders[0] != orders[1]:
            self.follow()

    def follow(self) -> None:
        """Show the data of the current two H."""
        state = self._context.state
        self.shown.setEnabled(bool(state.reference))
        self.view.show_second(Path(state.reference).name, by_number=QualitySettings.of(state).by_number)
        super().follow()

    def let_go(self) -> None:
        """Discard the comparison of the previous project."""
        self.release()
        self.view.show_message(NONE)

    @property
    def row_words(self) -> str:
        """Name of the second H, or its difference from H once they are compared, for the inspector."""
        found, other = self.found, Path(self._context.state.reference).name
        return other if found is None else f"difference {100 * found.all.scaled:.3g} %"

    def choose(self, path: str = "") -> None:
        """Choose a second H, and compare with it."""
        path = path or QFileDialog.getOpenFileName(self.view, "Open a second H", "", FILES)[0]
        if not path:
            return
        # known to be good before the project takes it
        self.view.show_message(f"Opening {Path(path).name} …")

        begun = self._context.project.begun

        def taken() -> None:
            if begun != self._context.project.begun:  # the project it was opened for is no longer open
                if path not in (self._context.state.psf, self._context.state.reference):
                    self._context.forget(path)
                return
            self._context.project.update("second H", reference=path)
            self.follow()
            self.compare()

        def refused(words: str) -> None:
            if begun != self._context.project.begun:
                return
            self._asked = None
            self.follow()
            old = Path(self._context.state.reference).name
            self.view.show_message(f"{words}\nThe second H is {old} as before. {READY}" if old else words)

        self._context.matrices.take(path, taken, refused)

    def pairing_chosen(self, by_number: bool) -> None:
        """Store in the project how planes are paired."""
        state = self._context.state
        settings = replace(QualitySettings.of(state), by_number=by_number)
        self._context.project.update("how planes are paired", settings=settings.into(state))
        self.follow()
