"""Copy of the window's unsaved work, and copies left by windows that ended unexpectedly."""

from __future__ import annotations

import uuid
from collections.abc import Callable
from pathlib import Path

from PySide6.QtCore import QObject, Qt, QTimer, Signal
from PySide6.QtGui import QCloseEvent
from PySide6.QtWidgets import QDialog, QHBoxLayout, QLabel, QPushButton, QVBoxLayout, QWidget

from lfcal.base import LfcalError
from lfcal_gui.jobs import Jobs
from lfcal_gui.locks import FileLock
from lfcal_gui.models import Claim, Project, UnsavedCopy, find_kept, keep
from lfcal_gui.theme import style_sheet

WIDTH = 540


class RestoreDialog(QDialog):
    """Dialog that offers to restore a copy of unsaved work. Closing it postpones the decision."""

    restore_asked, discard_asked, later_asked = Signal(), Signal(), Signal()
    """Exactly one of them is emitted."""

    def __init__(self, kept: UnsavedCopy, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setStyleSheet(style_sheet())
        self.setWindowTitle("Unsaved work was found")
        self._answered = False
        column = QVBoxLayout(self)
        column.setContentsMargins(18, 16, 18, 14)
        column.setSpacing(10)
        heading = QLabel(f"Restore {kept.name()}?", textFormat=Qt.TextFormat.PlainText, wordWrap=True)
        heading.setProperty("role", "title")
        why = QLabel("lfcal ended unexpectedly. This copy contains changes that were not saved.")
        self.words = QLabel("\n".join(kept.words()), textInteractionFlags=Qt.TextInteractionFlag.TextSelectableByMouse)
        for label in (why, self.words):
            label.setWordWrap(True)
            label.setTextFormat(Qt.TextFormat.PlainText)
        for widget in (heading, why, self.words):
            column.addWidget(widget)
        if not kept.newer:
            hint = QLabel("Restoring does not overwrite that file. You choose a name when you save.")
            hint.setProperty("role", "hint")
            column.addWidget(hint)
        column.addLayout(self._buttons())
        self.restore.setFocus()
        self.setMinimumWidth(WIDTH)
        self.resize(WIDTH, column.heightForWidth(WIDTH))  # the size hint of a wrapping label is too high

    def _buttons(self) -> QHBoxLayout:
        row = QHBoxLayout()
        self.restore, self.discard, self.later = QPushButton("Restore"), QPushButton("Discard"), QPushButton("Later")
        self.restore.setProperty("role", "primary")
        self.restore.setDefault(True)
        self.restore.setToolTip("Open the unsaved copy. Save the project afterwards to keep it")
        self.discard.setToolTip("Delete the copy permanently")
        self.later.setToolTip("Keep the copy, and ask again at the next start")
        self.discard.setAutoDefault(False)
        for button, signal in (
            (self.restore, self.restore_asked),
            (self.discard, self.discard_asked),
            (self.later, self.later_asked),
        ):
            button.clicked.connect(lambda _=False, signal=signal: self._answer(signal))
        row.addWidget(self.discard)
        row.addStretch()
        row.addWidget(self.later)
        row.addWidget(self.restore)
        return row

    def _answer(self, signal: object) -> None:
        if not self._answered:
            self._answered = True
            self.close()
            signal.emit()  # type: ignore[attr-defined]

    def reject(self) -> None:
        """Postpone the decision when Escape is pressed."""
        self._answer(self.later_asked)

    def closeEvent(self, event: QCloseEvent) -> None:
        """Postpone the decision."""
        event.accept()
        self._answer(self.later_asked)


AUTOSAVE_MS = 30_000


class Rescue(QObject):
    """Store a copy of unsaved work in ``folder``, and offer copies of windows that ended unexpectedly."""

    message = Signal(str, arguments=["text"])
    """A line for the log."""
    restored = Signal(object, arguments=["kept"])
    """The user chose to restore this copy; call `finish` afterwards."""

    def __init__(self, project: Project, jobs: Jobs, folder: Path, window: QWidget) -> None:
        super().__init__(window)
        self.project, self.jobs, self._window = project, jobs, window
        self.folder = folder
        self.file = folder / f"{uuid.uuid4().hex[:12]}.lfcal"
        self._lock = FileLock(self.file)
        self._waiting: list[tuple[UnsavedCopy, Claim]] = []
        self.dialog: RestoreDialog | None = None
        self._timer = QTimer(self, interval=AUTOSAVE_MS)
        self._timer.timeout.connect(self.keep)
        self._timer.start()

    # -- the own copy ----------------------------------------------------------------------------------
    def keep(self) -> str:
        """Store a copy of unsaved work and return its path; empty if there is none or storing it failed."""
        if not self.project.unsaved:
            self.forget()
            return ""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._lock.take()
            keep(self.project, self.file)
        except (LfcalError, OSError) as error:
            self.message.emit(f"the unsaved work could not be copied: {error}")
            return ""
        return str(self.file)

    def forget(self) -> None:
        """Remove the copy, because the project is saved."""
        self.file.unlink(missing_ok=True)
        self._lock.release()

    # -- copies of others ------------------------------------------------------------------------------
    def look(self, of: Path | None = None, *, asked: bool = False) -> None:
        """Find copies of unsaved work and offer them: all, or those of the project ``of``.

        With ``asked``, a message reports if there are none.
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
            self.message.emit(
                "unsaved work of another project was found; to restore it, choose Project > Restore unsaved work"
            )
        if asked and not found:
            self.message.emit("no unsaved work was found")
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
        """Do ``action`` with the offered copy, and offer the next one."""
        action()
        _let_go([entry for entry in self._waiting if entry[0] is kept])
        self._waiting = [entry for entry in self._waiting if entry[0] is not kept]
        self._ask()

    def later(self, kept: UnsavedCopy) -> None:
        """Keep the copy, to be offered at the next start."""
        self._end(kept, lambda: None)

    def finish(self, kept: UnsavedCopy) -> None:
        """Store the restored work as a copy of this window, and then remove the old copy.

        Other copies are kept for later.
        """
        if self.keep() or not self.project.unsaved:
            kept.file.unlink(missing_ok=True)
        if len(self._waiting) > 1:
            self.message.emit("more unsaved work was found; to restore it, choose Project > Restore unsaved work")
        self._release()

    def _release(self) -> None:
        _let_go(self._waiting)
        self._waiting = []

    def close(self, *, keep: bool) -> None:
        """Stop. With ``keep``, a copy of unsaved work is kept for the next start; otherwise it is removed."""
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
