"""The results of a folder over time as a command. No Qt."""

from __future__ import annotations

from lfcal.base import InputError
from lfcal_gui.models import CommandStep, ProjectState
from lfcal_gui.pages.sessions.model import SessionsSettings, own_folders


def step(project: ProjectState, out: str = "") -> CommandStep:
    """Return the step that compares the quality reports of the searched folder over time."""
    folder = SessionsSettings.of(project).folder or next(iter(own_folders(project, None)), "")
    if not folder:
        raise InputError("Sessions: no folder to search; choose one")
    python = f"""
from pathlib import Path
from lfcal.judge import inspections_in, read_inspection, trend

found = trend([read_inspection(path, path.parent.name) for path in inspections_in(Path({folder!r}))])
print(found.to_dict())
"""
    return CommandStep(("trend", "--quality", folder, *((f"--out={out}",) if out else ())), python)
