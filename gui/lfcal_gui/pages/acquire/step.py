"""A recording, and H made of it, as commands. No Qt."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from lfcal.acquire import RedoList
from lfcal.base import InputError
from lfcal.frames import CorrectionRecipe
from lfcal.tasks import RunSettings
from lfcal_gui.models import PLAN_FILE, CommandStep, ProjectState, needed_plan
from lfcal_gui.pages.acquire.model import AcquireSettings
from lfcal_gui.pages.acquire.model_assembly import task_of

__all__ = ["REDO_FILE", "assembled", "step"]

REDO_FILE = "lfcal-redo.json"


def step(
    project: ProjectState, out: str = "", *, resume: bool = False, redo: Sequence[tuple[int, int, int]] = ()
) -> CommandStep:
    """Return how the session is recorded, continued, or of which positions again."""
    plan, chosen = needed_plan(project), AcquireSettings.of(project)
    begun, listed = resume or bool(redo), REDO_FILE if redo else ""
    out = out or project.recording or "session"
    origin = plan.stage.origin_um
    task = chosen.task(chosen.target or PLAN_FILE, out, begun=begun, redo=listed, origin=origin)
    files: tuple[tuple[str, str], ...] = () if chosen.target else ((PLAN_FILE, plan.to_json()),)
    files += ((REDO_FILE, RedoList.of(redo).to_json()),) if redo else ()
    return CommandStep.of(task, files, RunSettings(resume=resume))


def assembled(folder: str, out: str, planes: Sequence[int] | None, recipe: CorrectionRecipe) -> CommandStep:
    """Return how H is made of a session with its own dark frames, and with the white image beside it."""
    if planes is not None:
        raise InputError.expected("planes", "all", "one of a session that is being recorded", "a command takes all")
    return CommandStep.of(task_of(Path(folder), Path(out), recipe))
