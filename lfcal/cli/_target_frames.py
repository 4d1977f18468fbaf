"""Frames of a target as several commands are given them: a session, or a folder with the target's plan."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from lfcal.base import InputError, StorageError

if TYPE_CHECKING:
    from lfcal.campaign import Points
    from lfcal.frames import CorrectionRecipe, FrameSource
    from lfcal.targets import TargetPlan

__all__ = ["found_points", "opened_target", "refuse_options", "tell_points", "wanted_target"]


def wanted_target(source: Path, plan: Path | None) -> TargetPlan | None:
    """Return the plan of the target that frames show, theirs or the one named; None where they are of a scan."""
    from lfcal.acquire import NAME
    from lfcal.targets import read_target_plan

    if source.suffix.lower() in (".h5", ".hdf5", ".mat", ".lfc"):
        return None
    if not source.exists():
        if plan is not None and read_target_plan(source, plan) is not None:
            raise StorageError(f"{source}: no such file or folder; check the path")
        return None
    if plan is None and (source / NAME).is_file():
        from lfcal.frames import open_frames
        from lfcal.targets import TargetPlan

        with open_frames(source) as frames:
            target = frames.metadata.target
            return target if isinstance(target, TargetPlan) else None
    return read_target_plan(source, plan)


@contextmanager
def opened_target(
    source: Path, plan: TargetPlan, recipe: CorrectionRecipe, *, skip_damaged: bool = False
) -> Iterator[FrameSource]:
    """Open the frames of a target with their dark level subtracted."""
    from lfcal.acquire import NAME
    from lfcal.frames import corrected_view, open_frames
    from lfcal.targets import decoded, open_target_frames

    if (source / NAME).is_file():
        frames = open_frames(source, skip_damaged=skip_damaged)
    else:
        frames = open_target_frames(source, plan, skip_damaged=skip_damaged)
    with frames:
        yield decoded(corrected_view(frames, recipe, plan.scan), plan)


def found_points(view: FrameSource, plan: TargetPlan, *, quiet: bool) -> Points:
    """Find the points of all frames, and say what is not as described."""
    from lfcal.campaign import iter_points_of
    from lfcal.cli._console import run_work

    points = run_work(iter_points_of(view, plan), quiet=quiet)
    if not quiet:
        tell_points(points)
    return points


def tell_points(points: Points) -> None:
    """Print what was found in the frames, and what is not as described."""
    from lfcal.cli._findings import show_judgement
    from lfcal.judge import judgement_of

    show_judgement(judgement_of(points))


def refuse_options(given: Mapping[str, object]) -> None:
    """Raise where options were given that frames of a target have no use for."""
    wrong = [name for name, said in given.items() if said]
    if wrong:
        raise InputError.expected("frames of a target", "options of a target's frames", wrong[0], "leave it out")
