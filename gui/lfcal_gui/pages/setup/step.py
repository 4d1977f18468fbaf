"""The camera, the scan plan, or the plan of a target that shows its positions, as a command. No Qt."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from lfcal_gui.models import CAMERA_FILE, PLAN_FILE, CommandStep, ProjectState, list_beside, needed_plan
from lfcal_gui.pages.setup.model_scan import format_of, half_of, is_usual, scan_task
from lfcal_gui.pages.setup.model_target import PlanSettings, target_task


def step(project: ProjectState, out: str = "") -> CommandStep:
    """Return the step that makes the plan of the target, if there is one, or else that of the scan.

    Without a plan, the step shows the camera. ``out`` is a file for the plan of the scan.
    """
    if project.plan is None:
        return camera_step(project)
    return target_step(project) if PlanSettings.of(project).many else scan_step(project, out)


def camera_step(project: ProjectState, out: str = "") -> CommandStep:
    """Return the step that shows the camera, which is written to the file ``out`` (empty: `CAMERA_FILE`)."""
    name = out or CAMERA_FILE
    python = f"""
from lfcal.camera import Camera

camera = Camera.from_json(Path({name!r}).read_text(encoding="utf-8"))
print(camera.name, camera.pitch_px, camera.marks.paths("assumed"))
"""
    return CommandStep(("camera", "show", name), python, ((name, project.camera.to_json()),))


def scan_step(project: ProjectState, out: str = "") -> CommandStep:
    """Return the step that makes the plan. If no command can make it, the Python code contains the plan itself."""
    plan, out = needed_plan(project), out or "plan.json"
    settings = PlanSettings.of(project)
    half: dict[str, Any] = {}
    if settings.half_cell:
        half_of(plan)  # refused before anything is copied
        half = {"half_cell": True} | ({"list_file": list_beside(out)} if format_of(out) == "plan" else {})
    task = scan_task(plan, out, speed=settings.speed, frame_rate=settings.frame_rate, **half)
    files = ((CAMERA_FILE, project.camera.to_json()), (PLAN_FILE, plan.to_json()))
    found = CommandStep.of(task, files)
    if is_usual(plan) and not any(plan.stage.origin_um):
        return found
    return replace(found, python=_as_it_is(out, half=settings.half_cell))


WRITERS = {"csv": "stage_table", "useq": "useq_sequence"}
"""Functions of `lfcal.camera` that write a plan for another program, by format."""


def _as_it_is(out: str, *, half: bool) -> str:
    writer = WRITERS.get(format_of(out), "")
    names = ["Forecast", "ScanPlan", *(["half_cell"] if half else []), *([writer] if writer else [])]
    text = f"{writer}(plan{', positions' * half})" if writer else "plan.to_json()"
    listed = f"""
from lfcal.acquire import RedoList

RedoList.of(positions.tolist()).write(Path({str(list_beside(out))!r}))
"""
    chosen = "positions = half_cell(plan).half(plan)\n"
    return f"""
from lfcal.camera import {", ".join(names)}

plan = ScanPlan.from_json(Path({PLAN_FILE!r}).read_text(encoding="utf-8"))
{chosen if half else ""}Path({out!r}).write_text({text}, encoding="utf-8")
{listed if half and not writer else ""}print(Forecast.of(plan{", positions=positions" * half}))
"""


def target_step(project: ProjectState, out: str = "") -> CommandStep:
    """Return the step that makes the plan of the target."""
    task = target_task(PlanSettings.of(project), out or "target_plan.json")
    return CommandStep.of(task, ((PLAN_FILE, needed_plan(project).to_json()),))
