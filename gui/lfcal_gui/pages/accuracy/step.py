"""A measurement of accuracy against cost as a command. No Qt."""

from __future__ import annotations

from lfcal_gui.models import PLAN_FILE, CommandStep, ProjectState, needed_file, needed_plan, options_of, stated_order
from lfcal_gui.pages.accuracy.model import AccuracySettings


def step(project: ProjectState, out: str = "") -> CommandStep:
    """Return the step that measures the selected part."""
    chosen = AccuracySettings.of(project)
    by_plan = chosen.subject == "plan"
    name = PLAN_FILE if by_plan else needed_file(project.psf, "H", "H")
    order = "" if by_plan else stated_order(project, name)
    stated = f", mat_order={order!r}" if order else ""
    opened = f"Subject.of_matrix(open_psf({name!r}{stated}), {name!r})"
    pairs = (
        *(("--part", chosen.part), ("--seconds", f"{chosen.seconds:g}"), ("--error", f"{100 * chosen.error:g}%")),
        ("--mat-order", order),
    )
    if by_plan:
        opened = "Subject(plan.camera.name, plan)"
    python = f"""
from lfcal.accuracy import PARTS, Subject, measure_curve
from lfcal.camera import ScanPlan
from lfcal.psf import open_psf

{f"plan = ScanPlan.from_json(Path({name!r}).read_text(encoding='utf-8'))" if by_plan else ""}
print(measure_curve(PARTS.get({chosen.part!r}), {opened}, {chosen.seconds!r}))
"""
    files = ((PLAN_FILE, needed_plan(project).to_json()),) if by_plan else ()
    return CommandStep(("accuracy", name, *options_of(pairs)), python, files)
