"""The scan plan, or the target that stands for it, as a command. No Qt."""

from __future__ import annotations

from typing import Any

from lfcal_gui.models import CAMERA_FILE, PLAN_FILE, CommandStep, ProjectState, needed_plan, options_of
from lfcal_gui.pages.plan.model_target import TargetSettings

__all__ = ["scan_step", "step", "target_step"]


def step(project: ProjectState, out: str = "") -> CommandStep:
    """Return how what the page shows is made: the plan of a target where one is asked for, else that of the scan.

    ``out`` is a file of the scan's plan, which that of a target must not replace.
    """
    return target_step(project) if TargetSettings.of(project).many else scan_step(project, out)


def scan_step(project: ProjectState, out: str = "") -> CommandStep:
    """Return how the plan is made; the command knows one exposure for all planes, Python takes the plan as it is."""
    python = f"""
from lfcal.camera import Forecast, ScanPlan

plan = ScanPlan.from_json(Path({PLAN_FILE!r}).read_text(encoding="utf-8"))
Path({out or "plan.json"!r}).write_text(plan.to_json(), encoding="utf-8")
print(Forecast.of(plan))
"""
    return _step(project, (("--out", out or "plan.json"),), python)


def target_step(project: ProjectState, out: str = "") -> CommandStep:
    """Return how the plan of the target is made."""
    asked, out = TargetSettings.of(project), out or "target_plan.json"
    pairs = (
        ("--source", asked.source),
        ("--tolerance", repr(asked.tolerance_px)),
        ("--crosstalk", repr(asked.crosstalk)),
        ("--most-frames", asked.most_frames),
        ("--pose", asked.pose),
        ("--regions", asked.regions),
        ("--out", out),
    )
    hole = asked.proposed_hole()
    made, name = f"parse_target({asked.source!r})", "parse_target"
    if hole is not None:
        made, name = f"propose_target(scan, wishes, hole_um={hole!r})", "propose_target"
    names = [name, "plan_target"]
    if asked.pose:
        names, made = [*names, "Pose"], f"replace({made}, pose=Pose.parse({asked.pose!r}))"
    first = "from dataclasses import replace\n\n" if asked.pose else ""
    python = f"""
{first}from lfcal.camera import ScanPlan
from lfcal.targets import {", ".join(sorted([*names, "Wishes"], key=lambda one: (one.islower(), one)))}

scan = ScanPlan.from_json(Path({PLAN_FILE!r}).read_text(encoding="utf-8"))
wishes = Wishes({asked.tolerance_px!r}, {asked.crosstalk!r}, {asked.most_frames!r})
target_plan = plan_target(scan, {made}, wishes)
Path({out!r}).write_text(target_plan.to_json(), encoding="utf-8")
print(target_plan.forecast())
"""
    return _step(project, pairs, python)


def _step(project: ProjectState, more: tuple[tuple[str, Any], ...], python: str) -> CommandStep:
    plan = needed_plan(project)
    pairs = (
        ("--depths", ",".join(repr(z) for z in plan.depths_um)),
        ("--cutout", f"{plan.cutout[0]},{plan.cutout[1]}"),
        ("--anchor", f"{plan.anchor[0]!r},{plan.anchor[1]!r}"),
        ("--resample", plan.resample),
        ("--order", plan.order),
        ("--stage", f"{plan.stage.right},{plan.stage.down},{plan.stage.away}"),
        ("--exposure", repr(plan.exposures[0])),
        ("--settle", repr(plan.settle_s)),
        ("--average", plan.frames_averaged),
        *more,
    )
    files = ((CAMERA_FILE, project.camera.to_json()), (PLAN_FILE, plan.to_json()))
    return CommandStep(("plan", CAMERA_FILE, *options_of(pairs)), python, files)
