"""The search for filters and masks: a job, and what becomes of what it finds."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from PySide6.QtCore import QObject, Signal

from lfcal.base import LfcalError
from lfcal.multiplex import parse_pattern, save_modulator
from lfcal_gui.context import Context
from lfcal_gui.jobs import JobState, WindowJob
from lfcal_gui.models import ProjectState
from lfcal_gui.pages.multiplex.model import MultiplexSettings
from lfcal_gui.pages.multiplex.model_fields import SEARCH_FIELDS, TYPED
from lfcal_gui.pages.multiplex.model_search import iter_search
from lfcal_gui.pages.multiplex.search_view import SearchView
from lfcal_gui.saving import ask_target

__all__ = ["Searching"]

DESIGNS = "With views and colours (*.json);;Transmissions alone (*.npy)"


class Searching(QObject):
    """What the buttons of the search do; ``used`` is sent when the project has taken what was found."""

    used = Signal()

    def __init__(self, context: Context, view: SearchView) -> None:
        super().__init__(view)
        self.context, self.view = context, view
        self._job = 0
        self._wishes: tuple[Any, ...] = ()
        view.search_asked.connect(self.search)
        view.use_asked.connect(self.use_found)
        view.save_asked.connect(self.save_found)
        context.jobs.finished.connect(self._finished)

    def search(self) -> None:
        """Search as a job; one at work is stopped."""
        if refused := self.view.form.error:
            self.view.show_found(None)
            self.view.show_status(refused, bad=True)
            return
        settings, sensor = MultiplexSettings.of(self.context.state), self.context.state.camera.sensor
        if self._job:
            self.context.jobs.cancel(self._job)
        self.view.show_found(None)
        self.view.show_status("searching …")
        self._wishes = _wishes(self.context.state)
        self._job = self.context.jobs.start(
            "Search filters and masks",
            "multiplex",
            lambda: iter_search(settings, sensor),
            self.view.show_found,
            leave=True,
            at_once=True,
        )

    def follow(self, state: ProjectState) -> None:
        """Show no design that was found for other wishes or another sensor, and look for none."""
        if self._wishes and self._wishes != _wishes(state):
            job, self._job, self._wishes = self._job, 0, ()
            self.context.jobs.cancel(job)
            self.view.show_found(None)

    def use_found(self) -> None:
        """Take the found filters as the own pattern; a mask is written to a file and named."""
        found = self.view.found
        if found is None:
            return
        modulator = found.design.modulator
        if modulator.colours:
            self._take("filters", family="cfa", cfa=TYPED, pattern="/".join(parse_pattern(modulator.name)))
        elif path := self.save_found():
            self._take("mask", family="written", written=path, reference_written=f"pinhole:{modulator.side[0]}")

    def save_found(self) -> str:
        """Ask where to, and write the design; return its path, empty where none was written."""
        found = self.view.found
        path = ask_target(self.view, "Save design", "design.json", DESIGNS) if found else ""
        if found is None or not path:
            return ""
        try:
            save_modulator(found.design.modulator, path)
        except LfcalError as error:
            self.context.message.emit(str(error))
            self.view.show_status(str(error), bad=True)
            return ""
        self.view.show_status(f"written to {path}")
        return path

    def _take(self, what: str, **changes: str) -> None:
        settings = replace(MultiplexSettings.of(self.context.state), **changes)
        self.context.project.update(f"use the search's {what}", settings=settings.into(self.context.state))
        self.used.emit()

    def _finished(self, job: WindowJob) -> None:
        if job.number == self._job:
            self._job = 0
            if job.state is not JobState.DONE:
                self.view.show_status(job.error or "stopped", bad=bool(job.error))


def _wishes(state: ProjectState) -> tuple[Any, ...]:
    """Return all that a search depends on."""
    settings = MultiplexSettings.of(state)
    keys = ("gain", *(field.key for field in SEARCH_FIELDS))
    return (*(getattr(settings, key) for key in keys), state.camera.sensor)
