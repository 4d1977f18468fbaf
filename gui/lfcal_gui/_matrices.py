"""The PSF matrices of the window: opened in the background, and stored by the path of their file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QObject, Signal

from lfcal_gui.jobs import Jobs

if TYPE_CHECKING:
    from lfcal.psf import PSFMatrix


class Matrices(QObject):
    """Open H files in the background; `get` returns None for a file that is not open, and `changed` reports changes.

    ``order_of`` returns the order of the axes of H that the project states for a file; empty: none.
    """

    changed = Signal(str, arguments=["path"])
    """A matrix was opened or closed, or could not be opened."""
    failed = Signal(str, arguments=["words"])
    """Why a file of the project could not be opened."""

    def __init__(self, jobs: Jobs, order_of: Callable[[str], str], parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._jobs, self._order_of = jobs, order_of
        self._orders: dict[str, str] = {}
        self._open: dict[str, PSFMatrix] = {}
        self._problems: dict[str, str] = {}

    def get(self, path: str) -> PSFMatrix | None:
        """Return the matrix of a file if it is open."""
        return self._open.get(path)

    def problem(self, path: str) -> str:
        """Return a one-line reason why a file could not be opened, or an empty string."""
        return self._problems.get(path, "")

    def opening(self, path: str) -> bool:
        """Return whether a file is being opened."""
        return self._jobs.loading(_group(path))

    def want(self, path: str) -> None:
        """Open a file in the background unless it is open, being opened, or known not to open."""
        if path and path not in self._open and path not in self._problems and not self.opening(path):
            self.take(path)

    def take(
        self, path: str, then: Callable[[], None] | None = None, refused: Callable[[str], None] | None = None
    ) -> None:
        """Open a file again. An open one stays open until the new one is valid.

        Parameters
        ----------
        path
            The file.
        then
            Function that is called when the file is open.
        refused
            Function that is called with a one-line reason if the file cannot be opened. None: `failed` is emitted.
            `problem` also returns the reason, unless the file is still open from before.
        """

        def opened(matrix: PSFMatrix) -> None:
            self.put(path, matrix)
            if then is not None:
                then()

        def failed(words: str) -> None:
            (refused or self.failed.emit)(words)
            if path not in self._open:
                self._problems[path] = words
                self.changed.emit(path)

        self._problems.pop(path, None)
        self._jobs.drop(_group(path))
        order = self._orders[path] = self._order_of(path)
        self._jobs.load(_group(path), lambda: _open_file(path, order), opened, failed, lambda matrix: matrix.close())
        self.changed.emit(path)

    def follow_orders(self) -> None:
        """Reopen each file whose stated order of axes has changed since it was opened."""
        for path, order in list(self._orders.items()):
            if order != self._order_of(path):
                self.take(path)

    def cancel(self, path: str) -> None:
        """Cancel the opening of a file."""
        if self.opening(path):
            self._jobs.drop(_group(path))
            self._problems[path] = f"{Path(path).name} was not opened, because you stopped the job"
            self.changed.emit(path)

    def put(self, path: str, matrix: PSFMatrix) -> None:
        """Store an open matrix as the matrix of the file ``path``; a previous one is closed."""
        old = self._open.pop(path, None)
        if old is not None:
            old.close()
        self._problems.pop(path, None)
        self._open[path] = matrix
        self.changed.emit(path)

    def forget(self, path: str) -> None:
        """Close a matrix, so that its file can be replaced or read again."""
        self._jobs.drop(_group(path))
        self._problems.pop(path, None)
        self._orders.pop(path, None)
        matrix = self._open.pop(path, None)
        if matrix is not None:
            matrix.close()
            self.changed.emit(path)

    def close(self) -> None:
        """Close all files; no more signals are emitted."""
        self.blockSignals(True)
        for path in list(self._open):
            self.forget(path)


def _group(path: str) -> str:
    return f"open {path}"


def _open_file(path: str, order: str) -> PSFMatrix:
    from lfcal.psf import open_psf

    return open_psf(path, mat_order=order)
