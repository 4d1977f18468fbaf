"""Search of folders in the background, with pictures of the visible results."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QObject, Signal

from lfcal.base import LfcalError
from lfcal_gui.jobs import Jobs
from lfcal_gui.models import ProjectState
from lfcal_gui.pages.sessions.model import Verdict, can_judge, verdict_on
from lfcal_gui.pages.sessions.model_kept import KeptResults

if TYPE_CHECKING:
    from lfcal.judge import ResultList, StoredResult

AT_ONCE = 4
"""Number of pictures that are read before the visible results are determined again."""

Seen = tuple["StoredResult", Verdict | None]


class Looking(QObject):
    """Search folders in a thread, so that a slow disk does not delay the window.

    Parameters
    ----------
    jobs, kept
        Jobs of the window, and cache of pictures and verdicts.
    """

    began = Signal()
    """A search of other folders has started."""
    found = Signal(object, str, arguments=["results", "words"])
    """Results found since the last signal, with their verdicts, and the current folder of the search."""
    ended = Signal(object, arguments=["listing"])
    """The search is complete."""
    failed = Signal(str, arguments=["words"])
    """Why the search failed."""
    pictured = Signal(object, object, arguments=["path", "picture"])
    """The picture of a result; None if it has none."""

    def __init__(self, jobs: Jobs, kept: KeptResults, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._jobs, self.kept = jobs, kept
        self._stop = threading.Event()
        self._wanted: list[StoredResult] = []

    @property
    def active(self) -> bool:
        """Whether folders are being searched."""
        return self._jobs.loading("sessions list")

    def start(self, folders: Sequence[str], project: ProjectState) -> None:
        """Search these folders instead of the previous ones; ``project`` may contain a verdict on an H."""
        self.stop()
        self._stop = stop = threading.Event()
        self._wanted.clear()
        self._jobs.load(
            "sessions list",
            lambda: self._list(folders, project, stop),
            lambda listing: None if listing is None else self.ended.emit(listing),
            self.failed.emit,
        )
        self.began.emit()

    def stop(self) -> None:
        """Stop searching; results found so far are kept."""
        self._stop.set()
        self._jobs.drop("sessions list")

    def _list(self, folders: Sequence[str], project: ProjectState, stop: threading.Event) -> ResultList | None:
        """Search folders in a thread; return None if stopped."""
        from lfcal.judge import ListingProgress, iter_find_results

        self.kept.sweep()
        work = iter_find_results(*folders)
        try:
            while not stop.is_set():
                step = next(work)
                if isinstance(step, ListingProgress):
                    seen = [(one, self._verdict(one, project)) for one in step.found]
                    self._jobs.hand_over(partial(self._show_progress, stop, seen, step.stage))
        except StopIteration as end:
            listing: ResultList = end.value
            return listing
        finally:
            work.close()
        return None

    def _verdict(self, result: StoredResult, project: ProjectState) -> Verdict | None:
        if not can_judge(result):
            return None
        return verdict_on(result, project) or self.kept.verdict(result)

    def _show_progress(self, stop: threading.Event, seen: list[Seen], words: str) -> None:
        if not stop.is_set():
            self.found.emit(seen, words)

    # -- pictures --------------------------------------------------------------------------------------
    def want(self, results: Sequence[StoredResult]) -> None:
        """Read the pictures of these results, which are visible, before those requested earlier."""
        self._wanted = [*results, *(one for one in self._wanted if one not in results)][:100]
        self._next()

    def _next(self) -> None:
        if self._wanted and not self._jobs.loading("sessions pictures"):
            now, self._wanted = self._wanted[:AT_ONCE], self._wanted[AT_ONCE:]
            self._jobs.load("sessions pictures", lambda: self._pictures(now), self._show, lambda _: self._next())

    def _pictures(self, results: Sequence[StoredResult]) -> list[tuple[Path, NDArray[np.uint8] | None]]:
        found = []
        for one in results:
            try:
                picture = self.kept.picture(one)
            except (LfcalError, OSError):  # gone or damaged since; its tile says what it was
                picture = None
            found.append((one.path, picture))
        return found

    def _show(self, found: list[tuple[Path, NDArray[np.uint8] | None]]) -> None:
        for path, picture in found:
            self.pictured.emit(path, picture)
        self._next()
