"""``lfcal assemble`` of frames of a target: every point that shows a position of the scan is a frame of it."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lfcal.frames import CorrectionRecipe
    from lfcal.psf import AssemblyReport, AssemblySettings
    from lfcal.targets import TargetPlan

__all__ = ["assemble_target", "assembled_points", "finish_target", "left_words"]


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
    start = time.perf_counter()
    made, facts = assembled_points(frames, plan, recipe, settings, out, skip_damaged=skip_damaged, quiet=json)
    with made.matrix:
        return show(made, out, time.perf_counter() - start, json) | {"target": facts}


def assembled_points(
    frames: Path,
    plan: TargetPlan,
    recipe: CorrectionRecipe,
    settings: AssemblySettings,
    out: Path,
    *,
    skip_damaged: bool = False,
    quiet: bool,
) -> tuple[AssemblyReport, dict[str, Any]]:
    """Return what was made of the points that show positions, and what the frames say of the target."""
    from lfcal.campaign import iter_assemble_points
    from lfcal.cli._console import report, run_work
    from lfcal.cli._target_frames import opened_target, tell_points

    with opened_target(frames, plan, recipe, skip_damaged=skip_damaged) as view:
        made = run_work(iter_assemble_points(view, plan, out, settings), quiet=quiet)
    if not quiet:
        tell_points(made.points)
        if made.unused:
            report(left_words(made.unused, len(made.points), plan))
    return made.report, made.facts


def finish_target(out: Path, assemble: Path | None, pack: bool, quiet: bool) -> dict[str, Any]:
    """Assemble H of the points that show positions, and pack the recording, as asked for; return what came of it."""
    from lfcal.cli._acquire_outcome import finish
    from lfcal.cli._target_frames import wanted_target
    from lfcal.frames import CorrectionRecipe
    from lfcal.psf import AssemblySettings

    result: dict[str, Any] = {}
    if assemble is not None:
        plan = wanted_target(out, None)
        assert plan is not None  # the session was recorded by it
        # holes that are missing, or beside their places, leave positions that nothing showed
        settings = AssemblySettings(strict=False)
        made, facts = assembled_points(out, plan, CorrectionRecipe(), settings, assemble, quiet=quiet)
        with made.matrix as matrix:
            result = {"H": assemble, "shape": matrix.shape, "saturated_positions": made.saturated, "target": facts}
    return result | finish(out, None, pack, quiet)


def left_words(left: int, count: int, plan: TargetPlan) -> str:
    """Return how many of the points show no position, and why they are not resampled to one."""
    from lfcal.targets import resampling_words

    far = f"{left} of {count} points are farther than {plan.tolerance_px:g} px from every position"
    return f"note: {far}; {resampling_words(plan.scan)}: lfcal fit takes them where they are"
