"""A simulation as a command. No Qt."""

from __future__ import annotations

from lfcal_gui.models import PLAN_FILE, CommandStep, ProjectState, needed_plan
from lfcal_gui.pages.simulate.model import SimulateSettings, matrix_task


def step(project: ProjectState, out: str = "") -> CommandStep:
    """Return the step that simulates H."""
    plan, settings = needed_plan(project), SimulateSettings.of(project)
    return CommandStep.of(matrix_task(settings, out or "simulated.h5"), ((PLAN_FILE, plan.to_json()),))
