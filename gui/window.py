"""The main window: rail, pages, docks and menus only."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

from PySide6.QtCore import QByteArray, QSettings, QSize, Qt, QTimer
from PySide6.QtGui import QAction, QCloseEvent, QDragEnterEvent, QDropEvent, QKeySequence
from PySide6.QtWidgets import (
    QApplication,
    QDockWidget,
    QFileDialog,
    QHBoxLayout,
    QListWidget,
    QListWidgetItem,
    QMainWindow,
    QMessageBox,
    QPlainTextEdit,
    QStackedWidget,
    QWidget,
)

from gui.base_page import StagePage
from gui.context import Context
from gui.help import about_text, cheat_sheet
from gui.job_panel import JobPanel
from gui.jobs import Job, Jobs, JobState
from gui.models.page import Stage, StageState, available_stages, stage_states
from gui.models.project import RecentSessions, Session, SessionState
from gui.theme import DARK, LIGHT, apply_theme, current_theme, stage_icon
from lfcal.errors import LfcalError

__all__ = ["MainWindow"]

AUTOSAVE_MS = 30_000
_MARKS = {
    StageState.NOTHING: "○",
    StageState.READY: "◔",
    StageState.RUNNING: "◑",
    StageState.DONE: "●",
    StageState.ATTENTION: "▲",
}


class MainWindow(QMainWindow):
    """One window, one session."""

    def __init__(self, session: Session, folder: Path, settings: QSettings | None = None) -> None:
        super().__init__()
        self.setObjectName("lfcal")
        self.setAcceptDrops(True)
        self.settings = settings
        self.session = session
        self.jobs = Jobs(self)
        self.context = Context(session, self.jobs, self)
        self.recent = RecentSessions(folder / "recent.json")
        self.autosave_path = folder / "autosave.lfcal"
        self._attention: set[str] = set()
        self._stopped = False
        self._pages: dict[str, StagePage] = {}
        self.stages = available_stages()
        self._build_centre()
        self._build_docks()
        self._build_menus()
        self.context.state_changed.connect(self._state_changed)
        self.context.go.connect(self.go)
        self.context.message.connect(self.log)
        self.context.attention.connect(self._set_attention)
        self.jobs.changed.connect(self._job_changed)
        self._timer = QTimer(self)
        self._timer.setInterval(AUTOSAVE_MS)
        self._timer.timeout.connect(self.autosave)
        self._timer.start()
        self.resize(1280, 800)
        self._restore()
        self.rail.setCurrentRow(0)
        self._refresh()

    # -- building --------------------------------------------------------------------------------------
    def _build_centre(self) -> None:
        self.rail = QListWidget()
        self.rail.setObjectName("rail")
        self.rail.setFixedWidth(178)
        self.rail.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.rail.setIconSize(QSize(22, 22))
        self.rail.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.stack = QStackedWidget()
        for stage in self.stages:
            item = QListWidgetItem(stage.title)
            item.setData(Qt.ItemDataRole.UserRole, stage.key)
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
        self.job_dock = QDockWidget("Jobs", self)
        self.job_dock.setObjectName("jobs")
        self.job_dock.setWidget(JobPanel(self.jobs))
        self.log_dock = QDockWidget("Log", self)
        self.log_dock.setObjectName("log")
        self.log_view = QPlainTextEdit()
        self.log_view.setReadOnly(True)
        self.log_view.setMaximumBlockCount(2000)
        self.log_dock.setWidget(self.log_view)
        for dock in (self.job_dock, self.log_dock):
            self.addDockWidget(Qt.DockWidgetArea.BottomDockWidgetArea, dock)
        self.tabifyDockWidget(self.job_dock, self.log_dock)
        self.job_dock.raise_()
        self.resizeDocks([self.job_dock], [110], Qt.Orientation.Vertical)
        self.job_dock.hide()
        self.log_dock.hide()

    def _build_menus(self) -> None:
        bar = self.menuBar()
        file = bar.addMenu("&Session")
        self._action(file, "New", self.new_session, QKeySequence.StandardKey.New)
        self._action(file, "Open …", self.open_session, QKeySequence.StandardKey.Open)
        self.recent_menu = file.addMenu("Open recent")
        self.recent_menu.aboutToShow.connect(self._fill_recent)
        self._action(file, "Save", self.save_session, QKeySequence.StandardKey.Save)
        self._action(file, "Save as …", self.save_session_as, QKeySequence("Ctrl+Shift+S"))
        file.addSeparator()
        self._action(file, "Quit", self.close, QKeySequence.StandardKey.Quit)
        edit = bar.addMenu("&Edit")
        self.undo_action = self._action(edit, "Undo", self.session.undo, QKeySequence.StandardKey.Undo)
        self.redo_action = self._action(edit, "Redo", self.session.redo, QKeySequence.StandardKey.Redo)
        edit.addSeparator()
        self._action(edit, "Copy picture of the page", self.copy_page, QKeySequence("Ctrl+Shift+C"))
        view = bar.addMenu("&View")
        for k, stage in enumerate(self.stages, 1):
            self._action(
                view, stage.title, lambda _=False, key=stage.key: self.go(key, None), QKeySequence(f"Ctrl+{k}")
            )
        view.addSeparator()
        self._action(view, "Light or dark", self.toggle_theme, QKeySequence("Ctrl+T"))
        view.addAction(self.job_dock.toggleViewAction())
        view.addAction(self.log_dock.toggleViewAction())
        help_ = bar.addMenu("&Help")
        self._action(help_, "Keyboard shortcuts", self.show_shortcuts, QKeySequence("F1"))
        self._action(help_, "About lfcal", self.show_about, None)

    def _action(self, menu: Any, text: str, slot: Any, key: Any) -> QAction:
        action = QAction(text, self)
        if key is not None:
            action.setShortcut(key)
        action.triggered.connect(slot)
        menu.addAction(action)
        return action

    # -- pages -----------------------------------------------------------------------------------------
    def page(self, key: str) -> StagePage:
        """Return the page of a stage, made at the first call."""
        if key not in self._pages:
            row = [s.key for s in self.stages].index(key)
            stage: Stage = self.stages[row]
            module = importlib.import_module(f"gui.pages.{key}.page")
            page: StagePage = module.Page(stage, self.context)
            self._pages[key] = page
            old = self.stack.widget(row)
            self.stack.removeWidget(old)
            old.deleteLater()
            self.stack.insertWidget(row, page)
        return self._pages[key]

    def _show_row(self, row: int) -> None:
        if row < 0:
            return
        page = self.page(self.stages[row].key)
        self.stack.setCurrentWidget(page)
        page.setFocus()  # so that arrow keys step through positions, not through the rail
        page.entered()

    def go(self, key: str, payload: object = None) -> None:
        """Show a stage, and hand it what another page sent."""
        keys = [s.key for s in self.stages]
        if key not in keys:
            self.log(f"the stage {key} is not part of this installation")
            return
        self.rail.setCurrentRow(keys.index(key))
        if payload is not None:
            self.page(key).receive(payload)

    def _set_attention(self, key: str, flag: bool) -> None:
        (self._attention.add if flag else self._attention.discard)(key)
        self._refresh()

    # -- following ---------------------------------------------------------------------------------------
    def _state_changed(self, old: SessionState, new: SessionState) -> None:
        for path in {old.psf, old.reference} - {new.psf, new.reference}:
            self.context.forget(path)
        self._refresh()

    def _job_changed(self, job: Job) -> None:
        if job.state is JobState.FAILED:
            self.log(f"{job.title}: {job.error}")
        if not job.active or job.progress is None:
            self._refresh()
        if self.job_dock.isHidden():
            self.job_dock.show()
            self.job_dock.raise_()

    def _refresh(self) -> None:
        """Show what follows from the state: rail, title, undo."""
        state = self.session.state
        theme = current_theme()
        states = stage_states(state, self.jobs.running_stages(), self._attention)
        for row, stage in enumerate(self.stages):
            item = self.rail.item(row)
            found = states[stage.key]
            item.setText(f"{stage.title}  {_MARKS[found]}")
            item.setToolTip(f"{stage.hint}\nState: {found.value}   (Ctrl+{row + 1})")
            item.setIcon(stage_icon(stage.key, theme.text))
        star = "*" if self.session.unsaved else ""
        place = self.session.path.name if self.session.path else state.name
        self.setWindowTitle(f"{place}{star} – lfcal")
        for action, word, label in (
            (self.undo_action, "Undo", self.session.undo_label),
            (self.redo_action, "Redo", self.session.redo_label),
        ):
            action.setEnabled(bool(label))
            action.setText(f"{word} {label}".strip())

    def log(self, text: str) -> None:
        """Add a line to the log and show it in the status bar."""
        from datetime import datetime

        line = " ".join(str(text).split())
        self.log_view.appendPlainText(f"{datetime.now():%H:%M:%S}  {line}")
        self.statusBar().showMessage(line, 8000)

    # -- sessions ----------------------------------------------------------------------------------------
    def new_session(self) -> None:
        """Begin anew, after asking about unsaved work."""
        if self._may_leave():
            self.session.start(SessionState())

    def open_session(self, path: Path | None = None) -> None:
        """Open a session file, after asking about unsaved work."""
        if isinstance(path, bool):  # Qt's triggered(checked)
            path = None
        if not self._may_leave():
            return
        if path is None:
            name = QFileDialog.getOpenFileName(self, "Open session", "", "lfcal sessions (*.lfcal)")[0]
            if not name:
                return
            path = Path(name)
        try:
            self.session.open(path)
        except LfcalError as error:
            self.log(str(error))
            QMessageBox.warning(self, "Open session", str(error))
            return
        self.recent.add(path)
        self.log(f"opened {path}")

    def save_session(self) -> bool:
        """Save; ask for a name the first time. Return whether it is saved."""
        if self.session.path is None:
            return self.save_session_as()
        return self._save(self.session.path)

    def save_session_as(self) -> bool:
        """Save under a new name."""
        name = QFileDialog.getSaveFileName(self, "Save session", "session.lfcal", "lfcal sessions (*.lfcal)")[0]
        return bool(name) and self._save(Path(name))

    def _save(self, path: Path) -> bool:
        try:
            self.session.save(path)
        except LfcalError as error:
            self.log(str(error))
            QMessageBox.warning(self, "Save session", str(error))
            return False
        self.recent.add(path)
        self.log(f"saved {path}")
        self._refresh()
        return True

    def autosave(self) -> None:
        """Keep a copy of unsaved work; a failure is only logged."""
        if self.session.unsaved:
            try:
                self.session.autosave(self.autosave_path)
            except LfcalError as error:
                self.log(str(error))

    def _fill_recent(self) -> None:
        self.recent_menu.clear()
        for path in self.recent.paths():
            action = QAction(str(path), self.recent_menu)
            action.triggered.connect(lambda _=False, path=path: self.open_session(path))
            self.recent_menu.addAction(action)
        if self.recent_menu.isEmpty():
            self.recent_menu.addAction("none yet").setEnabled(False)

    def _may_leave(self) -> bool:
        """Ask about unsaved work and jobs at work; return whether to go on."""
        if self.jobs.running_stages():
            answer = QMessageBox.question(self, "Jobs are running", "Stop the running jobs?")
            if answer != QMessageBox.StandardButton.Yes:
                return False
            for job in self.jobs.jobs():
                self.jobs.cancel(job.number)
        if not self.session.unsaved:
            return True
        buttons = QMessageBox.StandardButton
        answer = QMessageBox.question(
            self,
            "Unsaved changes",
            "Save the changes to this session?",
            buttons.Save | buttons.Discard | buttons.Cancel,
        )
        if answer == buttons.Save:
            return self.save_session()
        return answer == buttons.Discard

    # -- habits ------------------------------------------------------------------------------------------
    def toggle_theme(self) -> None:
        """Change between light and dark."""
        self.set_theme("light" if current_theme() is DARK else "dark")

    def set_theme(self, name: str) -> None:
        """Use the theme ``"light"`` or ``"dark"``."""
        app = QApplication.instance()
        assert isinstance(app, QApplication)
        apply_theme(app, DARK if name == "dark" else LIGHT)
        if self.settings is not None:
            self.settings.setValue("theme", name)
        self.context.theme_changed.emit()
        self._refresh()

    def copy_page(self) -> None:
        """Put a picture of the page on the clipboard."""
        QApplication.clipboard().setPixmap(self.stack.currentWidget().grab())
        self.log("picture of the page copied")

    def show_shortcuts(self) -> None:
        """Show the cheat sheet."""
        QMessageBox.information(self, "Keyboard shortcuts", cheat_sheet(self.stages))

    def show_about(self) -> None:
        """Show versions and licence."""
        QMessageBox.about(self, "About lfcal", about_text())

    def dragEnterEvent(self, event: QDragEnterEvent) -> None:
        """Accept files."""
        if event.mimeData().hasUrls():
            event.acceptProposedAction()

    def dropEvent(self, event: QDropEvent) -> None:
        """Hand dropped files to whom they belong."""
        paths = [url.toLocalFile() for url in event.mimeData().urls() if url.isLocalFile()]
        self.take_files(paths)

    def take_files(self, paths: list[str]) -> None:
        """Open sessions here; offer anything else to the page shown, then to the others."""
        if len(paths) == 1 and paths[0].endswith(".lfcal"):
            self.open_session(Path(paths[0]))
            return
        shown = self.stack.currentWidget()
        others = [s.key for s in self.stages if self._pages.get(s.key) is not shown]
        if isinstance(shown, StagePage) and shown.accept_drop(paths):
            return
        for key in others:
            if self.page(key).accept_drop(paths):
                self.go(key, None)
                return
        self.log(f"no stage takes {', '.join(Path(p).name for p in paths)}")

    def closeEvent(self, event: QCloseEvent) -> None:
        """Ask about unsaved work, keep the window's state, stop the threads."""
        if not self._stopped:
            if not self._may_leave():
                event.ignore()
                return
            self.shut_down()
        event.accept()

    def shut_down(self) -> None:
        """Stop timers, jobs and threads; keep the window's state. Closing asks nothing afterwards."""
        if self._stopped:
            return
        self._stopped = True
        self._timer.stop()
        if self.settings is not None:
            self.settings.setValue("geometry", self.saveGeometry())
            self.settings.setValue("windowState", self.saveState())
        self.jobs.close()
        self.context.close()
        self.autosave_path.unlink(missing_ok=True)

    def _restore(self) -> None:
        if self.settings is None:
            return
        for key, restore in (("geometry", self.restoreGeometry), ("windowState", self.restoreState)):
            value = self.settings.value(key)
            if isinstance(value, QByteArray):
                restore(value)
