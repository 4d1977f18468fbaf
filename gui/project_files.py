"""Opening, saving and leaving the window's project: dialogs, recent files, autosave."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from PySide6.QtCore import QObject, Signal
from PySide6.QtGui import QAction
from PySide6.QtWidgets import QFileDialog, QMenu, QMessageBox, QWidget

from gui.jobs import Jobs
from gui.models.project import Project, ProjectState, RecentProjects
from lfcal.errors import LfcalError

__all__ = ["ProjectFiles"]

KIND = "lfcal projects (*.lfcal)"


class ProjectFiles(QObject):
    """What the menu does with project files.

    Parameters
    ----------
    project, jobs
        The window's.
    folder
        Where recent projects and the autosave are kept.
    window
        Parent of the dialogs.

    Signals
    -------
    message(text)
        A line for the log.
    saved()
        The project has no unsaved changes any more.
    """

    message = Signal(str)
    saved = Signal()

    def __init__(self, project: Project, jobs: Jobs, folder: Path, window: QWidget) -> None:
        super().__init__(window)
        self.project, self.jobs, self._window = project, jobs, window
        self.recent = RecentProjects(folder / "recent.json")
        self.autosave_path = folder / "autosave.lfcal"

    def new(self) -> None:
        """Begin anew, after asking about unsaved work."""
        if self.may_leave():
            self.project.start(ProjectState())

    def open(self, path: Path | None = None) -> None:
        """Open a project file, after asking about unsaved work; asks for its name where none is given."""
        if not self.may_leave():
            return
        if path is None:
            name = QFileDialog.getOpenFileName(self._window, "Open project", "", KIND)[0]
            if not name:
                return
            path = Path(name)
        if self._tried("Open project", lambda: self.project.open(path)):
            self.recent.add(path)
            self.message.emit(f"opened {path}")

    def save(self) -> bool:
        """Save; ask for a name the first time. Return whether it is saved."""
        if self.project.path is None:
            return self.save_as()
        return self._save(self.project.path)

    def save_as(self) -> bool:
        """Save under a new name."""
        name = QFileDialog.getSaveFileName(self._window, "Save project", "project.lfcal", KIND)[0]
        return bool(name) and self._save(Path(name))

    def _save(self, path: Path) -> bool:
        if not self._tried("Save project", lambda: self.project.save(path)):
            return False
        self.recent.add(path)
        self.saved.emit()
        self.message.emit(f"saved {path}")
        return True

    def _tried(self, title: str, action: Callable[[], None]) -> bool:
        """Do ``action``; say in a box and in the log why it failed."""
        try:
            action()
        except LfcalError as error:
            self.message.emit(str(error))
            QMessageBox.warning(self._window, title, str(error))
            return False
        return True

    def autosave(self) -> None:
        """Keep a copy of unsaved work; a failure is only logged."""
        if self.project.unsaved:
            try:
                self.project.autosave(self.autosave_path)
            except LfcalError as error:
                self.message.emit(str(error))

    def forget_autosave(self) -> None:
        """Remove the copy: the window was closed in order."""
        self.autosave_path.unlink(missing_ok=True)

    def fill_recent(self, menu: QMenu) -> None:
        """Put the projects opened lately into a menu."""
        menu.clear()
        for path in self.recent.paths():
            action = QAction(str(path), menu)
            action.triggered.connect(lambda _=False, path=path: self.open(path))
            menu.addAction(action)
        if menu.isEmpty():
            menu.addAction("none yet").setEnabled(False)

    def may_leave(self) -> bool:
        """Ask about unsaved work and jobs at work; return whether to go on."""
        if self.jobs.running_pages():
            answer = QMessageBox.question(self._window, "Jobs are running", "Stop the running jobs?")
            if answer != QMessageBox.StandardButton.Yes:
                return False
            for job in self.jobs.jobs():
                self.jobs.cancel(job.number)
        if not self.project.unsaved:
            return True
        buttons = QMessageBox.StandardButton
        choices = buttons.Save | buttons.Discard | buttons.Cancel
        words = "Save the changes to this project?"
        answer = QMessageBox.question(self._window, "Unsaved changes", words, choices)
        if answer == buttons.Save:
            return self.save()
        return answer == buttons.Discard
