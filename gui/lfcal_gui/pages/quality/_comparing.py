"""Quality: compare the project's H with a second one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from PySide6.QtWidgets import QFileDialog

from lfcal_gui.comparing import READY, Comparing
from lfcal_gui.context import Context
from lfcal_gui.models import CompareRequest, stamp_of, stated_order
from lfcal_gui.pages.quality.model import QualitySettings
from lfcal_gui.widgets import ComparePanel

__all__ = ["ProjectComparing"]

FILES = "H files (*.h5 *.npy *.mat *.lfc);;All files (*)"
NONE = "Choose a second H to compare with this one: of another day, a simulation, or the H of a fit."


class ProjectComparing(Comparing):
    """Compares the project's H with its second H.

    Parameters
    ----------
    panel, context
        What shows it, and the window.
    """

    def __init__(self, panel: ComparePanel, context: Context) -> None:
        super().__init__(panel, context, "quality")
        panel.choose_asked.connect(self.choose)
        panel.show_message(NONE)
        self.follow()

    def request(self) -> CompareRequest | None:
        """Return both files of the project."""
        state = self._context.state
        first, second = stamp_of(state.psf), stamp_of(state.reference)
        settings = QualitySettings.of(state)
        orders = stated_order(state, state.psf), stated_order(state, state.reference)
        return None if first is None or second is None else CompareRequest(first, second, settings.by_number, orders)

    def missing(self) -> str:
        """Return what to choose, or what is gone."""
        state = self._context.state
        return f"{Path(state.reference).name} is not there any more." if state.reference and state.psf else NONE

    def follow(self) -> None:
        """Show what belongs to the two H of now."""
        state = self._context.state
        self._panel.show_second(Path(state.reference).name, by_number=QualitySettings.of(state).by_number)
        super().follow()

    def let_go(self) -> None:
        """Forget what was compared in another project."""
        self.release()
        self._panel.show_message(NONE)

    def choose(self, path: str = "") -> None:
        """Take a second H, and compare with it."""
        path = path or QFileDialog.getOpenFileName(self._panel, "Open a second H", "", FILES)[0]
        if not path:
            return
        # known to be good before the project takes it
        self._panel.show_message(f"Opening {Path(path).name} …")

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
            self._panel.show_message(f"{words}\nThe second H is {old} as before. {READY}" if old else words)

        self._context.matrices.take(path, taken, refused)

    def pairing_chosen(self, by_number: bool) -> None:
        """Keep in the project how planes are paired."""
        state = self._context.state
        settings = replace(QualitySettings.of(state), by_number=by_number)
        self._context.project.update("how planes are paired", settings=settings.into(state))
        self.follow()
