"""H of the points of a target's frames that show positions of the scan."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Any, NamedTuple

from lfcal.base import Work
from lfcal.campaign._point_frames import PointFrames
from lfcal.campaign.point_facts import target_facts
from lfcal.campaign.points import Points, iter_points_of
from lfcal.frames import FrameSource
from lfcal.psf import AssemblyReport, AssemblySettings, iter_assemble_plan
from lfcal.targets import TargetPlan

__all__ = ["AssembledPoints", "iter_assemble_points"]


class AssembledPoints(NamedTuple):
    """H of a target's frames: what was made, the points found, how many showed no position, what frames say."""

    report: AssemblyReport
    points: Points
    left: int
    facts: dict[str, Any]


def iter_assemble_points(
    view: FrameSource, plan: TargetPlan, out: str | os.PathLike[str], settings: AssemblySettings | None = None
) -> Work[AssembledPoints]:
    """Find the points of all frames, and assemble those that show positions; yields progress.

    Parameters
    ----------
    view
        Whole frames with their dark level subtracted.
    plan
        The target, and where it was moved.
    out
        H file.
    settings
        As of `lfcal.psf.iter_assemble_plan`; positions that no point shows are left empty. Where the pixels are fine
        enough for it patterns are moved to whole pixels, band-limited unless it says otherwise.

    Raises
    ------
    InputError
        If frames and plan do not belong together, or no point shows a position.
    """
    points = yield from iter_points_of(view, plan)
    single = PointFrames(view, points)
    facts = target_facts(points) | {"left_out": single.left}
    how = settings or AssemblySettings()
    if single.resampled and not how.interpolation:
        how = replace(how, interpolation="fourier")
    work = iter_assemble_plan(single, plan.scan, out, how, provenance={"target": facts})
    return AssembledPoints((yield from work), points, single.left, facts)
