"""``lfcal acquire`` of a target's plan: what differs from a session of single points."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lfcal.base import InputError, LfcalError, format_share

if TYPE_CHECKING:
    from lfcal.acquire import CoverageState, LiveCoverage
    from lfcal.camera import ScanPlan
    from lfcal.targets import TargetPlan

__all__ = [
    "check_target_options",
    "coverage_facts",
    "recorded_before",
    "show_coverage",
    "simulated_options",
    "target_plan_in",
]

FORMAT = "lfcal-target-plan"


def target_plan_in(data: Any) -> TargetPlan | None:
    """Return the plan of a target that a JSON file holds; None where it holds something else."""
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        return None
    from lfcal.targets import TargetPlan

    return TargetPlan.from_dict(data)


def check_target_options(plan: ScanPlan | TargetPlan, given: dict[str, bool]) -> None:
    """Raise for the first of the options ``given`` that has no meaning with frames of many points."""
    from lfcal.camera import ScanPlan

    named = [name for name, there in given.items() if there]
    if not isinstance(plan, ScanPlan) and named:
        raise InputError(f"{named[0]}: is of single points; leave it out with the plan of a target")


def simulated_options(plan: ScanPlan | TargetPlan, path: Path, backend: str, options: dict[str, str]) -> dict[str, str]:
    """Return the options of the backend, the planned target before the simulator unless another is named."""
    from lfcal.camera import ScanPlan

    if isinstance(plan, ScanPlan):
        return options
    if plan.lit is not None and backend != "sim":
        remedy = "show its pictures (lfcal plan target --patterns), and assemble the folder of frames"
        raise InputError.expected(str(path), "a target that a stage moves", "frames of a display", remedy)
    if backend != "sim" or "target" in options:
        return options
    return {**options, "target": str(path)}


def recorded_before(plan: TargetPlan, folder: Path | None) -> LiveCoverage:
    """Return what watches a session of a target, with the frames that one that goes on in ``folder`` has already."""
    from lfcal.acquire import LiveCoverage, TargetRecording

    watching = LiveCoverage(plan)
    if folder is not None:
        # a session that was stopped before its first frame has none to open
        with suppress(LfcalError), TargetRecording(folder, skip_damaged=True) as source:
            if source.target == plan:
                for z, k in source.frames:
                    watching.know(z, k)
    return watching


def coverage_facts(state: CoverageState) -> dict[str, Any]:
    """Return what a session of a target shows, for scripts."""
    return {
        "frames": state.done,
        "coverage": state.coverage,
        "coverage_of_planes": [float((plane > 0).mean()) for plane in state.shown],
        "mean_repeats": float(state.shown.mean()),
    }


def show_coverage(facts: dict[str, Any]) -> None:
    """Print it."""
    shown = ", ".join(format_share(share) for share in facts["coverage_of_planes"])
    typer.echo(
        f"  phases shown, where the target lies as planned: {shown}; {facts['mean_repeats']:.2f} times on average"
    )
