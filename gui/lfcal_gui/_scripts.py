"""Scripts of the steps done in the window, or of the current page, for the clipboard or a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from PySide6.QtWidgets import QApplication

from lfcal.base import LfcalError
from lfcal_gui.models import step_of
from lfcal_gui.saving import ask_target, write_file

NONE_YET = "no step so far corresponds to a command"


class Scripts:
    """Copies and saves scripts for a `lfcal_gui.window.MainWindow`."""

    def __init__(self, window: Any) -> None:
        self._window = window

    def copy_step(self, *, python: bool = False) -> None:
        """Copy the step of the page to the clipboard as a command or as Python code, or report what is missing."""
        window = self._window
        spec, part = window.shown.spec, window.shown.part
        try:
            step = step_of(spec, window.project.state, window.context.history.latest(part or spec.key), part)
            QApplication.clipboard().setText(step.script() if python else step.shell())
        except LfcalError as error:
            window.log(f"{spec.title}: nothing copied; {error}")
            return
        window.log(f"{spec.title} copied as {'Python' if python else 'a command'}")

    def copy_history(self) -> None:
        """Copy the steps done in this window to the clipboard as a shell script."""
        history = self._window.context.history
        if not history.taken:
            self._window.log(f"nothing copied; {NONE_YET}")
            return
        QApplication.clipboard().setText(history.shell())
        self._window.log(f"steps copied as a script: {len(history.taken)}")

    def save_history(self, path: str = "") -> None:
        """Save the steps done in this window as a shell script or a Python script."""
        window, history = self._window, self._window.context.history
        if not history.taken:
            window.log(f"nothing saved; {NONE_YET}")
            return
        path = path or ask_target(window, "Save history", "history.sh", "Shell script (*.sh);;Python script (*.py)")
        text = history.python() if Path(path).suffix.lower() == ".py" else history.shell()
        if path and write_file(window, path, lambda part: part.write_text(text, encoding="utf-8")):
            window.log(f"steps saved as {path}: {len(history.taken)}")
