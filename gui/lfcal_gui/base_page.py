"""What all pages have: title, hint, body, empty state."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QKeySequence, QShortcut, QShowEvent
from PySide6.QtWidgets import QDialog, QHBoxLayout, QMenu, QPushButton, QStackedWidget, QVBoxLayout, QWidget

from lfcal_gui.context import Context
from lfcal_gui.models import PageSpec, PageState, ProjectState
from lfcal_gui.notice import Notice
from lfcal_gui.theme import current_theme, style_sheet
from lfcal_gui.widgets import INSPECTOR, ElidedLabel, WrappedLabel, button, column_of, toggle_in, whole_page

Deed = tuple[str, Callable[[], object] | Mapping[str, Callable[[], object]]]
"""What a button of an empty state does: when one would press it (its tip), and the action, or a menu of actions."""


HEADER = 28
"""Height of a header, also of one without buttons (px)."""

MARKS = {PageState.RUNNING: " …", PageState.ATTENTION: " ▲"}
"""Marks after the name of a view."""

NO_LONGER = "Stop waiting for this file. It stays in the project and can be opened later"


class EmptyState(QWidget):
    """What is shown where there is nothing yet: what to do next, and the button that does it."""

    def __init__(self, text: str, buttons: dict[str, Deed] | None = None, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        layout = QVBoxLayout(self)
        layout.addStretch()
        self.label = WrappedLabel(text, role="hint")
        self.label.setAlignment(Qt.AlignmentFlag.AlignCenter)
        layout.addWidget(self.label)
        row = QHBoxLayout()
        row.addStretch()
        for title, (tip, action) in (buttons or {}).items():
            one = button(title, tip, action if callable(action) else None)
            if not callable(action):
                menu = QMenu(one)
                for name, choice in action.items():
                    menu.addAction(name).triggered.connect(lambda _=False, choice=choice: choice())
                one.setMenu(menu)
            row.addWidget(one)
        row.addStretch()
        layout.addLayout(row)
        layout.addStretch()


class BasePage(QWidget):
    """A page: a header with title, hint and tools, and a body that is replaced by an empty state if need be."""

    theme_changed = Signal()
    """Colours changed, and the page is seen; plots redraw."""

    def __init__(self, spec: PageSpec, context: Context) -> None:
        super().__init__()
        self.spec, self.context = spec, context
        self.setFocusPolicy(Qt.FocusPolicy.ClickFocus)
        outer = QVBoxLayout(self)
        outer.setContentsMargins(8, 4, 8, 4)
        outer.setSpacing(4)
        outer.addLayout(self._header())
        self.notice = Notice()
        self._stack = QStackedWidget()
        self.body = QWidget()
        whole_page(self.body)
        self._stack.addWidget(self.body)
        self.empty: EmptyState | None = None
        outer.addWidget(self._stack, 1)
        self._begun = context.project.begun
        context.state_changed.connect(self._follow_project)
        context.refused.connect(self._say_refused)
        self._theme = current_theme()
        context.theme_changed.connect(self._theme_changed)
        self.shortcut("F", lambda: toggle_in(self))
        self.shortcut("A", self.set_automatic_contrast)
        self.shortcut("Ctrl+I", self.toggle_inspector)

    def _header(self) -> QHBoxLayout:
        self.views: dict[PageSpec, QPushButton] = {}
        self.segments = QHBoxLayout()
        self.segments.setSpacing(0)
        self.hint = ElidedLabel(self.spec.hint, sentence=True, role="hint")
        self.tools = QHBoxLayout()
        self.header = header = QHBoxLayout()
        header.addStrut(HEADER)
        header.addLayout(self.segments)
        header.addSpacing(8)
        header.addWidget(self.hint, 1)
        header.addLayout(self.tools)
        return header

    def set_views(self, views: Sequence[PageSpec]) -> None:
        """Offer the views of the place that this page is one of, at the left of the header."""
        for number, spec in enumerate(views if len(views) > 1 else (), 1):
            one = QPushButton(spec.title)
            one.setProperty("role", "segment")
            one.setCheckable(True)
            one.setChecked(spec is self.spec)
            one.setToolTip(f"{spec.hint} (Alt+{number})")
            one.clicked.connect(lambda _=False, b=one, own=spec is self.spec: b.setChecked(own))
            one.clicked.connect(lambda _=False, key=spec.key: self.context.go.emit(key, None))
            self.segments.insertWidget(number - 1, one)
            self.views[spec] = one
        if self.views and self.segments.count() > len(self.views):
            self.segments.insertSpacing(len(self.views), 12)  # the views of the page

    def mark_views(self, states: Mapping[str, PageState]) -> None:
        """Show at the names of the views which are at work, or need to be looked at."""
        for spec, one in self.views.items():
            one.setText(spec.title + MARKS.get(states[spec.key], ""))

    def _theme_changed(self) -> None:
        # an open dialog is seen without its page
        if self.isVisible() or any(dialog.isVisible() for dialog in self.findChildren(QDialog)):
            self.take_theme()

    def take_theme(self) -> None:
        """Take the colours of the theme in use, once: a page that is not seen does so when it is.

        A page is styled as a whole: a styled page would style each of its parts again whenever one is added.
        """
        theme = current_theme()
        if self.styleSheet() != style_sheet():
            self.setStyleSheet(style_sheet())
        if self._theme is not theme:
            self._theme = theme
            self.theme_changed.emit()

    def showEvent(self, event: QShowEvent) -> None:
        """Follow a change of the theme that came while the page was not seen."""
        self.take_theme()
        super().showEvent(event)

    def show_empty(self, text: str, buttons: dict[str, Deed] | None = None) -> None:
        """Show what to do next in place of the body."""
        self.show_body()
        self.empty = EmptyState(text, buttons)
        self._stack.addWidget(self.empty)
        self._stack.setCurrentWidget(self.empty)

    def lead(self, key: str, tip: str) -> Deed:
        """Return what a button does that leads to the page ``key``; ``tip``: what is done there."""
        return tip, lambda: self.context.go.emit(key, None)

    def show_body(self) -> None:
        """Show the body."""
        self._stack.setCurrentWidget(self.body)
        if self.empty is not None:
            self._stack.removeWidget(self.empty)
            self.empty.deleteLater()
            self.empty = None

    def show_no_matrix(self, path: str, text: str, buttons: dict[str, Deed]) -> None:
        """Show that the H of ``path`` is being opened, or why it cannot be; or ``text`` where neither is so."""
        matrices = self.context.matrices
        if matrices.opening(path):
            self.show_empty(f"Opening {Path(path).name} …", {"Cancel": (NO_LONGER, lambda: matrices.cancel(path))})
        elif matrices.problem(path):
            again = "Open this file again, when it is complete or its disk is connected", lambda: matrices.take(path)
            self.show_empty(matrices.problem(path), {"Try again": again, **buttons})
        elif path:
            self.show_empty(f"{Path(path).name} is being written. It will be shown when it is complete.")
        else:
            self.show_empty(text, buttons)

    def refuse(self, words: str) -> None:
        """Say on the page and in the log why something was refused."""
        self.notice.refuse(words)
        self.context.message.emit(words)

    def _say_refused(self, words: str) -> None:
        """Say on the page that is looked at why the project did not change."""
        if self.isVisible():
            self.notice.refuse(words)

    def load(
        self,
        what: str,
        function: Callable[[], Any],
        on_result: Callable[[Any], None],
        discard: Callable[[Any], None] | None = None,
        on_error: Callable[[str], None] | None = None,
    ) -> None:
        """Open ``what`` in the background. The page keeps its content until that succeeds.

        Any error is shown on the page, or passed to ``on_error``. The user may stop waiting; a result that arrives
        later is passed to ``discard``.
        """
        group = self._imports

        def opened(found: Any) -> None:
            self.notice.clear()
            on_result(found)

        self.notice.wait(f"Opening {what} …", lambda: self.context.jobs.drop(group))
        self.context.jobs.drop(group)  # it may hang
        self.context.jobs.load(group, function, opened, on_error or self.refuse, discard)

    @property
    def _imports(self) -> str:
        """What the page opens for the project."""
        return f"{self.spec.key} import"

    def tool_button(self, text: str, tip: str, action: Any) -> QPushButton:
        """Add a button to the header."""
        one = button(text, tip, lambda: action())
        self.tools.addWidget(one)
        return one

    def stop_tool(self, tip: str) -> QPushButton:
        """Add the button Stop (Esc): it stops every job of this page, and can be pressed while there is one."""
        one, jobs = self.tool_button("Stop", f"{tip} (Esc)", self.stop), self.context.jobs
        one.setEnabled(False)
        jobs.changed.connect(lambda _: self._show_stop(one))
        self.shortcut("Escape", self.stop)
        return one

    def _show_stop(self, one: QPushButton) -> None:
        """Show on the button immediately that the running job was asked to stop."""
        active = [job for job in self.context.jobs.jobs() if job.active and job.page == self.spec.key]
        stopping = bool(active) and all(job.stopping for job in active)
        one.setEnabled(bool(active))
        one.setText("Stopping …" if stopping else "Stop")

    def stop(self) -> None:
        """Stop every job of this page; what they made so far stays."""
        for job in self.context.jobs.jobs():
            if job.active and job.page == self.spec.key:
                self.context.jobs.cancel(job.number)

    def set_panel(self, panel: QWidget) -> None:
        """Make ``panel`` the body."""
        column_of(panel, of=self.body)

    def shortcut(self, keys: str, action: Callable[[], object]) -> None:
        """Do ``action`` when ``keys`` are pressed while the page is looked at."""
        shortcut = QShortcut(QKeySequence(keys), self)
        shortcut.setContext(Qt.ShortcutContext.WidgetWithChildrenShortcut)
        shortcut.activated.connect(action)

    def set_automatic_contrast(self) -> None:
        """Let the pictures that are seen fill the colours, all but the darkest and brightest pixels."""
        from lfcal_gui.widgets import Contrast

        for one in self.findChildren(Contrast):
            if one.isVisible():
                one.leave_out_tails()

    def toggle_inspector(self) -> None:
        """Hide what stands right of the pictures, or show it again."""
        areas = [one for one in self.findChildren(QWidget) if one.property(INSPECTOR)]
        shown = any(not one.isHidden() for one in areas)
        for one in areas:
            one.setVisible(not shown)
        if shown:
            self.hold_keyboard()

    def hold_keyboard(self) -> None:
        """Take the keyboard before what has it goes grey: shortcuts of a page work while it is in the page."""
        if self.isVisible():
            self.setFocus(Qt.FocusReason.OtherFocusReason)

    def do(self, name: str) -> bool:
        """Do what a button of the next step says; False where the page knows no such deed."""
        deed = self.deeds().get(name)
        if deed is not None:
            deed()
        return deed is not None

    def _follow_project(self, old: ProjectState, new: ProjectState) -> None:
        if self._begun != self.context.project.begun:
            self._begun = self.context.project.begun
            self.context.jobs.drop(self._imports)
            self.notice.clear()
            self.let_go()
        elif replace(old, settings=new.settings) != new:
            self.notice.drop_refusal()
        self.state_changed(old, new)

    # -- what pages override -----------------------------------------------------------------------------
    @property
    def part(self) -> str:
        """Which of several commands of the page is copied: the name of a part of it, empty where there is one."""
        return ""

    def let_go(self) -> None:
        """Release what belongs to the previous project. `state_changed` with the new project follows."""

    def state_changed(self, old: ProjectState, new: ProjectState) -> None:
        """Follow a change of the project."""

    def entered(self) -> None:
        """Prepare what is costly when the page is first looked at."""

    def deeds(self) -> dict[str, Callable[[], object]]:
        """Return what the next step may ask this page to do, by names."""
        return {}

    def receive(self, payload: Any) -> None:
        """Show what another page sent, such as a position."""

    @staticmethod
    def prepare() -> None:
        """Import what the page imports at first use; called in a background thread soon after the start."""

    def accept_drop(self, paths: list[str]) -> bool:
        """Take dropped files; False: not for this page."""
        return False


def page_class(spec: PageSpec) -> type[BasePage]:
    """Return the class of a page; imported only now, so that widgets and libraries of pages do not slow the start."""
    found: type[BasePage] = importlib.import_module(f"{spec.package}.page").Page
    return found
