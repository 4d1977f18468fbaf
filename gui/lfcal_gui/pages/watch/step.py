"""A watched series as a command. No Qt."""

from __future__ import annotations

from lfcal_gui.models import CommandStep, ProjectState
from lfcal_gui.pages.watch.model import WatchSettings, task_of


def step(project: ProjectState, out: str = "") -> CommandStep:
    """Return the step that checks the frames; with a folder ``out``, it also recalibrates H after a drift."""
    return CommandStep.of(task_of(WatchSettings.of(project), project, out))
