"""A recording as a command. No Qt."""

from __future__ import annotations

from collections.abc import Sequence

from gui.models.project import ProjectState
from gui.models.step import PLAN_FILE, Step, needed_plan, options_of
from gui.pages.acquire.model import AcquireSettings
from lfcal.acquire import RedoList
from lfcal.errors import InputError
from lfcal.frames.corrections.recipe import CorrectionRecipe

__all__ = ["assembled", "step"]

REDO_FILE = "lfcal-redo.json"


def step(
    project: ProjectState, out: str = "", *, resume: bool = False, redo: Sequence[tuple[int, int, int]] = ()
) -> Step:
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
    return Step(("acquire", plan_file, *options_of(pairs)), python, files)


def assembled(folder: str, out: str, planes: Sequence[int] | None, recipe: CorrectionRecipe) -> Step:
    """Return how H is made of a session with its own dark frames, and with the white image beside it."""
    if planes is not None:
        raise InputError.expected("planes", "all", "one of a session that is being recorded", "a command takes all")
    pairs = (("--white", str(recipe.white)), ("--dark", str(recipe.dark)), ("--out", out))
    python = f"""
from lfcal.acquire.finish import iter_assemble_session
from lfcal.frames import CorrectionRecipe
from lfcal.progress import drain

recipe = CorrectionRecipe(white={str(recipe.white)!r}, dark={str(recipe.dark)!r})
print(drain(iter_assemble_session(Path({folder!r}), {out!r}, recipe=recipe)).matrix)
"""
    return Step(("assemble", folder, *options_of(pairs)), python)


def _script(
    chosen: AcquireSettings,
    devices: dict[str, str],
    folder: str,
    *,
    resume: bool,
    redo: Sequence[tuple[int, int, int]],
) -> str:
    more = (", resume=True" if resume else "") + (f", redo={[tuple(p) for p in redo]!r}" if redo else "")
    python = f"""
from lfcal.acquire import Options
from lfcal.acquire.session import iter_record
from lfcal.camera import ScanPlan
from lfcal.devices.registry import open_rig
from lfcal.progress import drain

plan = ScanPlan.from_json(Path({PLAN_FILE!r}).read_text(encoding="utf-8"))
options = Options.from_dict({chosen.options().to_dict()!r})
with open_rig(plan, {chosen.backend!r}, {devices!r}, stage={chosen.stage!r}) as rig:
    print(drain(iter_record(Path({folder!r}), plan, rig, options{more})))
"""
    if chosen.target:
        python = python.replace("from lfcal.camera import ScanPlan\n", "").replace(
            "from lfcal.progress import drain\n",
            "from lfcal.progress import drain\nfrom lfcal.targets import TargetPlan\n",
        )
        python = python.replace(
            f"ScanPlan.from_json(Path({PLAN_FILE!r})", f"TargetPlan.from_json(Path({chosen.target!r})"
        )
        return python.replace("open_rig(plan,", "open_rig(plan.scan,")
    if chosen.goal() is not None:
        python = python.replace("from lfcal.acquire.session import iter_record", "from lfcal.campaign import Goal")
        python = python.replace("import Goal", "import Goal, iter_adaptive").replace("iter_record(", "iter_adaptive(")
        python = python.replace("rig, options", f"rig, Goal({chosen.error!r}, most={chosen.most!r}), options")
    return python
