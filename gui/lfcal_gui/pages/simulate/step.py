"""A simulation as a command. No Qt."""

from __future__ import annotations

from lfcal_gui.models import PLAN_FILE, CommandStep, ProjectState, needed_plan, options_of
from lfcal_gui.pages.simulate.model import SimulateSettings
from lfcal_gui.pages.simulate.model_files import settings_text

__all__ = ["step"]

EFFECTS_FILE = "lfcal-effects.json"


def step(project: ProjectState, out: str = "") -> CommandStep:
    """Return how H is simulated."""
    plan, chosen = needed_plan(project), SimulateSettings.of(project)
    out = out or "simulated.h5"
    given = bool(chosen.effects() or chosen.choices())
    files = ((PLAN_FILE, plan.to_json()), *(((EFFECTS_FILE, settings_text(chosen)),) if given else ()))
    pairs = (
        ("--tolerance", repr(chosen.tolerance)),
        ("--level", chosen.level),
        ("--effects", EFFECTS_FILE if given else ""),
        ("--progressive", chosen.passes),
        ("--out", out),
    )
    known = f"parse_entries({EFFECTS_FILE!r})" if given else "{}, ()"
    python = f"""
from lfcal.camera import ScanPlan
from lfcal.simulate import plan_effects, simulate_psf
from lfcal.simulate.effects.described import parse_entries

plan = ScanPlan.from_json(Path({PLAN_FILE!r}).read_text(encoding="utf-8"))
settings, given = {known}
effects = plan_effects(plan, {chosen.tolerance!r}, settings, effects=given)
H = simulate_psf(
    plan, effects, {chosen.level!r}, tolerance={chosen.tolerance!r}, out={out!r}
)
print(H.shape)
"""
    return CommandStep(("simulate", PLAN_FILE, *options_of(pairs)), python, files)
