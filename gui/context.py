"""What a page may use of the window: the project, the jobs, messages, and going to another page."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from PySide6.QtCore import QObject, Signal

from gui.jobs import Jobs
from gui.models.project import Project, ProjectState
from lfcal.psf import PSFMatrix

__all__ = ["Context"]


class Context(QObject):
    """Handed to every page; the only thing pages share.

    Signals
    -------
    state_changed(old, new)
        The project changed (`gui.models.project.ProjectState` before and after).
    go(page, payload)
        A page asks for another page by its key, with something to show there, e.g. ``("frames", (z, y, x))``.
    message(text)
        A line for the log and the status bar.
    attention(page, flag)
        A page found something that needs the user.
    theme_changed()
        Colours changed; plots redraw.
    """

    state_changed = Signal(object, object)
    go = Signal(str, object)
    message = Signal(str)
    attention = Signal(str, bool)
    theme_changed = Signal()

    def __init__(self, project: Project, jobs: Jobs, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self.project, self.jobs = project, jobs
        self._matrices: dict[str, PSFMatrix] = {}
        self._closers: list[Callable[[], None]] = []
        project.listen(self.state_changed.emit)

    @property
    def state(self) -> ProjectState:
        """The project's state."""
        return self.project.state

    def matrix(self, path: str) -> PSFMatrix | None:
        """Return the opened PSF matrix of a file, None where there is none; raises what opening it raises."""
        if not path or not Path(path).exists():
            return None
        if path not in self._matrices:
            from lfcal.psf import open_psf

            self._matrices[path] = open_psf(path)
        return self._matrices[path]

    def forget(self, path: str) -> None:
        """Close a PSF matrix, so that its file may be replaced or is read anew."""
        matrix = self._matrices.pop(path, None)
        if matrix is not None:
            matrix.close()

    def on_close(self, closer: Callable[[], None]) -> None:
        """Call ``closer`` when the window closes and no thread is at work any more: devices and files are let go."""
        self._closers.append(closer)

    def close(self) -> None:
        """Close what pages hold, and all files."""
        while self._closers:
            self._closers.pop()()
        for path in list(self._matrices):
            self.forget(path)
