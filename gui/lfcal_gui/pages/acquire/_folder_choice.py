"""The folder of a session: chosen, and looked into in the background, for a disk may hang."""

from __future__ import annotations

from collections.abc import Callable

from PySide6.QtWidgets import QFileDialog, QLineEdit

from lfcal_gui.context import Context
from lfcal_gui.pages.acquire.model_recorder import FolderState, folder_state

__all__ = ["FolderChoice"]

CHOSEN, LOOKED_INTO = "acquire folder chosen", "acquire folder"


class FolderChoice:
    """The project's session folder.

    Parameters
    ----------
    context, edit
        Of the page, and where the folder stands.
    seen
        Called with what the project's folder holds.
    refused
        Called with why one is not taken.
    """

    def __init__(
        self,
        context: Context,
        edit: QLineEdit,
        seen: Callable[[FolderState], None],
        refused: Callable[[str], None],
    ) -> None:
        self.context, self.edit = context, edit
        self._seen, self._refused = seen, refused

    def ask(self, then: Callable[[], None] | None = None) -> None:
        """Ask for a folder, and do ``then`` once it is taken."""
        path = QFileDialog.getExistingDirectory(self.edit, "Folder of the session")
        if path:
            self.take(path, then)

    def take(self, path: str, then: Callable[[], None] | None = None) -> None:
        """Record into (or go on in) another folder, unless what it holds is damaged."""

        def seen(found: FolderState) -> None:
            if found.problem:
                self.edit.setText(self.context.state.recording)
                self._refused(found.problem)
            else:
                self.context.project.update("session folder", recording=path)
                if then is not None:
                    then()

        self.context.jobs.drop(CHOSEN)
        self.context.jobs.load(CHOSEN, lambda: folder_state(path), seen, self._refused)

    def look(self) -> None:
        """Look into the project's folder."""
        path = self.context.state.recording
        self.context.jobs.drop(LOOKED_INTO)  # it may hang
        self.context.jobs.load(LOOKED_INTO, lambda: folder_state(path), self._seen)

    def let_go(self) -> None:
        """Open none any more for the project before."""
        self.context.jobs.drop(CHOSEN)
        self.context.jobs.drop(LOOKED_INTO)
