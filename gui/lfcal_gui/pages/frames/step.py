"""Assembly as a command. No Qt."""

from __future__ import annotations

from lfcal.tasks import python_of, words_of
from lfcal_gui.models import PLAN_FILE, CommandStep, ProjectState, needed_file, needed_plan
from lfcal_gui.pages.frames.model import FrameSettings, task_of


def step(project: ProjectState, out: str = "") -> CommandStep:
    """Return the step that assembles H from the frames."""
    frames = needed_file(project.frames, "frames", "Folder")
    plan = needed_plan(project)
    task = task_of(FrameSettings.of(project), frames, out or "H.h5", PLAN_FILE)
    return CommandStep(words_of(task), python_of(task), ((PLAN_FILE, plan.to_json()),))
