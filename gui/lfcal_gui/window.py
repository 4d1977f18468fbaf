"""The main window: rail, pages, docks and menus only."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import datetime
from pathlib import Path

from PySide6.QtCore import QByteArray, QSettings, QSize, Qt
from PySide6.QtGui import QCloseEvent, QDragEnterEvent, QDropEvent
from PySide6.QtWidgets import (
    QApplication,
    QDialog,
    QHBoxLayout,
    QListWidget,
    QListWidgetItem,
    QMainWindow,
    QStackedWidget,
    QWidget,
)

from lfcal.base import LfcalError
from lfcal_gui._docks import LogView, add_dock
from lfcal_gui._icons import icon_of
from lfcal_gui._jobs_line import JobsLine
from lfcal_gui._leaving import Leaving
from lfcal_gui._manual import Manual
from lfcal_gui._menus import WindowMenus, page_key
from lfcal_gui._project_files import ProjectFiles
from lfcal_gui._scripts import Scripts
from lfcal_gui._tools import Tools
from lfcal_gui._window_size import fit_screen
from lfcal_gui.base_page import BasePage, page_class
from lfcal_gui.context import Context
from lfcal_gui.jobs import JOBS_S, Jobs, JobState, WindowJob
from lfcal_gui.models import PAGES, PageSpec, PageState, Project, ProjectState, available_pages, page_states
from lfcal_gui.palette import Palette, doable
from lfcal_gui.theme import DARK, LIGHT, THEMES, Themed, apply_theme, current_theme, style_sheet
from lfcal_gui.widgets import name_controls, toggle_in
from lfcal_gui.workers import LOG

__all__ = ["MainWindow"]

INI = QSettings.Format.IniFormat

_MARKS = {
    PageState.NOTHING: "○",
    PageState.READY: "◔",
    PageState.RUNNING: "◑",
    PageState.DONE: "●",
    PageState.ATTENTION: "▲",
}


class MainWindow(QMainWindow):
    """One window, one project."""

    def __init__(
        self,
        project: Project,
        folder: Path,
        settings: QSettings | None = None,
        pages: Iterable[PageSpec] | None = None,
    ) -> None:
        super().__init__()
        self.setObjectName("lfcal")
        self.setAcceptDrops(True)
        self.settings = settings if settings is not None else QSettings(str(folder / "window.ini"), INI)
        self.project = project
        self.jobs = Jobs(self)
        self.context = Context(project, self.jobs, self)
        self.files = ProjectFiles(project, self.jobs, folder, self)
        self._attention: set[str] = set()
        self._manual: Manual | None = None
        self._stopped = self._leaving = self._overdue = False
        self._pages: dict[str, BasePage] = {}
        self.specs = tuple(available_pages() if pages is None else pages)
        self._build_centre()
        self._build_docks()
        self.tools, self.scripts = Tools(self, folder), Scripts(self)
        self.menus = WindowMenus(self)
        self._style()
        self._connect()
        fit_screen(self)
        self._restore()
        self.rail.setCurrentRow(0)
        self._refresh()
        for reason in PAGES.failures().values():
            self.log(reason)

    def _connect(self) -> None:
        self.context.state_changed.connect(self._state_changed)
        self.context.go.connect(self.go)
        self.context.help_asked.connect(self.show_manual)
        self.context.message.connect(self.log)
        self.context.theme_asked.connect(self._use_theme)
        self.context.attention.connect(self._set_attention)
        self.files.message.connect(self.log)
        self.files.saved.connect(self._refresh)
        self.files.begun.connect(lambda: self.go("camera"))
        self.jobs.changed.connect(self._job_changed)
        self.jobs.trouble.connect(self.log)

    # -- building --------------------------------------------------------------------------------------
    def _build_centre(self) -> None:
        self.rail = QListWidget()
        self.rail.setObjectName("rail")
        self.rail.setAccessibleName("pages")
        self.rail.setFixedWidth(178)
        self.rail.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.rail.setIconSize(QSize(22, 22))
        self.rail.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.stack = QStackedWidget()
        for spec in self.specs:
            item = QListWidgetItem(spec.title)
            item.setData(Qt.ItemDataRole.UserRole, spec.key)
            item.setSizeHint(QSize(160, 40))
            self.rail.addItem(item)
            self.stack.addWidget(QWidget())  # pages are made when first looked at
        centre = QWidget()
        layout = QHBoxLayout(centre)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(0)
        layout.addWidget(self.rail)
        layout.addWidget(self.stack, 1)
        self.setCentralWidget(centre)
        self.rail.currentRowChanged.connect(self._show_row)

    def _build_docks(self) -> None:
        self.log_view = LogView()
        self.log_dock = add_dock(self, "Log", self.log_view)
        self.resizeDocks([self.log_dock], [110], Qt.Orientation.Vertical)
        self.log_dock.hide()
        self.job_line = JobsLine(self.jobs, self)
        self.statusBar().addPermanentWidget(self.job_line)

    # -- pages -----------------------------------------------------------------------------------------
    def page(self, key: str) -> BasePage:
        """Return the page called ``key``, made at the first call."""
        if key not in self._pages:
            row = self._row(key)
            spec = self.specs[row]
            made = self._pages[key] = page_class(spec)(spec, self.context)
            name_controls(made)
            old = self.stack.widget(row)
            self.stack.removeWidget(old)
            old.deleteLater()
            self.stack.insertWidget(row, made)
        return self._pages[key]

    def _row(self, key: str) -> int:
        """Return the place of a page in the rail, -1 where there is no such page."""
        return next((row for row, spec in enumerate(self.specs) if spec.key == key), -1)

    def _show_row(self, row: int) -> None:
        if row < 0:
            return
        page = self.page(self.specs[row].key)
        self.stack.setCurrentWidget(page)
        page.setFocus()  # so that arrow keys step through positions, not through the rail
        page.entered()
        self.stack.updateGeometry()  # the least width before the page had its fonts would stay that of the window

    def go(self, key: str, payload: object = None) -> None:
        """Show a page, and hand it what another page sent."""
        row = self._row(key)
        if row < 0:
            self.log(f"the page {key} is not part of this installation")
            return
        self.rail.setCurrentRow(row)
        if payload is not None:
            self.page(key).receive(payload)

    def show_manual(self, page: str, name: str = "") -> None:
        """Show a page of the manual, or its section about ``name``, beside the window."""
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
        self._refresh()

    def _job_changed(self, job: WindowJob) -> None:
        if job.state is JobState.FAILED:
            self.log(f"{job.title}: {job.error}")
        if not job.active or job.progress is None:
            self._refresh()

    def _refresh(self) -> None:
        """Show what follows from the state: rail, title, undo."""
        state = self.project.state
        theme = current_theme()
        states = page_states(state, self.specs, self.jobs.running_pages(), self._attention)
        for row, spec in enumerate(self.specs):
            item, found = self.rail.item(row), states[spec.key]
            item.setText(f"{spec.title}  {_MARKS[found]}")
            key = page_key(row)
            shortcut = "" if key is None else f"   ({key.toString()})"
            item.setToolTip(f"{spec.hint}\nState: {found.value}{shortcut}")
            item.setIcon(icon_of(spec.icon, theme.text, theme.accent_text))
        star = "*" if self.project.unsaved else ""
        place = self.project.path.name if self.project.path else state.name
        self.setWindowTitle(f"{place}{star} – lfcal")
        for action, word, label in (
            (self.menus.undo, "Undo", self.project.undo_label),
            (self.menus.redo, "Redo", self.project.redo_label),
        ):
            action.setEnabled(bool(label))
            action.setText(f"{word} {label}".strip())

    def log(self, text: str) -> None:
        """Add a line to the log and show it in the status bar."""
        line = " ".join(str(text).split())
        self.log_view.appendPlainText(f"{datetime.now():%H:%M:%S}  {line}")
        self.statusBar().showMessage(line, 8000)
        LOG.info("%s", line)

    # -- habits ------------------------------------------------------------------------------------------
    def toggle_theme(self) -> None:
        """Change between light and dark."""
        self.set_theme("light" if current_theme() is DARK else "dark")

    def set_theme(self, name: str) -> None:
        """Use a theme by its name, ``"light"``, ``"dark"`` or ``"night"``, also from the next start on."""
        self._use_theme(name)
        self.settings.setValue("theme", name)

    def _use_theme(self, name: str) -> None:
        app = QApplication.instance()
        assert isinstance(app, QApplication)
        apply_theme(app, THEMES.get(name, LIGHT))
        self._style()
        self.context.theme_changed.emit()
        self._refresh()

    def _style(self) -> None:
        """Style what stands around the pages, which style themselves as soon as they are seen."""
        dialogs = (dialog for dialog in self.findChildren(QDialog) if dialog.styleSheet())  # others take their page's
        parts = self.log_dock, self.job_line.sheet
        for part in (self.menuBar(), self.statusBar(), self.rail, *parts, self._manual, *dialogs):
            if part is not None:
                part.setStyleSheet(style_sheet())
            if isinstance(part, Themed):  # a window with plots: a page redraws its own only
                part.apply_theme()

    def copy_page(self) -> None:
        """Put a picture of the page on the clipboard."""
        QApplication.clipboard().setPixmap(self.stack.currentWidget().grab())
        self.log("picture of the page copied")

    def enlarge_picture(self) -> None:
        """Enlarge the picture under the pointer, else the largest one of the page, or put it back."""
        if not toggle_in(self.stack.currentWidget()):
            self.log("this page shows no picture yet")

    def show_palette(self) -> None:
        """Offer everything that can be done here by its name."""
        title = self.specs[self.rail.currentRow()].title if self.rail.currentRow() >= 0 else "Welcome"
        Palette(self, doable(self.menuBar(), self.stack.currentWidget(), title)).open()

    def dragEnterEvent(self, event: QDragEnterEvent) -> None:
        """Accept files."""
        if event.mimeData().hasUrls():
            event.acceptProposedAction()

    def dropEvent(self, event: QDropEvent) -> None:
        """Offer dropped files to the pages."""
        paths = [url.toLocalFile() for url in event.mimeData().urls() if url.isLocalFile()]
        self.take_files(paths)

    def take_files(self, paths: list[str]) -> None:
        """Open projects here; offer anything else to the page shown, then to the others."""
        if len(paths) == 1 and paths[0].endswith(".lfcal"):
            self.files.open(Path(paths[0]))
            return
        shown = self.stack.currentWidget()
        others = [
            spec.key
            for spec in self.specs
            if self._pages.get(spec.key) is not shown and (spec.takes is None or all(map(spec.takes, paths)))
        ]
        if isinstance(shown, BasePage) and shown.accept_drop(paths):
            return
        for key in others:
            if self.page(key).accept_drop(paths):
                self.go(key, None)
                return
        self.log(f"no page takes {', '.join(Path(p).name for p in paths)}")

    def closeEvent(self, event: QCloseEvent) -> None:
        """Ask about unsaved work, keep the window's state, stop the threads: the window lives until jobs have ended."""
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
        """Close when the jobs, which were asked to stop, have cleaned up behind themselves, and nothing is computed."""
        if self._leaving:
            return
        self._leaving = True
        for widget in (self.menuBar(), self.centralWidget()):
            widget.setEnabled(False)
        self.log("stopping what is at work; the window closes when that is done")
        Leaving(self.jobs, self._leave_now, self)

    def _leave_now(self, overdue: bool) -> None:
        """Close, ``overdue``: whatever is still at work."""
        self._overdue = overdue
        self.close()

    def shut_down(self, *, asked: bool = False) -> None:
        """Stop timers, jobs and threads; keep the window's state, and what is not saved unless the user was ``asked``.

        Closing asks nothing afterwards.
        """
        if self._stopped:
            return
        self._stopped = True
        self.settings.setValue("geometry", self.saveGeometry())
        self.settings.setValue("windowState", self.saveState())
        self.jobs.close(0.0 if self._overdue else JOBS_S)
        self.context.close()
        self.files.close(answered=asked)

    def reset_layout(self) -> None:
        """Give the window the size and the docks of the first start."""
        self.log_dock.setFloating(False)
        self.addDockWidget(Qt.DockWidgetArea.BottomDockWidgetArea, self.log_dock)
        self.log_dock.hide()
        fit_screen(self)

    def _restore(self) -> None:
        for key, restore in (("geometry", self.restoreGeometry), ("windowState", self.restoreState)):
            value = self.settings.value(key)
            if isinstance(value, QByteArray):
                restore(value)
