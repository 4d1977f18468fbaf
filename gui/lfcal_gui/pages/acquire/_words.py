"""How far a recording is, and how it ended, in words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from lfcal.acquire import Control, Devices, Options
from lfcal.base import InputError, Progress, format_seconds, format_share
from lfcal.camera import ScanPlan
from lfcal.frames import stated_noise
from lfcal_gui.jobs import JobState, WindowJob
from lfcal_gui.pages.acquire.model_folder import FolderState
from lfcal_gui.pages.acquire.model_recorder import Recorder

if TYPE_CHECKING:
    from lfcal.campaign import AdaptiveStep, Goal

PART, CHOICE = "record", ("error of H", "information of patterns", "choose positions")
"""Stages of progress that count positions, and that choose them; all others are those of a fit."""


@dataclass(frozen=True)
class ErrorCurve:
    """Error of H as a function of the number of recorded positions, as it is drawn (%).

    Attributes
    ----------
    positions, stated
        For each fit: the number of recorded positions, and the error from the standard deviations of its unknowns.
    aside, below, above
        For each fit: the error at held-out positions, and its bounds at two standard deviations. Where only an upper
        limit is known, ``aside`` is that limit and ``below`` is NaN.
    wanted
        The error that ends the recording.
    most
        Largest number of positions to record; None: all of the plan.
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
        """One-line summary of the last fit; empty before the first."""
        if not self.positions:
            return ""
        limit = math.isnan(self.below[-1])
        apart = "below " * limit + format_share(self.aside[-1] / 100)
        now = f"{self.positions[-1]} positions: {format_share(self.stated[-1] / 100)} stated"
        return f"{now}, {apart} at positions kept aside"


def check_goal(plan: ScanPlan, options: Options, folder: FolderState) -> None:
    """Raise `InputError` if the noise of the frames is unknown, or if the folder holds a scan of every position."""
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


def progress_words(recorder: Recorder, record: Progress, lamp: str) -> tuple[str, str, float | None]:
    """Return the progress in words, details with ``lamp``, and the completed fraction; None if it is unknown."""
    if recorder.goal is not None:
        words, detail = until_words(record, recorder.steps, recorder.taken)
        return words, _joined(detail, lamp), record.fraction if record.total else None
    rate = recorder.rate
    left = (record.total - record.done) / rate if rate > 0 else None
    pace = f"{rate:.0f} per second, about {format_seconds(left)} to go" if left else ""
    words = f"{record.done} of {record.total} {recorder.counted}"
    return words, _joined(record.note or pace, lamp), record.fraction


def asked_words(control: Control, *, stopping: bool) -> str:
    """Return the pending request of a recording (abort, stop, pause); ``stopping``: its job must stop."""
    if control.aborting:
        return "Aborting: nothing more is taken …"
    if control.stopping or stopping:
        return "Stopping once the position under way is safe …"
    if control.pausing and control.held != "paused":
        return "Pausing once the position under way is safe …"
    return "Resuming …" if control.held == "paused" and not control.pausing else ""


def end_words(job: WindowJob, ended: str, counted: str = "positions") -> tuple[str, float]:
    """Return how a recording ended and its completed fraction; ``ended``: why no more positions were needed."""
    if job.state is JobState.DONE:
        found = job.result
        words = f"{found.how.capitalize()}: {found.acknowledged} of {found.total} {counted}."
        if ended:
            words = f"{ended[0].upper()}{ended[1:]}."
        return words, found.acknowledged / max(1, found.total)
    words = {JobState.FAILED: "Stopped by a fault.", JobState.CANCELLED: "Interrupted."}.get(job.state, "")
    return words, job.progress.fraction if job.progress is not None else 0.0


def automatic_words(devices: Devices, options: Options) -> str:
    """Return what to do about automatic settings of the camera; empty: there are none, or they are allowed."""
    if not devices.automatic or options.allow_automatic:
        return ""
    return (
        f"The camera changes frames automatically: {devices.automatic_words}. Switch this off in the program of its "
        "maker and connect again, or tick Allow automatic."
    )


def _joined(*parts: str) -> str:
    return ", ".join(part for part in parts if part)


def advice_words(folder: FolderState, *, recording: bool, backend: str, measured: bool) -> str:
    """Return advice on the next step, in words.

    Parameters
    ----------
    folder
        What the session's folder holds.
    recording
        Whether a session is being recorded.
    backend
        Name of the backend to connect; empty: the devices are connected.
    measured
        Whether the axes of the stage are measured.
    """
    if recording:
        return "Recording continues while you use other pages."
    if folder.complete and folder.target is not None:
        return "Complete. Assemble H uses the points that meet phases; lfcal fit uses all points at their positions."
    if folder.complete and folder.chosen is not None:
        return "Fit opens the fit of the recorded positions; enter a smaller error to continue the session."
    if folder.complete:
        return "Complete. Assemble H, or choose another folder for a new session."
    if backend:
        name = "the simulator" if backend == "sim" else backend
        return f"Start connects {name} and asks for a folder if there is none."
    return "" if measured else "The stage axes are not measured yet: Adjust the rig measures them in seconds."
