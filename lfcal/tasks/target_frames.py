"""Open the frames of a target: a session, or a folder with the target's plan."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from lfcal.base import StorageError

if TYPE_CHECKING:
    from lfcal.frames import CorrectionRecipe, FrameSource
    from lfcal.targets import TargetPlan

__all__ = ["left_words", "opened_target", "wanted_target"]


def wanted_target(source: Path, plan: Path | None) -> TargetPlan | None:
    """Return the plan of the target that the frames ``source`` show: that of the file ``plan``, or the stored one.

    None: there is no such plan, because the frames are those of a scan, or ``source`` is an H or does not exist.

    Raises
    ------
    StorageError
        If ``plan`` is the plan of a target, and ``source`` does not exist.
    """
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
    """Return a context with the corrected frames of a target; coded frames are decoded to frames of single offsets.

    ``recipe`` contains the corrections. With ``skip_damaged``, frames that cannot be read are left out.
    """
    from lfcal.acquire import NAME
    from lfcal.frames import corrected_view, open_frames
    from lfcal.targets import decoded, open_target_frames

    if (source / NAME).is_file():
        frames = open_frames(source, skip_damaged=skip_damaged)
    else:
        frames = open_target_frames(source, plan, skip_damaged=skip_damaged)
    with frames:
        yield decoded(corrected_view(frames, recipe, plan.scan), plan)


def left_words(left: int, count: int, plan: TargetPlan) -> str:
    """Return a message: ``left`` of ``count`` points match no position of ``plan``, and why they are not resampled."""
    from lfcal.targets import resampling_words

    far = f"{left} of {count} points are farther than {plan.tolerance_px:g} px from every position"
    return f"{far}; {resampling_words(plan.scan)}; lfcal fit uses these points at their actual positions"
