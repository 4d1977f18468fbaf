"""Frames of a target as several commands take them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from lfcal.base import InputError

if TYPE_CHECKING:
    from lfcal.campaign import Points
    from lfcal.frames import FrameSource
    from lfcal.targets import TargetPlan

__all__ = ["found_points", "refuse_options", "tell_points"]


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
