"""The scan plan as a command. No Qt."""

from __future__ import annotations

from gui.models.project import ProjectState
from gui.models.step import CAMERA_FILE, PLAN_FILE, Step, needed_plan, options_of

__all__ = ["step"]


def step(project: ProjectState, out: str = "") -> Step:
    """Return how the plan is made; the command knows one exposure for all planes, Python takes the plan as it is."""
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
        ("--out", out or "plan.json"),
    )
    python = f"""
from lfcal.camera import Forecast, ScanPlan

plan = ScanPlan.from_json(Path({PLAN_FILE!r}).read_text(encoding="utf-8"))
Path({out or "plan.json"!r}).write_text(plan.to_json(), encoding="utf-8")
print(Forecast.of(plan))
"""
    files = ((CAMERA_FILE, project.camera.to_json()), (PLAN_FILE, plan.to_json()))
    return Step(("plan", CAMERA_FILE, *options_of(pairs)), python, files)
