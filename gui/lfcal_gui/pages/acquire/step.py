"""A recording as a command. No Qt."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lfcal.acquire import RedoList
from lfcal.base import InputError
from lfcal.frames import CorrectionRecipe
from lfcal.tasks import Acquire, AcquireTarget, AcquireUntil, Task, python_of, words_of
from lfcal_gui.models import PLAN_FILE, CommandStep, ProjectState, needed_plan, options_of
from lfcal_gui.pages.acquire.model import AcquireSettings

__all__ = ["assembled", "step"]

REDO_FILE = "lfcal-redo.json"


def step(
    project: ProjectState, out: str = "", *, resume: bool = False, redo: Sequence[tuple[int, int, int]] = ()
) -> CommandStep:
    """Return how the session is recorded, gone on with, or of which positions once more."""
    plan, chosen = needed_plan(project), AcquireSettings.of(project)
    plan_file, single = chosen.target or PLAN_FILE, not chosen.target
    options, goal = chosen.options(), chosen.goal() if single else None
    known: dict[str, Any] = {
        "plan": Path(plan_file),
        "out": Path(out or project.recording or "session"),
        "backend": chosen.backend,
        "stage": chosen.stage,
        "option": tuple(f"{name}={value}" for name, value in chosen.devices().items()),
        "resume": resume,
        "bracket": options.bracket,
        "darks": options.darks,
        "dark_every": options.dark_every if options.darks else None,
        "reference_every": options.reference_every,
        "retries": options.retries,
        "on_suspect": options.on_suspect,
        "allow_automatic": options.allow_automatic,
        "check_stage": None if options.check_stage else False,
        "suspend": options.suspend,
        "steady": options.steady_s if options.suspend else None,
        "tolerance": options.tolerance_um,
        "overshoot": options.overshoot_um,
    }
    scan: dict[str, Any] = {"order": options.order, "margin": options.margin_px, "controls": options.controls}
    again = Path(REDO_FILE) if redo else None
    task: Task
    if not single:
        task = AcquireTarget(**known, redo=again)
    elif goal is not None:
        task = AcquireUntil(**known, **scan, until_error=chosen.error, most=chosen.most or 0)
    else:
        task = Acquire(**known, **scan, redo=again)
    own = ((PLAN_FILE, plan.to_json()),) if single else ()
    files = (*own, *(((REDO_FILE, RedoList.of(redo).to_json()),) if redo else ()))
    return CommandStep(words_of(task), python_of(task), files)


def assembled(folder: str, out: str, planes: Sequence[int] | None, recipe: CorrectionRecipe) -> CommandStep:
    """Return how H is made of a session with its own dark frames, and with the white image beside it."""
    if planes is not None:
        raise InputError.expected("planes", "all", "one of a session that is being recorded", "a command takes all")
    pairs = (("--white", str(recipe.white)), ("--dark", str(recipe.dark)), ("--out", out))
    python = f"""
from lfcal.acquire import iter_assemble_session
from lfcal.frames import CorrectionRecipe
from lfcal.base.progress import drain

recipe = CorrectionRecipe(white={str(recipe.white)!r}, dark={str(recipe.dark)!r})
print(drain(iter_assemble_session(Path({folder!r}), {out!r}, recipe=recipe)).matrix)
"""
    return CommandStep(("assemble", folder, *options_of(pairs)), python)
