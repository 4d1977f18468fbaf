"""Search for a modulator: objective, constraints, and the design found with its certificate."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any

from PySide6.QtCore import QObject, Signal
from PySide6.QtGui import QShowEvent
from PySide6.QtWidgets import QGridLayout, QHBoxLayout, QLabel, QPushButton, QWidget

from lfcal.base import LfcalError
from lfcal.multiplex import parse_pattern, save_modulator
from lfcal_gui.context import Context
from lfcal_gui.jobs import JobState, WindowJob
from lfcal_gui.models import ProjectState, Shot
from lfcal_gui.pages.multiplex.model import SEARCH_FIELDS, TYPED, MultiplexSettings
from lfcal_gui.pages.multiplex.model_compare import FoundDesign, iter_search
from lfcal_gui.saving import ask_target
from lfcal_gui.widgets import FoldedForm, Picture, button, card, name_controls, set_role


class SearchView(QWidget):
    """View with constraints on the left and the design on the right."""

    search_asked, use_asked, save_asked = Signal(), Signal(), Signal()
    """Requests to search, to use the design as the page's modulator, and to save it to a file."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.found: FoundDesign | None = None
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 8, 0, 0)
        row.setSpacing(8)
        frame, column = card("Search")
        frame.setFixedWidth(270)
        self.form = FoldedForm(
            SEARCH_FIELDS[:1], SEARCH_FIELDS[1:], "Constraints", "Limits of manufacturing and transmission"
        )
        column.addWidget(self.form)
        self.buttons: dict[str, QPushButton] = {}
        tips = (
            ("Search", "Search for the design with the largest gain for the project's camera", self.search_asked),
            ("Use", "Use the design as the modulator of this page", self.use_asked),
            (
                "Save …",
                "Save the design: .json with its views, .npy with its transmissions only (rows, columns, samples)",
                self.save_asked,
            ),
        )
        for title, tip, signal in tips:
            one = button(title, tip)
            one.clicked.connect(lambda _=False, signal=signal: signal.emit())
            column.addWidget(one)
            self.buttons[title] = one
        self.buttons["Search"].setProperty("role", "primary")
        column.addStretch(1)
        row.addWidget(frame)
        row.addWidget(self._result(), 1)
        self.show_found(None)

    def _result(self) -> QWidget:
        frame, column = card("Design")
        self._design = column
        inner = QWidget()
        self.words = QGridLayout(inner)
        self.words.setColumnStretch(1, 1)
        column.addWidget(inner)
        self.status = QLabel("", wordWrap=True)
        self.status.setProperty("role", "hint")
        column.addWidget(self.status)
        return frame

    @cached_property
    def view(self) -> Picture:
        """Picture of the design, which is created when it is first shown."""
        made = Picture("transmission (1)", axes=("column (px)", "row (px)"))
        made.setToolTip(
            "Transmission of each pixel of the super-pixel for the middle view; filters are shown in their colour"
        )
        made.blank.words = "Press Search to find a design."
        self._design.insertWidget(1, made, 1)
        name_controls(self)
        return made

    def showEvent(self, event: QShowEvent) -> None:
        """Create the picture when the view is first shown."""
        self.view.show()
        super().showEvent(event)

    def show_status(self, words: str, *, bad: bool = False) -> None:
        """Show a status text, or why there is no design."""
        set_role(self.status, "error" if bad else "hint")
        self.status.setText(words)

    def show_found(self, found: FoundDesign | None) -> None:
        """Show a design. None: clear the view."""
        self.found = found
        for title in ("Use", "Save …"):
            self.buttons[title].setEnabled(found is not None)
            self.buttons[title].setVisible(found is not None)
        while self.words.count():
            item = self.words.takeAt(0)
            widget = None if item is None else item.widget()
            if widget is not None:
                widget.hide()
                widget.deleteLater()
        if found is None:
            if "view" in self.__dict__:
                self.view.set_shot(None)
            self.show_status("Search for the filters or the mask with the largest gain for the project's camera.")
            return
        self.show_status("")
        pattern = found.design.modulator.pattern()
        values = pattern if found.design.modulator.colours else pattern[..., 0]
        self.view.set_shot(Shot(values, name="design", levels=(0.0, 1.0)))
        for k, (name, value) in enumerate(found.words):
            for column, text in enumerate((name, value)):
                label = QLabel(text, wordWrap=column == 1)
                self.words.addWidget(label, k, column)

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        if "view" in self.__dict__:
            self.view.apply_theme()


DESIGNS = "With views and colours (*.json);;Transmissions only (*.npy)"


class Searching(QObject):
    """Controller of the search; ``used`` is emitted when the project uses the design."""

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
        """Search as a job; a running search is stopped."""
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
        """Discard a design found for other constraints or another sensor, and stop such a search."""
        if self._wishes and self._wishes != _wishes(state):
            job, self._job, self._wishes = self._job, 0, ()
            self.context.jobs.cancel(job)
            self.view.show_found(None)

    def use_found(self) -> None:
        """Use the found filters as the page's pattern; a mask is saved to a file, whose path is used."""
        found = self.view.found
        if found is None:
            return
        modulator = found.design.modulator
        if modulator.colours:
            self._take("filters", family="cfa", cfa=TYPED, pattern="/".join(parse_pattern(modulator.name)))
        elif path := self.save_found():
            self._take("mask", family="written", written=path, reference_written=f"pinhole:{modulator.side[0]}")

    def save_found(self) -> str:
        """Save the design to a file chosen by the user, and return its path; empty if it was not saved."""
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
    """Return everything on which a search depends."""
    settings = MultiplexSettings.of(state)
    keys = ("gain", *(field.key for field in SEARCH_FIELDS))
    return (*(getattr(settings, key) for key in keys), state.camera.sensor)
