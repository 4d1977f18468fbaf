"""A recording as a command. No Qt."""

from __future__ import annotations

import math

from gui.models.project import ProjectState
from gui.models.step import PLAN_FILE, Step, needed_plan, options_of
from gui.pages.acquire.model import AcquireSettings
from gui.pages.acquire.model_station import with_defaults

__all__ = ["step"]


def step(project: ProjectState) -> Step:
    """Return how the session is recorded."""
    plan, chosen = needed_plan(project), AcquireSettings.of(project)
    options, goal = chosen.options(), chosen.goal()
    devices = with_defaults(chosen.backend, dict(chosen.device_options), math.prod(plan.camera.sensor.shape))
    folder = project.recording or "session"
    pairs = (
        ("--out", folder),
        ("--backend", chosen.backend),
        ("--stage", chosen.stage),
        *(("--option", f"{name}={value}") for name, value in devices.items()),
        ("--until-error", "" if goal is None else f"{100 * chosen.error:g}%"),
        ("--most", None if goal is None else chosen.most),
        ("--order", options.order),
        ("--bracket", ",".join(f"{v:g}" for v in options.bracket)),
        ("--margin", options.margin_px),
        ("--darks", options.darks),
        ("--dark-every", options.dark_every),
        ("--reference-every", options.reference_every),
        ("--controls", options.controls),
        ("--retries", options.retries),
        ("--on-suspect", options.on_suspect),
        *(("--suspend", text) for text in options.suspend),
        ("--steady", options.steady_s if options.suspend else None),
        ("--tolerance", ",".join(f"{v!r}" for v in options.tolerance_um or ())),
        ("--overshoot", ",".join(f"{v!r}" for v in options.overshoot_um)),
    )
    python = _script(chosen, devices, folder)
    return Step(("acquire", PLAN_FILE, *options_of(pairs)), python, ((PLAN_FILE, plan.to_json()),))


def _script(chosen: AcquireSettings, devices: dict[str, str], folder: str) -> str:
    python = f"""
from lfcal.acquire import Options
from lfcal.acquire.session import iter_record
from lfcal.camera import ScanPlan
from lfcal.devices.registry import open_rig
from lfcal.progress import drain

plan = ScanPlan.from_json(Path({PLAN_FILE!r}).read_text(encoding="utf-8"))
options = Options.from_dict({chosen.options().to_dict()!r})
with open_rig(plan, {chosen.backend!r}, {devices!r}, stage={chosen.stage!r}) as rig:
    print(drain(iter_record(Path({folder!r}), plan, rig, options)))
"""
    if chosen.goal() is not None:
        python = python.replace("from lfcal.acquire.session import iter_record", "from lfcal.campaign import Goal")
        python = python.replace("import Goal", "import Goal, iter_adaptive").replace("iter_record(", "iter_adaptive(")
        python = python.replace("rig, options)", f"rig, Goal({chosen.error!r}, most={chosen.most!r}), options)")
    return python
