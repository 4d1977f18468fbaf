"""Open, save and close the project of the window: dialogs, recent files, locks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from PySide6.QtCore import QObject, Signal
from PySide6.QtGui import QAction
from PySide6.QtWidgets import QFileDialog, QMenu, QMessageBox, QWidget

from lfcal.base import LfcalError
from lfcal_gui._rescue import Rescue
from lfcal_gui.jobs import Jobs
from lfcal_gui.locks import FileLock
from lfcal_gui.models import PageSettings, Project, ProjectState, RecentProjects, UnsavedCopy, read_project
from lfcal_gui.saving import ask_target, may_replace

KIND = "lfcal projects (*.lfcal)"
BUTTONS = QMessageBox.StandardButton

Stake = tuple[ProjectState | None, frozenset[int]]
"""The unsaved state (None if it is saved), and the numbers of the running jobs."""

LISTED = 8
"""Number of jobs that are listed by name in the question whether to stop them."""


def stop_words(jobs: Jobs) -> str:
    """Return the question whether to stop running and waiting jobs; empty if there are none."""
    at_work = [job for job in jobs.jobs() if job.active]
    active = {job.number: job.title for job in at_work}
    waiting = [number for number in jobs.waiting() if number in active]
    groups = {"Running": [active[number] for number in active if number not in waiting]}
    groups["Waiting to start"] = [active[number] for number in waiting]
    parts = []
    for head, titles in groups.items():
        more = [f"and {len(titles) - LISTED} more"] if len(titles) > LISTED else []
        if titles:
            parts.append("\n".join((f"{head}:", *titles[:LISTED], *more)))
    if not parts:
        return ""
    said = [f"Stop {'it' if len(active) == 1 else 'them'}?"]
    if any(job.page == "acquire" for job in at_work):
        said.append("Recorded positions are kept.")
    if any(map(jobs.keeps, active)):
        said.append(
            "Complete planes of an H are kept next to its file. To resume, start the job again with the same file name."
        )
    return "\n\n".join((*parts, " ".join(said)))


class ProjectFiles(QObject):
    """Actions of the menu *Project* on project files.

    ``folder`` contains the list of recent projects and copies of unsaved work.
    """

    message = Signal(str, arguments=["text"])
    """A line of text for the log."""
    saved = Signal()
    """The project was saved."""
    begun = Signal()
    """An empty project was started."""

    def __init__(self, project: Project, jobs: Jobs, folder: Path, window: QWidget) -> None:
        super().__init__(window)
        self.project, self.jobs, self._window = project, jobs, window
        self.recent = RecentProjects(folder / "recent.json")
        self.rescue = Rescue(project, jobs, folder / "autosave", window)
        self.rescue.message.connect(self.message.emit)
        self.rescue.restored.connect(self._restore)
        self._lock: FileLock | None = None

    # -- beginning -------------------------------------------------------------------------------------
    def begin(self, path: Path | None = None) -> None:
        """Open the project given at the start, and offer unsaved work of windows that ended unexpectedly."""
        if path is None:
            self.rescue.look()
        else:
            self._open(path, then=lambda: self.rescue.look(path))

    def new(self) -> None:
        """Start an empty project, after asking about unsaved work."""
        if self.may_leave():
            self._start(ProjectState(), None, None)
            self.begun.emit()

    def open(self, path: Path | None = None) -> None:
        """Open a project file after asking about unsaved work; without a path, ask for one."""
        if path is None:
            name = QFileDialog.getOpenFileName(self._window, "Open project", "", KIND)[0]
            if not name:
                return
            path = Path(name)
        if self._answered():
            self._open(path)

    def _open(self, path: Path, then: Callable[[], None] | None = None) -> None:
        """Read a project in the background. The open project and its jobs stay until the new one is known to be valid.

        The user was already asked about unsaved work and running jobs.
        """
        asked = self._at_stake()

        def ended(action: Callable[[], None]) -> None:
            action()
            if then is not None:
                then()

        self.message.emit(f"opening {path} …")
        self.jobs.drop("project")
        self.jobs.load(
            "project",
            lambda: read_project(path),
            lambda state: ended(lambda: self._opened(path, state, asked)),
            lambda words: ended(
                lambda: self._refuse("Open project", words if path.name in words else f"{path.name}: {words}")
            ),
        )

    def _opened(self, path: Path, state: ProjectState, asked: Stake) -> None:
        changes, jobs = self._at_stake()
        if changes not in (None, asked[0]) or not jobs <= asked[1]:
            if self._answered():
                self._open(path)  # the changes may have been saved to this file
            return
        lock = self._claim(path)
        if lock is None:
            lock, copy = self._ask_about(path)
            if copy:
                self.jobs.cancel_all()
                self._start(replace(state, name=f"{path.stem} copy"), None, None, ProjectState())
                return
            if lock is None:
                return
        self.jobs.cancel_all()
        self._start(state, path, lock)
        self.recent.add(path)
        self.message.emit(f"opened {path}")

    def start_with(self, state: ProjectState) -> None:
        """Start a project that has no file. The open project is closed, so ask with `may_leave` first."""
        self._start(state, None, None)

    def _start(
        self, state: ProjectState, path: Path | None, lock: FileLock | None, saved: ProjectState | None = None
    ) -> None:
        self._hold(lock)
        self.project.start(state, path, saved)
        self.rescue.keep()
        refused = [*state.refused]
        for kind in PageSettings.__subclasses__():
            refused += kind.read(state.settings.get(kind.page))[1]
        if refused:
            self._refuse("Open project", f"ignored in the project file: {'; '.join(refused)[:400]}")
        if state.left_out:
            named, more = state.left_out[0][:200], len(state.left_out) - 1
            others = f" and {more} more" if more else ""
            self._refuse(
                "Open project",
                f"ignored in the project file: {named}{others}; opening a path on a network share would "
                "make this computer log on to that server. Choose the file again if you know it, or map "
                "the share to a drive letter",
            )

    # -- locks -----------------------------------------------------------------------------------------
    def _claim(self, path: Path) -> FileLock | None:
        """Return the lock of a project file; None if another window has it."""
        if self._lock is not None and self._lock.path == path:
            return self._lock
        lock = FileLock(path)
        return lock if lock.take() else None

    def _hold(self, lock: FileLock | None) -> None:
        if self._lock is not None and self._lock is not lock:
            self._lock.release()
        self._lock = lock

    def _ask_about(self, path: Path) -> tuple[FileLock | None, bool]:
        """Ask what to do with a project that is open elsewhere.

        Return its lock if it was taken over, and whether to open a copy.
        """
        lock = FileLock(path)
        who, away = lock.holder()
        box = QMessageBox(self._window)
        box.setIcon(QMessageBox.Icon.Question)
        box.setWindowTitle("The project is open elsewhere")
        box.setText(f"{path.name} is open in {who}.")
        box.setInformativeText("You can open a copy, and save it under another name.")
        copy = box.addButton("Open a copy", QMessageBox.ButtonRole.AcceptRole)
        copy.setProperty("role", "primary")
        # only the user can know whether a process of another machine has ended
        take = box.addButton("Open anyway", QMessageBox.ButtonRole.DestructiveRole) if away else None
        box.addButton(BUTTONS.Cancel)
        box.setDefaultButton(copy)
        box.exec()
        if take is not None and box.clickedButton() is take:
            if lock.take_over():
                return lock, False
            text = f"{path.name} is still open in {who}. Close it there and try again, or open a copy."
            QMessageBox.warning(self._window, "The project is open elsewhere", text)
        return None, box.clickedButton() is copy

    # -- restoring -------------------------------------------------------------------------------------
    def _restore(self, kept: UnsavedCopy) -> None:
        if not self.may_leave():
            self.rescue.later(kept)
            return
        lock = None if kept.path is None else self._claim(kept.path)
        # without its file, or with the file open elsewhere, it is saved under a new name
        self._start(kept.state, kept.path if lock is not None else None, lock, kept.on_disk or ProjectState())
        self.rescue.finish(kept)
        self.message.emit(f"restored {kept.name()}; it is not saved yet")

    # -- saving ----------------------------------------------------------------------------------------
    def save(self) -> bool:
        """Save the project; ask for a name the first time. Return whether the project was saved."""
        path = self.project.path
        if path is None:
            return self.save_as()
        if self.project.changed_on_disk and not may_replace(self._window, [path]):
            return False
        return self._save(path)

    def save_as(self) -> bool:
        """Ask for a new name and save the project; return whether the project was saved."""
        name = ask_target(self._window, "Save project", "project.lfcal", KIND)
        return bool(name) and self._save(Path(name))

    def _save(self, path: Path) -> bool:
        lock = self._claim(path)
        if lock is None:
            self._refuse("Save project", f"{path}: this project is open in another window; choose another name")
            return False
        try:
            self.project.save(path)
        except LfcalError as error:
            if lock is not self._lock:
                lock.release()
            self._refuse("Save project", str(error))
            return False
        self._hold(lock)
        self.rescue.forget()
        self.recent.add(path)
        self.saved.emit()
        self.message.emit(f"saved {path}")
        return True

    def _refuse(self, title: str, words: str) -> None:
        """Report in a dialog and in the log why something failed."""
        self.message.emit(words)
        QMessageBox.warning(self._window, title, words)

    def fill_recent(self, menu: QMenu) -> None:
        """Fill a menu with the recent projects."""
        menu.clear()
        for path in self.recent.paths():
            action = QAction(str(path), menu)
            action.triggered.connect(lambda _=False, path=path: self.open(path))
            menu.addAction(action)
        if menu.isEmpty():
            menu.addAction("No recent projects").setEnabled(False)

    # -- leaving ---------------------------------------------------------------------------------------
    def may_leave(self) -> bool:
        """Ask about running jobs and unsaved work; return whether to continue. Jobs stop after the last answer."""
        if not self._answered():
            return False
        self.jobs.cancel_all()
        return True

    def _at_stake(self) -> Stake:
        """Return what would be lost if another project were opened: the unsaved state, and the running jobs."""
        jobs = frozenset(job.number for job in self.jobs.jobs() if job.active)
        return self.project.state if self.project.unsaved else None, jobs

    def _answered(self) -> bool:
        """Ask about running jobs and unsaved work; return whether to continue. Jobs keep running meanwhile."""
        words = stop_words(self.jobs)
        if words:
            choices = BUTTONS.Yes | BUTTONS.No
            if QMessageBox.question(self._window, "Jobs are running", words, choices, BUTTONS.No) != BUTTONS.Yes:
                return False
        return self._may_lose_changes()

    def _may_lose_changes(self) -> bool:
        if not self.project.unsaved:
            return True
        choices = BUTTONS.Save | BUTTONS.Discard | BUTTONS.Cancel
        words = "Save the changes to this project?"
        answer = QMessageBox.question(self._window, "Unsaved changes", words, choices)
        if answer == BUTTONS.Save:
            return self.save()
        return answer == BUTTONS.Discard

    def close(self, *, answered: bool) -> None:
        """Release the files. Unless the user was asked about unsaved work (``answered``), a copy of it stays."""
        self.rescue.close(keep=not answered)
        self._hold(None)
