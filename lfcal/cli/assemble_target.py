"""``lfcal assemble`` of frames of a target: every point that shows a position of the scan is a frame of it."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lfcal.frames import CorrectionRecipe
    from lfcal.psf.assemble_plan import AssemblySettings
    from lfcal.psf.assembly_report import AssemblyReport
    from lfcal.targets import TargetPlan

__all__ = ["assemble_target"]


def assemble_target(
    frames: Path,
    plan: TargetPlan,
    recipe: CorrectionRecipe,
    settings: AssemblySettings,
    out: Path,
    *,
    skip_damaged: bool,
    json: bool,
    show: Callable[[AssemblyReport, Path, float, bool], dict[str, Any]],
) -> dict[str, Any]:
    """Find the points of all frames, and assemble those that show positions; ``show`` tells what was made."""
    from lfcal.campaign.point_facts import target_facts
    from lfcal.campaign.point_frames import PointFrames
    from lfcal.cli.console import report, run_work
    from lfcal.cli.target_frames import found_points, opened_target
    from lfcal.psf.assemble_plan import iter_assemble_plan

    start = time.perf_counter()
    with opened_target(frames, plan, recipe, skip_damaged=skip_damaged) as view:
        points = found_points(view, plan, quiet=json)
        single = PointFrames(view, points)
        if not json and single.left:
            report(
                f"note: {single.left} of {len(points)} points are farther than {plan.tolerance_px:g} px from every "
                "position: lfcal fit takes them where they are"
            )
        facts = target_facts(points)
        work = iter_assemble_plan(single, plan.scan, out, settings, provenance={"target": facts})
        made = run_work(work, quiet=json)
    with made.matrix:
        return show(made, out, time.perf_counter() - start, json) | {"target": facts}
