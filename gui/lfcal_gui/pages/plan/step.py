"""The scan plan, or the plan of a target that shows its positions, as a command. No Qt."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from lfcal.camera import ScanPlan
from lfcal.tasks import PlanScan, PlanTarget, python_of, words_of
from lfcal_gui.models import CAMERA_FILE, PLAN_FILE, CommandStep, ProjectState, needed_plan
from lfcal_gui.pages.plan.model_target import TargetSettings

__all__ = ["scan_step", "step", "target_step"]


def step(project: ProjectState, out: str = "") -> CommandStep:
    """Return how what the page shows is made: the plan of a target where one is asked for, else that of the scan.

    ``out`` is a file of the scan's plan, which that of a target must not replace.
    """
    return target_step(project) if TargetSettings.of(project).many else scan_step(project, out)


def scan_step(project: ProjectState, out: str = "") -> CommandStep:
    """Return how the plan is made; of a recorded scan with another period, Python takes the plan as it is."""
    plan, out = needed_plan(project), out or "plan.json"
    stage = f"{plan.stage.right},{plan.stage.down},{plan.stage.away}"
    known: dict[str, Any] = {"cutout": plan.cutout, "anchor": plan.anchor, "resample": plan.resample}
    task = PlanScan(
        camera=CAMERA_FILE,
        depths=plan.depths_um,
        order=plan.order,
        stage=stage,
        exposure=plan.exposure_s,
        settle=plan.settle_s,
        average=plan.frames_averaged,
        out=Path(out),
        **known,
    )
    files = ((CAMERA_FILE, project.camera.to_json()), (PLAN_FILE, plan.to_json()))
    whole = ScanPlan.for_camera(plan.camera, depths_um=plan.depths_um, **known).period == plan.period
    return CommandStep(words_of(task), python_of(task) if whole else _as_it_is(out), files)


def _as_it_is(out: str) -> str:
    return f"""
from lfcal.camera import Forecast, ScanPlan

plan = ScanPlan.from_json(Path({PLAN_FILE!r}).read_text(encoding="utf-8"))
Path({out!r}).write_text(plan.to_json(), encoding="utf-8")
print(Forecast.of(plan))
"""


def target_step(project: ProjectState, out: str = "") -> CommandStep:
    """Return how the plan of the target is made."""
    asked, plan = TargetSettings.of(project), needed_plan(project)
    task = PlanTarget(
        plan=Path(PLAN_FILE),
        source=asked.source,
        tolerance=asked.tolerance_px,
        crosstalk=asked.crosstalk,
        most_frames=asked.most_frames,
        pose=asked.pose,
        regions=asked.regions,
        out=Path(out or "target_plan.json"),
    )
    return CommandStep(words_of(task), python_of(task), ((PLAN_FILE, plan.to_json()),))
