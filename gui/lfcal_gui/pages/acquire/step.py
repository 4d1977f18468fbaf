"""A recording as a command. No Qt."""

from __future__ import annotations

from collections.abc import Sequence

from lfcal.acquire import RedoList
from lfcal.base import InputError
from lfcal.frames import CorrectionRecipe
from lfcal_gui.models import PLAN_FILE, CommandStep, ProjectState, needed_plan, options_of
from lfcal_gui.pages.acquire.model import AcquireSettings

__all__ = ["assembled", "step"]

REDO_FILE = "lfcal-redo.json"

NEEDED = (
    "from lfcal.acquire import Options",
    "from lfcal.devices.registry import open_rig",
    "from lfcal.base.progress import drain",
)
"""Imports of every recording's script."""


def step(
    project: ProjectState, out: str = "", *, resume: bool = False, redo: Sequence[tuple[int, int, int]] = ()
) -> CommandStep:
    """Return how the session is recorded, gone on with, or of which positions once more."""
    plan, chosen = needed_plan(project), AcquireSettings.of(project)
    options, goal = chosen.options(), chosen.goal()
    devices = chosen.devices()
    folder, plan_file = out or project.recording or "session", chosen.target or PLAN_FILE
    single = not chosen.target
    pairs = (
        ("--out", folder),
        ("--resume", resume),
        ("--redo", REDO_FILE if redo else ""),
        ("--backend", chosen.backend),
        ("--stage", chosen.stage),
        *(("--option", f"{name}={value}") for name, value in devices.items()),
        ("--until-error", "" if goal is None else f"{100 * chosen.error:g}%"),
        ("--most", None if goal is None else chosen.most),
        ("--order", options.order if single else None),
        ("--bracket", ",".join(f"{v:g}" for v in options.bracket)),
        ("--margin", options.margin_px if single else None),
        ("--darks", options.darks),
        ("--dark-every", options.dark_every),
        ("--reference-every", options.reference_every),
        ("--controls", options.controls if single else None),
        ("--retries", options.retries),
        ("--on-suspect", options.on_suspect),
        ("--allow-automatic", options.allow_automatic),
        ("--no-check-stage", not options.check_stage),
        *(("--suspend", text) for text in options.suspend),
        ("--steady", options.steady_s if options.suspend else None),
        ("--tolerance", ",".join(f"{v!r}" for v in options.tolerance_um or ())),
        ("--overshoot", ",".join(f"{v!r}" for v in options.overshoot_um)),
    )
    python = _script(chosen, devices, folder, resume=resume, redo=redo)
    own = ((PLAN_FILE, plan.to_json()),) if single else ()
    files = (*own, *(((REDO_FILE, RedoList.of(redo).to_json()),) if redo else ()))
    return CommandStep(("acquire", plan_file, *options_of(pairs)), python, files)


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


def _script(
    chosen: AcquireSettings,
    devices: dict[str, str],
    folder: str,
    *,
    resume: bool,
    redo: Sequence[tuple[int, int, int]],
) -> str:
    more = (", resume=True" if resume else "") + (f", redo={[tuple(p) for p in redo]!r}" if redo else "")
    kind, plan_file, scan = "ScanPlan", PLAN_FILE, "plan"
    if chosen.target:
        kind, plan_file, scan = "TargetPlan", chosen.target, "plan.scan"
    function, goal = "iter_record", ""
    imports = [f"from lfcal.{'targets' if chosen.target else 'camera'} import {kind}"]
    if chosen.goal() is not None and not chosen.target:
        function, goal = "iter_adaptive", f"Goal({chosen.error!r}, most={chosen.most!r}), "
        imports.append("from lfcal.campaign import Goal, iter_adaptive")
    else:
        imports.append("from lfcal.acquire import iter_record")
    needed = "\n".join(sorted([*imports, *NEEDED]))
    return f"""
{needed}

plan = {kind}.from_json(Path({plan_file!r}).read_text(encoding="utf-8"))
options = Options.from_dict({chosen.options().to_dict()!r})
with open_rig({scan}, {chosen.backend!r}, {devices!r}, stage={chosen.stage!r}) as rig:
    print(drain({function}(Path({folder!r}), plan, rig, {goal}options{more})))
"""
