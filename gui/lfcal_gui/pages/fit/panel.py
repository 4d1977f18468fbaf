"""Fit: choices on the left; verdict, patterns, parameters, findings and convergence on the right."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TypeVar

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import (
    QFrame,
    QHBoxLayout,
    QLabel,
    QProgressBar,
    QStackedWidget,
    QVBoxLayout,
    QWidget,
)

from lfcal.base import Progress
from lfcal.fit import FitProgress
from lfcal_gui.pages.fit._choices_panel import ChoicesPanel
from lfcal_gui.pages.fit._found_tabs import FoundTabs
from lfcal_gui.pages.fit.model_run import FoundFit, Place
from lfcal_gui.pages.fit.model_words import detail_of, merit_of, verdict_of
from lfcal_gui.pages.fit.patterns_view import PatternsView
from lfcal_gui.pages.fit.rounds_view import RoundsView
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets import card, name_controls

__all__ = ["FitPanel"]

V = TypeVar("V", bound=QWidget)

READY = "Press Fit (F5).\nGap, focal lengths, iris and aberrations are found from the recorded positions of H."


class FitPanel(QWidget):
    """The page's widgets.

    Signals
    -------
    place_asked(place)
        Show the pattern of a position (z, y, x).
    """

    place_asked = Signal(tuple)

    def __init__(self) -> None:
        super().__init__()
        self._found: FoundFit | None = None
        self.choices = ChoicesPanel()
        self.ready = QLabel(READY)
        self.ready.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self.ready.setWordWrap(True)
        self.ready.setProperty("role", "hint")
        self.stack = QStackedWidget()
        self.stack.addWidget(self.ready)
        right = QWidget()
        column = QVBoxLayout(right)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(8)
        column.addWidget(self._status_card())
        below, inner = card()
        inner.addWidget(self.stack)
        column.addWidget(below, 1)
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        row.setSpacing(8)
        row.addWidget(self.choices)
        row.addWidget(right, 1)

    @cached_property
    def running(self) -> RoundsView:
        """The rounds of a fit that is at work; made when one is."""
        return self._made(RoundsView())

    @cached_property
    def tabs(self) -> FoundTabs:
        """What a fit found; made when something was: pictures and plots are half of what the page takes."""
        tabs = self._made(FoundTabs())
        tabs.place_asked.connect(self.place_asked.emit)
        return tabs

    def _made(self, view: V) -> V:
        name_controls(view)
        self.stack.addWidget(view)
        return view

    def _status_card(self) -> QFrame:
        self.status, column = card()
        self.verdict, self.detail = QLabel(), QLabel()
        self.bar = QProgressBar()
        self.bar.setTextVisible(False)
        for label, role in ((self.verdict, "value"), (self.detail, "hint")):
            label.setWordWrap(True)
            label.setTextFormat(Qt.TextFormat.PlainText)
            label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
            label.setProperty("role", role)
            column.addWidget(label)
        column.addWidget(self.bar)
        return self.status

    # -- states ----------------------------------------------------------------------------------------
    def resizeEvent(self, event: QResizeEvent) -> None:
        """Give the choices more width where there is more."""
        super().resizeEvent(event)
        self.choices.fit_width(self.width())

    def show_ready(self, words: str = "", *, failed: bool = False) -> None:
        """Show that nothing was fitted yet; ``words``: why not, as an error where it ``failed``."""
        self._forget()
        self._say(words, "", "bad" if failed else "")
        self.stack.setCurrentWidget(self.ready)

    def show_running(self, words: str, record: Progress | None, rounds: Sequence[FitProgress]) -> None:
        """Show how far a fit is."""
        self._say(words, "", "")
        self.bar.show()
        total = 0 if record is None else record.total
        self.bar.setRange(0, total)
        if record is not None and total:
            self.bar.setValue(record.done)
        self.running.show_rounds(rounds)
        self.stack.setCurrentWidget(self.running)

    def show_found(self, found: FoundFit, rounds: Sequence[FitProgress], note: str = "") -> None:
        """Show what a fit found; ``note``: what was done or chosen since."""
        if found is not self._found:
            self._found = found
            self.tabs.show_found(found, rounds)
        self._say(verdict_of(found.fit), "\n".join(filter(None, (detail_of(found), note))), merit_of(found.fit))
        self.stack.setCurrentWidget(self.tabs)

    def _say(self, words: str, detail: str, merit: str) -> None:
        theme = current_theme()
        colour = {"good": theme.good, "fair": theme.fair, "bad": theme.bad}.get(merit, theme.text)
        self.verdict.setText(words)
        self.verdict.setStyleSheet(f"color: {colour};")
        self.detail.setText(detail)
        self.detail.setVisible(bool(detail))
        self.bar.hide()
        self.status.setVisible(bool(words))

    def _forget(self) -> None:
        if self._found is not None:
            self._found = None
            self.tabs.forget()

    def show_place(self, place: Place) -> None:
        """Show the pattern of a position (z, y, x) of a fit, if there is one."""
        if self._found is not None:
            self.tabs.show_place(place)

    def on_patterns(self, action: Callable[[PatternsView], object]) -> None:
        """Do something with the patterns of a fit, if there is one."""
        if self._found is not None:
            action(self.tabs.patterns)

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        for k in range(self.stack.count()):
            view = self.stack.widget(k)
            if isinstance(view, RoundsView | FoundTabs):
                view.apply_theme()
