"""The main window: header, rail, the views of the four places, docks and menus."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from datetime import datetime
from functools import partial
from pathlib import Path

from PySide6.QtCore import QByteArray, QEvent, QObject, QSettings, Qt, QTimer
from PySide6.QtGui import QCloseEvent, QDragEnterEvent, QDropEvent, QResizeEvent
from PySide6.QtWidgets import (
    QApplication,
    QDialog,
    QHBoxLayout,
    QMainWindow,
    QStackedWidget,
    QWidget,
)
from shiboken6 import isValid

from lfcal.base import LfcalError
from lfcal_gui._ahead import Ahead
from lfcal_gui._header import HeaderBar, NextLine
from lfcal_gui._help import Manual
from lfcal_gui._layouts import Layouts, LogView, add_dock, fit_screen
from lfcal_gui._leading import Leading
from lfcal_gui._menus import WindowMenus
from lfcal_gui._page_window import PageWindow
from lfcal_gui._project_files import ProjectFiles
from lfcal_gui._rail import Rail
from lfcal_gui._scripts import Scripts
from lfcal_gui._tools import Tools
from lfcal_gui.base_page import BasePage, page_class
from lfcal_gui.context import Context
from lfcal_gui.job_panel import JobsLine
from lfcal_gui.jobs import JOBS_S, Jobs, JobState, WindowJob
from lfcal_gui.models import PAGES, PageSpec, Project, ProjectState, Sitting, available_pages, page_states, rail_words
from lfcal_gui.palette import Palette, doable
from lfcal_gui.theme import DARK, LIGHT, THEMES, Themed, apply_theme, current_theme, style_sheet
from lfcal_gui.widgets import ElidedLabel, column_of, name_controls, row_of, set_role, toggle_in
from lfcal_gui.workers import LOG

LOOK_MS = 20
"""Interval between two checks whether the window can close (ms)."""


class Leaving(QTimer):
    """Call ``done`` as soon as closing no longer has to wait; its argument is whether work is still running."""

    def __init__(self, jobs: Jobs, done: Callable[[bool], None], parent: QObject) -> None:
        super().__init__(parent)
        self._jobs, self._done, self._began = jobs, done, time.monotonic()
        self.setInterval(LOOK_MS)
        self.timeout.connect(self._look)
        self.start()

    def _look(self) -> None:
        if not self._jobs.waits_for(time.monotonic() - self._began):
            self.stop()
            self._done(self._jobs.waits_for(0))


INI = QSettings.Format.IniFormat

IMPORT_MS = 400
"""Delay of the import of the pages after the window is shown (ms)."""

LEAST_LOG = 28
"""Smallest height of the log: one line (px)."""

LOW, LOG_SIZE = 680, (720, 240)
"""Height of the window below which the log is shown in a separate window, and size of that window (px)."""

STATUS = 28
"""Height of the status bar (px): with a notice or without one."""

MESSAGE_MS = 8000
"""Time for which a line of the log is shown in the status bar (ms)."""


class MainWindow(QMainWindow):
    """The main window, which has one project."""

    def __init__(
        self,
        project: Project,
        folder: Path,
        settings: QSettings | None = None,
        pages: Iterable[PageSpec] | None = None,
    ) -> None:
        super().__init__()
        self.setObjectName("lfcal")
        self.settings = settings if settings is not None else QSettings(str(folder / "window.ini"), INI)
        self.project = project
        self.jobs = Jobs(self)
        self.context = Context(project, self.jobs, self)
        self.context.preferences = self.settings
        self.files = ProjectFiles(project, self.jobs, folder, self)
        self._attention: set[str] = set()
        self._manual: Manual | None = None
        self._stopped = self._leaving = self._overdue = False
        self._pages: dict[str, BasePage] = {}
        self._making: dict[str, Iterator[bool]] = {}
        self._visited = self._front = ""
        self._windows: dict[str, PageWindow] = {}
        self._last: dict[str, str] = {}
        self.layouts, self.specs = Layouts(self.settings), tuple(available_pages() if pages is None else pages)
        self._build_centre()
        self._build_status()
        self.tools, self.scripts = Tools(self, folder), Scripts(self)
        self.menus = WindowMenus(self)
        self._style()
        self._connect()
        fit_screen(self)
        self._restore()
        self.ahead = Ahead([spec.key for spec in self.specs], self._make, lambda: self.jobs.busy, self)
        self.leading = Leading(self.context, self.next_line, self, self.page, self._looked_at)
        self.leading.changed.connect(self._say_places)
        self.go(self.specs[0].key)
        self.leading.gather()
        self._refresh()
        for reason in PAGES.failures().values():
            self.log(reason)

    def _connect(self) -> None:
        self.context.in_front = lambda key: key == self._front
        self.context.state_changed.connect(self._state_changed)
        self.context.go.connect(self.go)
        self.context.files_offered.connect(self.take_files)
        self.context.help_asked.connect(self.show_manual)
        self.context.sample_asked.connect(self.tools.sample)
        self.context.message.connect(self.log)
        self.context.theme_asked.connect(self._use_theme)
        self.context.attention.connect(self._set_attention)
        self.files.message.connect(self.log)
        self.files.saved.connect(self._refresh)
        self.files.begun.connect(lambda: self.go("setup"))
        self.jobs.changed.connect(self._job_changed)
        self.jobs.trouble.connect(self.log)

    # -- building --------------------------------------------------------------------------------------
    def _build_centre(self) -> None:
        self.setAcceptDrops(True)
        self.rail, self.stack, self.header, self.next_line = Rail(), QStackedWidget(), HeaderBar(), NextLine()
        self.header.lead.addWidget(self.next_line)
        below = QHBoxLayout()
        below.setSpacing(0)
        below.addWidget(self.rail)
        below.addWidget(self.stack, 1)
        centre = QWidget()
        column_of(self.header, below, of=centre, spacing=0, stretch=1)
        self.setCentralWidget(centre)
        self.rail.chosen.connect(self.go_place)

    def _build_status(self) -> None:
        self.log_view = LogView()
        self.log_view.setMinimumHeight(LEAST_LOG)
        self.log_dock = add_dock(self, "Log", self.log_view)
        self.resizeDocks([self.log_dock], [110], Qt.Orientation.Vertical)
        self.log_dock.hide()
        self.log_dock.toggleViewAction().triggered.connect(self._place_log)
        self.job_line = JobsLine(self.jobs, self)
        self._begun = self.project.begun
        self.message = ElidedLabel(sentence=True, role="hint")
        self.message.setContentsMargins(6, 0, 0, 0)
        self._silence = QTimer(self, singleShot=True, interval=MESSAGE_MS)
        self._silence.timeout.connect(lambda: self.message.setText(""))
        self.notices = QStackedWidget()  # one notice for each page
        holder = QWidget()
        row = QHBoxLayout(holder)
        row.setContentsMargins(0, 0, 0, 0)
        row.addWidget(self.notices)
        row.addWidget(self.message, 1)
        self.statusBar().addWidget(holder, 1)
        self.statusBar().addPermanentWidget(self.job_line)
        self.statusBar().setFixedHeight(STATUS)

    # -- pages -----------------------------------------------------------------------------------------
    @property
    def shown(self) -> BasePage:
        """The current page: a view of the current place, or a page in a separate window.

        It is the page that the user chose last, which is made at once if it is still being made.
        """
        if self._visited:
            self.go(self._visited)
        return self.page(self._front)

    def spec(self, key: str) -> PageSpec | None:
        """Return the description of the page ``key``; None if it is not installed."""
        return next((spec for spec in self.specs if spec.key == key), None)

    def views(self, place: str) -> tuple[PageSpec, ...]:
        """Return the pages that are views of a place."""
        return tuple(spec for spec in self.specs if spec.place == place)

    def page(self, key: str) -> BasePage:
        """Return the page ``key``, which is made at the first call."""
        while self._make(key):
            pass
        self._pages[key].catch_up()
        return self._pages[key]

    def _make(self, key: str) -> bool:
        """Do the next step of making a page; return False if there is none."""
        if key not in self._making:
            self._making[key] = self._steps(key)
        try:
            return next(self._making[key], False)
        except BaseException:
            del self._making[key]
            raise

    def _steps(self, key: str) -> Iterator[bool]:
        """Make a page in steps: the parts of a large page, the page, its place in the window, and its style."""
        spec = next(spec for spec in self.specs if spec.key == key)
        made_as = page_class(spec)
        parts = []
        for part in made_as.parts(self.context):
            parts.append(part)
            yield True
        made = made_as(spec, self.context, *parts[-1:])
        yield True
        name_controls(made)
        if spec.place:
            made.set_views(self.views(spec.place), self.visit)
            self.stack.addWidget(made)
            self.notices.addWidget(_held(made.notice))
        else:
            self._windows[key] = PageWindow(made, self, self.settings)
            self._windows[key].activated.connect(lambda: self._to_front(key))
        self.layouts.restore(key, made)
        self._pages[key] = made
        yield True
        made.take_theme()
        yield True

    def import_pages(self) -> None:
        """Import the pages and their libraries in the background, then make them while the window is idle."""

        def prepare() -> None:
            for spec in self.specs:
                page_class(spec).prepare()

        def load() -> None:
            self.jobs.load("pages", prepare, lambda _: self.ahead.start())

        later = QTimer(self)  # once the window is there: imports would slow its start
        later.setSingleShot(True)
        later.timeout.connect(load)
        later.start(IMPORT_MS)

    def go_place(self, place: str) -> None:
        """Show a place with the view that was shown last."""
        views = self.views(place)
        if views:
            self.visit(self._last.get(place, views[0].key))

    def go_view(self, number: int) -> None:
        """Show the view with a number, from 0, of the current place."""
        place = self.shown.spec.place
        views = self.views(place) if place else ()
        if number < len(views):
            self.visit(views[number].key)

    def _looked_at(self) -> tuple[str, str]:
        """Return the keys of the current page and place."""
        page = self.stack.currentWidget()
        return self._front, page.spec.place if isinstance(page, BasePage) else ""

    def visit(self, key: str) -> None:
        """Show a page that the user chose. A page that does not exist yet is made in turns of the event loop first."""
        self._visited = key

        def step() -> None:
            if self._visited == key:  # else another page was chosen since
                if self._make(key):
                    self.jobs.later(step)
                else:
                    self.go(key)

        step()

    def go(self, key: str, payload: object = None) -> None:
        """Show a page, and pass it the object that another page sent."""
        self._visited = ""
        spec = self.spec(key)
        if spec is None:
            self.log(f"the page {key} is not part of this installation")
            return
        page = self.page(key)
        self._to_front(key)
        if spec.place:
            self.stack.setCurrentWidget(page)
            self.notices.setCurrentWidget(page.notice.parentWidget())
            self.rail.show_place(spec.place)
            self._last[spec.place] = key
            self.stack.updateGeometry()  # else the window keeps the minimum width from before the page had its fonts
            if any(window.isActiveWindow() for window in self._windows.values()):
                self.activateWindow()
        else:
            window = self._windows[key]
            window.show()
            window.raise_()
            window.activateWindow()
        page.setFocus()  # so that arrow keys step through positions, not through the rail
        page.entered()
        self.leading.look()
        if payload is not None:
            page.receive(payload)

    def _to_front(self, key: str) -> None:
        self._front = key
        self._pages[key].catch_up()

    def event(self, event: QEvent) -> bool:
        """Update the current page when the user returns from a separate window."""
        if event.type() == QEvent.Type.WindowActivate and isinstance(page := self.stack.currentWidget(), BasePage):
            self._to_front(page.spec.key)
        return super().event(event)

    def show_manual(self, page: str, name: str = "") -> None:
        """Show a page of the manual, or its section about ``name``, in a separate window."""
        if self._manual is None:
            self._manual = Manual(self)
        try:
            self._manual.show_page(page, name)
        except LfcalError as error:
            self.log(str(error))

    def _set_attention(self, key: str, flag: bool) -> None:
        (self._attention.add if flag else self._attention.discard)(key)
        self._refresh()

    # -- following ---------------------------------------------------------------------------------------
    def _state_changed(self, old: ProjectState, new: ProjectState) -> None:
        for path in {old.psf, old.reference} - {new.psf, new.reference}:
            self.context.forget(path)
        if self._begun != self.project.begun:
            self._begun = self.project.begun
            self.job_line.forget_failed()
        self._refresh()

    def _job_changed(self, job: WindowJob) -> None:
        if job.state is JobState.FAILED:
            self.log(f"{job.title}: {job.error}", role="error")
        if not job.active or job.progress is None:
            self._refresh()

    def _refresh(self) -> None:
        """Update rail, title and undo actions from the state."""
        state = self.project.state
        states = page_states(state, self.specs, self.jobs.running_pages(), self._attention)
        for page in self._pages.values():
            page.mark_views(states)
        self.menus.mark(states)
        name = self.project.path.name if self.project.path else state.name
        self.header.say(name, unsaved=self.project.unsaved)
        self.setWindowTitle(f"{name}{'*' if self.project.unsaved else ''} – lfcal")
        for action, word, label in (
            (self.menus.undo, "Undo", self.project.undo_label),
            (self.menus.redo, "Redo", self.project.redo_label),
        ):
            action.setEnabled(bool(label))
            action.setText(f"{word} {label}".strip())

    def _say_places(self, sitting: Sitting) -> None:
        for place, said in rail_words(sitting).items():
            self.rail.say(place, said.words, said.mark)

    def log(self, text: str, *, role: str = "hint") -> None:
        """Add a line to the log and show it in the status bar, in the style of a role."""
        line = " ".join(str(text).split())
        self.log_view.appendPlainText(f"{datetime.now():%H:%M:%S}  {line}")
        self.message.setText(line)
        set_role(self.message, role)
        self._silence.start()
        LOG.info("%s", line)

    # -- habits ------------------------------------------------------------------------------------------
    def toggle_theme(self) -> None:
        """Change between light and dark."""
        self.set_theme("light" if current_theme() is DARK else "dark")

    def set_theme(self, name: str) -> None:
        """Set the theme ``"light"``, ``"dark"`` or ``"night"``, and store it for later starts."""
        self._use_theme(name)
        self.settings.setValue("theme", name)

    def _use_theme(self, name: str) -> None:
        app = QApplication.instance()
        assert isinstance(app, QApplication)
        self.setUpdatesEnabled(False)  # until all of it has the new colours
        apply_theme(app, THEMES.get(name, LIGHT))
        for dialog in self.findChildren(QDialog):
            if dialog.styleSheet() and dialog.isVisible():  # others follow their page
                _apply_style(dialog)
        self.context.theme_changed.emit()
        self.jobs.later(self._style)
        self._refresh()

    def _style(self) -> None:
        """Apply the style sheet to the parts around the pages. Each page applies it when it is shown.

        Hidden parts, such as menus, and other windows take it in later turns of the event loop.
        """
        dialogs = (dialog for dialog in self.findChildren(QDialog) if dialog.styleSheet() not in ("", style_sheet()))
        parts = self.log_dock, self.job_line.sheet, self.rail.menu, self.header.menu, *self.menus.menus
        for part in (self.menuBar(), self.header, self.statusBar(), self.rail, *parts, self._manual, *dialogs):
            if part is not None and not part.isHidden() and part.window() is self:
                _apply_style(part)
            elif part is not None:
                self.jobs.later(partial(_apply_style, part))
        for window in self._windows.values():
            self.jobs.later(window.apply_theme)
        self.setUpdatesEnabled(True)

    def copy_page(self) -> None:
        """Copy an image of the page to the clipboard."""
        QApplication.clipboard().setPixmap(self.shown.grab())
        self.log("image of the page copied")

    def enlarge_picture(self) -> None:
        """Enlarge the picture under the pointer or else the largest one of the page, or restore an enlarged one."""
        if not toggle_in(self.shown):
            self.log("this page shows no image yet")

    def show_palette(self) -> None:
        """Open the command palette."""
        page = self.shown
        Palette(page.window(), doable(self.menus.menus, page, page.spec.title)).open()

    def dragEnterEvent(self, event: QDragEnterEvent) -> None:
        """Accept files."""
        if event.mimeData().hasUrls():
            event.acceptProposedAction()

    def dropEvent(self, event: QDropEvent) -> None:
        """Open dropped files."""
        paths = [url.toLocalFile() for url in event.mimeData().urls() if url.isLocalFile()]
        self.take_files(paths)

    def take_files(self, paths: list[str]) -> None:
        """Open project files; offer other files to the current page, then to the other pages."""
        if len(paths) == 1 and paths[0].endswith(".lfcal"):
            self.files.open(Path(paths[0]))
            return
        shown = self.shown
        others = [
            spec.key
            for spec in self.specs
            if self._pages.get(spec.key) is not shown and (spec.takes is None or all(map(spec.takes, paths)))
        ]
        if shown.accept_drop(paths):
            return
        for key in others:
            if self.page(key).accept_drop(paths):
                self.go(key, None)
                return
        self.log(f"no page can open {', '.join(Path(p).name for p in paths)}")

    def closeEvent(self, event: QCloseEvent) -> None:
        """Ask about unsaved work, stop the jobs, and close the window when they have ended."""
        if not self._stopped:
            if not self._leaving and not self.files.may_leave():
                event.ignore()
                return
            if not self._leaving:
                self.jobs.leave()
            if self.jobs.waits_for(0) and not self._overdue:
                self._leave_later()
                event.ignore()
                return
            self.shut_down(asked=True)
        event.accept()

    def _leave_later(self) -> None:
        """Close as soon as the stopped jobs have cleaned up and no computation is running."""
        if self._leaving:
            return
        self._leaving = True
        for widget in (self.menuBar(), self.centralWidget()):
            widget.setEnabled(False)
        self.log("stopping jobs; the window then closes")
        Leaving(self.jobs, self._leave_now, self)

    def _leave_now(self, overdue: bool) -> None:
        """Close the window; ``overdue`` states whether work is still running."""
        self._overdue = overdue
        self.close()

    def shut_down(self, *, asked: bool = False) -> None:
        """Stop timers, jobs and threads, and store the window's state.

        Unless the user was ``asked``, a copy of unsaved work is kept. Closing the window afterwards asks no questions.
        """
        if self._stopped:
            return
        self._stopped = True
        self.ahead.stop()
        self.settings.setValue("geometry", self.saveGeometry())
        self.settings.setValue("windowState", self.saveState())
        self.layouts.keep()
        for window in self._windows.values():
            window.keep()
            window.hide()
        self.jobs.close(0.0 if self._overdue else JOBS_S)
        self.context.close()
        self.files.close(answered=asked)

    def reset_layout(self) -> None:
        """Reset size, docks and splitters of the window to their initial state."""
        self.log_dock.setFloating(False)
        self.addDockWidget(Qt.DockWidgetArea.BottomDockWidgetArea, self.log_dock)
        self.log_dock.hide()
        self.layouts.reset()
        fit_screen(self)

    def _place_log(self, shown: bool) -> None:
        """Show the log in a separate window if this one has no room for more than a line of it."""
        if shown and self.height() < LOW and not self.log_dock.isFloating():
            self.log_dock.setFloating(True)
            self.log_dock.resize(*LOG_SIZE)

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Keep several lines of the log in view in a low window."""
        super().resizeEvent(event)
        if self.isVisible():
            self._place_log(self.log_dock.isVisible())

    def _restore(self) -> None:
        for key, restore in (("geometry", self.restoreGeometry), ("windowState", self.restoreState)):
            value = self.settings.value(key)
            if isinstance(value, QByteArray):
                restore(value)


def _apply_style(part: QWidget) -> None:
    """Apply the style sheet to a part of the window, unless it was deleted before its turn."""
    if not isValid(part):
        return
    part.setStyleSheet(style_sheet())
    if isinstance(part, Themed):  # a window with plots; a page redraws only its own plots
        part.apply_theme()


def _held(notice: QWidget) -> QWidget:
    """Return a widget with ``notice`` for a stack, which may show it even if the notice is hidden."""
    holder = QWidget()
    row_of(notice, of=holder)
    return holder
