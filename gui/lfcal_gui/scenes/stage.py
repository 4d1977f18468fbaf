"""A window that is led from outside, and what waits for it."""

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
"""Ends what hangs."""

TURNS = 8
"""Turns of the window's thread until what was asked for is laid out and drawn."""


@dataclass(frozen=True)
class Capture:
    """A state of the window: its name, and the widget to capture, by default the window of the current page.

    ``theme`` is the only theme of the state, if it has just one.
    """

    name: str
    widget: QWidget | None = None
    theme: str = ""


Scene = Callable[["Stage"], Iterator[Capture]]
"""Leads the window from one state to the next; each is looked at where it is yielded."""


class Stage:
    """The window, a folder for what is made on the way, and waiting.

    Parameters
    ----------
    app, window
        The application and its window, which is shown.
    folder
        Files that take long to make are found here again.
    """

    def __init__(self, app: QApplication, window: MainWindow, folder: Path) -> None:
        self.app, self.window, self.folder = app, window, folder
        folder.mkdir(parents=True, exist_ok=True)

    def page(self, key: str) -> Any:
        """Show a page, wait for what it computes, and return it."""
        self.window.go(key)
        self.settle()
        return self.window.page(key)

    def turn(self, turns: int = TURNS) -> None:
        """Let the window work for a moment."""
        for _ in range(turns):
            self.app.processEvents()
            time.sleep(0.005)

    def until(self, condition: Callable[[], object], what: str) -> None:
        """Let the window work until ``condition`` holds; raise where it never does."""
        end = time.monotonic() + LONGEST_S
        while not condition():
            if time.monotonic() > end:
                raise TimeoutError(f"waited {LONGEST_S:.0f} s for {what}")
            self.turn(1)

    @property
    def busy(self) -> bool:
        """Whether something is computed, or H is about to be judged."""
        return self.window.jobs.busy or self.window.leading.due

    def settle(self) -> None:
        """Wait until nothing is computed, and all is drawn."""
        quiet = 0
        while quiet < TURNS:
            self.until(lambda: not self.busy, "jobs to end")
            self.turn(1)
            quiet = 0 if self.busy else quiet + 1
        self.turn()

    def done(self) -> None:
        """Wait as `settle` does; raise where a job failed."""
        self.settle()
        for job in self.window.jobs.jobs():
            if job.state is JobState.FAILED:
                raise RuntimeError(f"{job.title}: {job.error}")

    def seen(self, capture: Capture) -> QWidget:
        """Return what is looked at in a state: by default the window of the page in front."""
        return capture.widget or self.window.shown.window()

    def resize(self, width: int, height: int) -> None:
        """Give the window this size, and the one of the page in front, too."""
        for one in (self.window, self.window.shown.window()):
            one.resize(width, height)

    def tidy(self) -> None:
        """Let the line of the status bar and the jobs that have ended go."""
        self.window.message.setText("")
        self.window.job_line.sheet.hide()
        self.turn()
