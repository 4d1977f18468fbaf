"""A simulation as a command. No Qt."""

from __future__ import annotations

from pathlib import Path

from lfcal.tasks import SimulateH, SimulatePasses, python_of, words_of
from lfcal_gui.models import PLAN_FILE, CommandStep, ProjectState, needed_plan
from lfcal_gui.pages.simulate.model import SimulateSettings
from lfcal_gui.pages.simulate.model_files import settings_text

__all__ = ["step"]

EFFECTS_FILE = "lfcal-effects.json"


def step(project: ProjectState, out: str = "") -> CommandStep:
    """Return how H is simulated."""
    plan, chosen = needed_plan(project), SimulateSettings.of(project)
    given = bool(chosen.effects() or chosen.choices())
    kind = SimulatePasses if chosen.passes else SimulateH
    task = kind(
        camera=PLAN_FILE,
        effects=(EFFECTS_FILE,) if given else (),
        tolerance=chosen.tolerance,
        level=chosen.level,
        out=Path(out or "simulated.h5"),
    )
    files = ((PLAN_FILE, plan.to_json()), *(((EFFECTS_FILE, settings_text(chosen)),) if given else ()))
    return CommandStep(words_of(task), python_of(task), files)
