"""The window's own copy of unsaved work, and the copies that dead windows left."""

from __future__ import annotations

import uuid
from collections.abc import Callable
from pathlib import Path

from PySide6.QtCore import QObject, QTimer, Signal
from PySide6.QtWidgets import QWidget

from lfcal.base import LfcalError
from lfcal_gui.jobs import Jobs
from lfcal_gui.locks import FileLock
from lfcal_gui.models import Claim, Project, UnsavedCopy, find_kept, keep
from lfcal_gui.restore_dialog import RestoreDialog

AUTOSAVE_MS = 30_000


class Rescue(QObject):
    """Keep a copy of unsaved work; offer those of windows that ended without being closed.

    Parameters
    ----------
    project, jobs
        The window's.
    folder
        Where the copies of all windows are.
    window
        Parent of the dialog.

    Signals
    -------
    message(text)
        A line for the log.
    restored(kept)
        The user wants this copy back; `finish` ends what is done with it.
    """

    message = Signal(str)
    restored = Signal(object)

    def __init__(self, project: Project, jobs: Jobs, folder: Path, window: QWidget) -> None:
        super().__init__(window)
        self.project, self.jobs, self._window = project, jobs, window
        self.folder = folder
        self.file = folder / f"{uuid.uuid4().hex[:12]}.lfcal"
        self._lock = FileLock(self.file)
        self._waiting: list[tuple[UnsavedCopy, Claim]] = []
        self.dialog: RestoreDialog | None = None
        self._timer = QTimer(self)
        self._timer.setInterval(AUTOSAVE_MS)
        self._timer.timeout.connect(self.keep)
        self._timer.start()

    # -- the own copy ----------------------------------------------------------------------------------
    def keep(self) -> str:
        """Keep a copy of unsaved work and return its name; empty: there is nothing to keep, or it failed."""
        if not self.project.unsaved:
            self.forget()
            return ""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._lock.take()
            keep(self.project, self.file)
        except (LfcalError, OSError) as error:
            self.message.emit(f"no copy of the unsaved work could be kept: {error}")
            return ""
        return str(self.file)

    def forget(self) -> None:
        """Remove the copy: there is nothing that is not saved."""
        self.file.unlink(missing_ok=True)
        self._lock.release()

    # -- copies of others ------------------------------------------------------------------------------
    def look(self, of: Path | None = None, *, asked: bool = False) -> None:
        """Find unsaved copies and offer them: all, or those of the project ``of``.

        With ``asked`` a message says if there are none.
        """
        self._release()
        folder = self.folder
        self.jobs.load(
            "autosave",
            lambda: find_kept(folder, FileLock),
            lambda found: self._found(found, of, asked),
            self.message.emit,
            _let_go,
        )

    def _found(self, found: list[tuple[UnsavedCopy, Claim]], of: Path | None, asked: bool) -> None:
        mine = [entry for entry in found if of is None or entry[0].project == str(of.absolute())]
        _let_go([entry for entry in found if entry not in mine])
        if len(mine) < len(found):
            self.message.emit("unsaved work of another project was found: Project > Restore unsaved work")
        if asked and not found:
            self.message.emit("no unsaved work of an earlier window was found")
        self._waiting = mine
        self._ask()

    def _ask(self) -> None:
        if not self._waiting:
            return
        kept, _ = self._waiting[0]
        self.dialog = RestoreDialog(kept, self._window)
        self.dialog.restore_asked.connect(lambda: self.restored.emit(kept))
        self.dialog.discard_asked.connect(lambda: self._end(kept, lambda: kept.file.unlink(missing_ok=True)))
        self.dialog.later_asked.connect(lambda: self.later(kept))
        self.dialog.open()

    def _end(self, kept: UnsavedCopy, action: Callable[[], None]) -> None:
        """Do ``action`` with the copy asked about, and ask about the next."""
        action()
        _let_go([entry for entry in self._waiting if entry[0] is kept])
        self._waiting = [entry for entry in self._waiting if entry[0] is not kept]
        self._ask()

    def later(self, kept: UnsavedCopy) -> None:
        """Leave the copy to the next start."""
        self._end(kept, lambda: None)

    def finish(self, kept: UnsavedCopy) -> None:
        """Keep the copy as this window's own work, and only then remove it; others wait for later."""
        if self.keep() or not self.project.unsaved:
            kept.file.unlink(missing_ok=True)
        if len(self._waiting) > 1:
            self.message.emit("more unsaved work was found: Project > Restore unsaved work")
        self._release()

    def _release(self) -> None:
        _let_go(self._waiting)
        self._waiting = []

    def close(self, *, keep: bool) -> None:
        """Stop; ``keep``: unsaved work waits for the next window, else it was saved or is not wanted."""
        self._timer.stop()
        self._release()
        if self.dialog is not None:
            self.dialog.close()
        if keep:
            self.keep()
        else:
            self.forget()
        self._lock.release()


def _let_go(entries: list[tuple[UnsavedCopy, Claim]]) -> None:
    for _, claim in entries:
        claim.release()
