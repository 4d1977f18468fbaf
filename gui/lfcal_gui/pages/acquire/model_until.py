"""A recording that ends when H is known: its errors as they are drawn, and how far it is in words. No Qt."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from lfcal.acquire import Options
from lfcal.base import InputError, Progress, format_share
from lfcal.camera import ScanPlan
from lfcal.frames import stated_noise
from lfcal_gui.pages.acquire.model_recorder import FolderState

if TYPE_CHECKING:
    from lfcal.campaign import AdaptiveStep, Goal

__all__ = ["ErrorCurve", "check_goal", "error_curve", "until_words"]

PART, CHOICE = "record", ("error of H", "what patterns tell", "choose positions")
"""Stages of progress that count positions, and that choose them; all others are those of a fit."""


@dataclass(frozen=True)
class ErrorCurve:
    """Error of H against positions recorded, as it is drawn (%).

    Attributes
    ----------
    positions, stated
        Of each fit: positions recorded, and the error that the unknowns' standard deviations make.
    aside, below, above
        Of each fit the error at positions kept aside: its value, and how far it may lie below and above by two
        standard deviations. Where only a limit is known it is the value, and ``below`` is NaN.
    wanted
        The error that ends the recording.
    most
        Positions that are recorded at most, None: all of the plan.
    """

    positions: tuple[int, ...]
    stated: tuple[float, ...]
    aside: tuple[float, ...]
    below: tuple[float, ...]
    above: tuple[float, ...]
    wanted: float
    most: int | None

    @property
    def words(self) -> str:
        """What the last fit says, in a line; empty before the first."""
        if not self.positions:
            return ""
        limit = math.isnan(self.below[-1])
        apart = "below " * limit + format_share(self.aside[-1] / 100)
        now = f"{self.positions[-1]} positions: {format_share(self.stated[-1] / 100)} stated"
        return f"{now}, {apart} at positions kept aside"


def check_goal(plan: ScanPlan, options: Options, folder: FolderState) -> None:
    """Raise `InputError` where a fit of such frames could not tell H, or the folder holds a whole scan."""
    if folder.there is not None and folder.chosen is None:
        got, remedy = "a scan of every position", "record every position, or choose another folder"
        raise InputError.expected("session folder", "one of chosen positions", got, remedy)
    if not options.plain:
        got, remedy = "several that make one frame", "enter 1 for Exposures"
        raise InputError.expected("exposures", "single ones, whose noise is known", got, remedy)
    if stated_noise(plan.camera) is None:
        remedy = "measure read noise and full well in Set up, or state them"
        raise InputError.expected("noise of the camera", "measured or stated", "assumed", remedy)


def error_curve(steps: Sequence[AdaptiveStep], goal: Goal) -> ErrorCurve:
    """Return what to draw of the fits that are done."""
    aside, below, above = [], [], []
    for step in steps:
        left = step.held_out_error
        aside.append(100 * (left.value if left.known else left.limit))
        below.append(200 * left.sigma if left.known else math.nan)
        above.append(200 * left.sigma if left.known else 0.0)
    return ErrorCurve(
        tuple(step.positions for step in steps),
        tuple(100 * step.expected_error for step in steps),
        tuple(aside),
        tuple(below),
        tuple(above),
        100 * goal.error,
        goal.most,
    )


def until_words(record: Progress, steps: Sequence[AdaptiveStep], safe: int) -> tuple[str, str]:
    """Return how far such a recording is, and what it is at; ``safe``: positions recorded by this run."""
    done = f"{steps[-1].positions} positions" if steps else f"{safe} positions"
    if record.stage == PART:
        now = f"recording {record.done} of {record.total} more" if steps else f"recording the first {record.total}"
    elif record.stage in CHOICE:
        now = "choosing the next positions" if steps else "choosing the first positions"
    else:
        now = f"fitting: {record.stage}"
    known = f"H known to {format_share(steps[-1].expected_error)} from {done}" if steps else f"{done}, no fit yet"
    return known, now + (f", {record.note}" if record.note and record.stage == PART else "")
