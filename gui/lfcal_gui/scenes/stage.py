"""A window controlled by scenes, with functions that wait for it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PySide6.QtWidgets import QApplication, QWidget

from lfcal_gui.jobs import JobState
from lfcal_gui.window import MainWindow

LONGEST_S = 900.0
"""Longest waiting time (s)."""

TURNS = 8
"""Number of event-loop iterations after which layout and drawing are complete."""


@dataclass(frozen=True)
class Capture:
    """A state of the window: its name, and the widget to capture, by default the window of the current page.

    ``theme`` is the only theme of the state, if it has just one.
    """

    name: str
    widget: QWidget | None = None
    theme: str = ""


Scene = Callable[["Stage"], Iterator[Capture]]
"""Generator that brings the window to one state after the other, and yields each of them."""


class Stage:
    """The window, a folder for files that scenes make, and functions that wait.

    Parameters
    ----------
    app, window
        The application and its window, which is shown.
    folder
        Folder in which files that take long to make are kept.
    """

    def __init__(self, app: QApplication, window: MainWindow, folder: Path) -> None:
        self.app, self.window, self.folder = app, window, folder
        folder.mkdir(parents=True, exist_ok=True)

    def page(self, key: str) -> Any:
        """Show a page, wait for its computations, and return it."""
        self.window.go(key)
        self.settle()
        return self.window.page(key)

    def turn(self, turns: int = TURNS) -> None:
        """Process the events of the window for a moment."""
        for _ in range(turns):
            self.app.processEvents()
            time.sleep(0.005)

    def until(self, condition: Callable[[], object], what: str) -> None:
        """Process events until ``condition`` is true; raise an error after `LONGEST_S`."""
        end = time.monotonic() + LONGEST_S
        while not condition():
            if time.monotonic() > end:
                raise TimeoutError(f"waited {LONGEST_S:.0f} s for {what}")
            self.turn(1)

    @property
    def busy(self) -> bool:
        """Whether a computation is running, or H is about to be judged."""
        return self.window.jobs.busy or self.window.leading.due

    def settle(self) -> None:
        """Wait until all computations have ended and everything is drawn."""
        quiet = 0
        while quiet < TURNS:
            self.until(lambda: not self.busy, "jobs to end")
            self.turn(1)
            quiet = 0 if self.busy else quiet + 1
        self.turn()

    def done(self) -> None:
        """Wait as `settle` does; raise an error if a job failed."""
        self.settle()
        for job in self.window.jobs.jobs():
            if job.state is JobState.FAILED:
                raise RuntimeError(f"{job.title}: {job.error}")

    def seen(self, capture: Capture) -> QWidget:
        """Return the widget to capture in a state: by default, the window of the current page."""
        return capture.widget or self.window.shown.window()

    def resize(self, width: int, height: int) -> None:
        """Resize the main window and the window of the current page."""
        for one in (self.window, self.window.shown.window()):
            one.resize(width, height)

    def tidy(self) -> None:
        """Clear the text of the status bar, and hide the list of jobs."""
        self.window.message.setText("")
        self.window.job_line.sheet.hide()
        self.turn()
