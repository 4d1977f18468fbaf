"""Base class of all pages: title, hint, body, empty state."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Mapping, Sequence
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
"""Tooltip of a button of an empty state, and its action or a menu of actions."""


HEADER = 28
"""Height of a header, even without buttons (px)."""

MARKS = {PageState.RUNNING: " …", PageState.ATTENTION: " ▲"}
"""Marks after the name of a view."""

NO_LONGER = "Stop waiting for this file. It stays in the project and can be opened later"


class EmptyState(QWidget):
    """Placeholder of an empty page: what to do next, and buttons that do it.

    The first of several lines of ``text`` is the title.
    """

    def __init__(self, text: str, buttons: dict[str, Deed] | None = None, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        layout = QVBoxLayout(self)
        layout.addStretch()
        title, line, words = text.partition("\n")
        self.title = WrappedLabel(title.rstrip("."), role="title")
        self.label = WrappedLabel(words if line else text, role="hint")
        if not line:
            self.title.hide()  # never shown here: without a parent, it would be a window that takes the focus
        for label in (self.title, self.label):
            label.setAlignment(Qt.AlignmentFlag.AlignCenter)
            layout.addWidget(label)
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
    """Base of a page: a header with views, hint and tools, and a body that an empty state can replace."""

    theme_changed = Signal()
    """The theme changed, and the page is visible; plots redraw."""

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
        self._behind: ProjectState | None = None
        """State that the page shows, if it is an earlier one."""
        context.state_changed.connect(self._state_changed)
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

    @staticmethod
    def parts(context: Context) -> Iterator[QWidget]:
        """Make the parts of a large page, each of which is made in its own turn of the event loop.

        The last part is the panel of the page, which the class takes as its third parameter. Without parts, the
        page makes its panel itself.
        """
        return iter(())

    def set_views(self, views: Sequence[PageSpec], show: Callable[[str], object]) -> None:
        """Show buttons for the views of this page's place at the left of the header; ``show`` shows a page."""
        for number, spec in enumerate(views if len(views) > 1 else (), 1):
            one = QPushButton(spec.title)
            one.setProperty("role", "segment")
            one.setCheckable(True)
            one.setChecked(spec is self.spec)
            one.setToolTip(f"{spec.hint} (Alt+{number})")
            one.clicked.connect(lambda _=False, b=one, own=spec is self.spec: b.setChecked(own))
            one.clicked.connect(lambda _=False, key=spec.key: show(key))
            self.segments.insertWidget(number - 1, one)
            self.views[spec] = one
        if self.views and self.segments.count() > len(self.views):
            self.segments.insertSpacing(len(self.views), 12)  # the views of the page

    def mark_views(self, states: Mapping[str, PageState]) -> None:
        """Mark the names of views that have a running job or need attention."""
        for spec, one in self.views.items():
            one.setText(spec.title + MARKS.get(states[spec.key], ""))

    def _theme_changed(self) -> None:
        # an open dialog is seen without its page
        if self.isVisible() or any(dialog.isVisible() for dialog in self.findChildren(QDialog)):
            self.context.jobs.later(self.take_theme)

    def take_theme(self) -> None:
        """Apply the colours of the current theme. A hidden page does so when it is shown.

        The style sheet is set on the page as a whole; otherwise, Qt would style all parts again whenever one is added.
        """
        theme = current_theme()
        if self.styleSheet() != style_sheet():
            self.setStyleSheet(style_sheet())
        if self._theme is not theme:
            self._theme = theme
            self.theme_changed.emit()

    def showEvent(self, event: QShowEvent) -> None:
        """Apply a theme that changed while the page was hidden."""
        self.take_theme()
        super().showEvent(event)

    def show_empty(self, text: str, buttons: dict[str, Deed] | None = None) -> None:
        """Show what to do next in place of the body."""
        self.show_body()
        self.empty = EmptyState(text, buttons)
        self._stack.addWidget(self.empty)
        self._stack.setCurrentWidget(self.empty)

    def lead(self, key: str, tip: str) -> Deed:
        """Return the tooltip ``tip`` and the action of a button that opens the page ``key``."""
        return tip, lambda: self.context.go.emit(key, None)

    def show_body(self) -> None:
        """Show the body."""
        self._stack.setCurrentWidget(self.body)
        if self.empty is not None:
            self._stack.removeWidget(self.empty)
            self.empty.deleteLater()
            self.empty = None

    def show_no_matrix(self, path: str, text: str, buttons: dict[str, Deed]) -> None:
        """Show that the H at ``path`` is being opened or why this failed; without a path, show ``text``."""
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
        """Show on the page and in the log why something was refused."""
        self.notice.refuse(words)
        self.context.message.emit(words)

    def _say_refused(self, words: str) -> None:
        """Show on the visible page why the project did not change."""
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

        Any error is shown on the page, or passed to ``on_error``. The user can cancel; a result that arrives
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
        """Group of the requests with which the page opens files; see `load`."""
        return f"{self.spec.key} import"

    def tool_button(self, text: str, tip: str, action: Any) -> QPushButton:
        """Add a button to the header."""
        one = button(text, tip, lambda: action())
        self.tools.addWidget(one)
        return one

    def stop_tool(self, tip: str) -> QPushButton:
        """Add the button Stop (Esc), which stops all jobs of this page; it is enabled while there are any."""
        one, jobs = self.tool_button("Stop", f"{tip} (Esc)", self.stop), self.context.jobs
        one.setEnabled(False)
        jobs.changed.connect(lambda _: self._show_stop(one))
        self.shortcut("Escape", self.stop)
        return one

    def _show_stop(self, one: QPushButton) -> None:
        """Enable the button while there is a job, and show on it that a stop was requested."""
        active = [job for job in self.context.jobs.jobs() if job.active and job.page == self.spec.key]
        stopping = bool(active) and all(job.stopping for job in active)
        one.setEnabled(bool(active))
        one.setText("Stopping …" if stopping else "Stop")

    def stop(self) -> None:
        """Stop all jobs of this page; their partial results are kept."""
        for job in self.context.jobs.jobs():
            if job.active and job.page == self.spec.key:
                self.context.jobs.cancel(job.number)

    def set_panel(self, panel: QWidget) -> None:
        """Make ``panel`` the body."""
        column_of(panel, of=self.body)

    def shortcut(self, keys: str, action: Callable[[], object]) -> None:
        """Call ``action`` when ``keys`` are pressed in this page."""
        shortcut = QShortcut(QKeySequence(keys), self)
        shortcut.setContext(Qt.ShortcutContext.WidgetWithChildrenShortcut)
        shortcut.activated.connect(action)

    def set_automatic_contrast(self) -> None:
        """Set the contrast of all visible pictures automatically, ignoring the darkest and brightest pixels."""
        from lfcal_gui.widgets import Contrast

        for one in self.findChildren(Contrast):
            if one.isVisible():
                one.leave_out_tails()

    def toggle_inspector(self) -> None:
        """Hide or show the inspector to the right of the pictures."""
        areas = [one for one in self.findChildren(QWidget) if one.property(INSPECTOR)]
        shown = any(not one.isHidden() for one in areas)
        for one in areas:
            one.setVisible(not shown)
        if shown:
            self.hold_keyboard()

    def hold_keyboard(self) -> None:
        """Move the keyboard focus to the page before the focused widget is disabled or hidden.

        Shortcuts of a page work only while it has the focus.
        """
        if self.isVisible():
            self.setFocus(Qt.FocusReason.OtherFocusReason)

    def do(self, name: str) -> bool:
        """Do the action ``name`` of the next step; return False if the page does not have it."""
        deed = self.deeds().get(name)
        if deed is not None:
            deed()
        return deed is not None

    def _state_changed(self, old: ProjectState, new: ProjectState) -> None:
        waits, self._behind = self._behind is not None, self._behind or old
        if self._begun != self.context.project.begun:
            self.catch_up()
        elif self.context.in_front(self.spec.key):  # the user works on this page
            self.catch_up()
        elif not waits:
            self.context.jobs.later(self.catch_up)

    def catch_up(self) -> None:
        """Follow the changes of the project that were left for a later turn of the event loop."""
        old, self._behind = self._behind, None
        if old is not None:
            self._follow_project(old, self.context.state)

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
        """Name of the part of the page whose command is copied; empty if the page has only one command."""
        return ""

    def let_go(self) -> None:
        """Release what belongs to the previous project. `state_changed` with the new project follows."""

    def state_changed(self, old: ProjectState, new: ProjectState) -> None:
        """Update the page after a change of the project."""

    def entered(self) -> None:
        """Do expensive preparations when the page is shown."""

    def deeds(self) -> dict[str, Callable[[], object]]:
        """Return the actions that the next step may request, by name."""
        return {}

    def receive(self, payload: Any) -> None:
        """Show what another page sent, such as a position."""

    @staticmethod
    def prepare() -> None:
        """Import what the page imports at first use; called in a background thread soon after the start."""

    def accept_drop(self, paths: list[str]) -> bool:
        """Accept dropped files; return False if they are not for this page."""
        return False


def page_class(spec: PageSpec) -> type[BasePage]:
    """Return the class of a page, which is imported only now to keep the start of the window fast."""
    found: type[BasePage] = importlib.import_module(f"{spec.package}.page").Page
    return found
