"""A recording in the window: its run, its monitoring, and its images and texts. No Qt."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire import (
    Control,
    CoverageState,
    Devices,
    EarlierFrames,
    EarlierRuns,
    Kind,
    LiveCoverage,
    LiveQuality,
    Options,
    Outcome,
    PlaneSum,
    Preview,
    QualityState,
    RedoList,
    ScheduledFrame,
    coarse_order,
    window_shape,
)
from lfcal.base import InputError, Progress, Work, format_seconds, format_share
from lfcal.camera import ScanPlan
from lfcal.frames import Position, stated_noise
from lfcal.tasks import Acquire, AcquireTarget, AcquireUntil
from lfcal_gui.jobs import JobState, WindowJob
from lfcal_gui.models import ScanRates, rough_seconds
from lfcal_gui.pages.acquire.model_folder import FolderState
from lfcal_gui.pages.acquire.model_station import Station

if TYPE_CHECKING:
    from lfcal.campaign import AdaptiveStep, Goal
    from lfcal.fit import Fit
    from lfcal.targets import TargetPlan

QUANTITIES = (("energy", "Light by position"), ("residual", "Position residual"), ("saturated", "Saturated pixels"))
"""Quantities of the map and the curves."""


ASK_S = 0.1
"""Interval at which a recording that waits for the user checks for a stop request (s)."""


class CoveredByHand:
    """Light switched by asking the user to cover and uncover the lens.

    Parameters
    ----------
    control
        Requests to the recording; a stop ends the wait.

    Attributes
    ----------
    asked
        Current request to the user; empty if none.
    skippable
        Whether the dark frames may be skipped instead.
    """

    waits = False  # no driver: a person may take any time

    def __init__(self, control: Control) -> None:
        self._control, self._answered = control, threading.Event()
        self.asked, self.skippable, self._skipped = "", False, False

    def answer(self, *, skip: bool = False) -> None:
        """Answer the request: continue, or skip the dark frames."""
        self._skipped = skip
        self._answered.set()

    def iter_wanted(self) -> Work[bool]:
        """Ask whether to record dark frames. The lens stays uncovered, because the stage is checked first."""
        self._ask("Dark frames need a covered lens. You will be asked to cover it.", skippable=True)
        try:
            while not self._answered.wait(ASK_S) and not self._control.stopping:
                yield Progress(0, 1, "record", 0.0, "waiting for an answer")
        finally:
            self.asked = ""
        return not self._skipped

    def switch(self, on: bool) -> None:
        """Ask the user to uncover (``on``) or cover the lens, and wait for the answer.

        Raise `Aborted` if the recording is stopped before the lens is covered.
        """
        self._ask(f"{'Uncover' if on else 'Cover'} the lens, then continue.", skippable=False)
        try:
            while not self._answered.wait(ASK_S):
                if self._control.stopping:
                    if on:  # nothing more is recorded
                        return
                    raise self._control.aborted()
        finally:
            self.asked = ""

    def _ask(self, words: str, *, skippable: bool) -> None:
        self._answered.clear()
        self.asked, self.skippable = words, skippable


class Recorder:
    """One run of a session, with its control, its frames and its quality data.

    Parameters
    ----------
    task
        Task that records into a folder.
    plan, options
        Plan of the scan or target, and options; the attribute `plan` is always the scan.
    resume
        Whether the session in the folder is resumed.
    redo
        Positions (z, y, x) to record again; empty: record all.
    known
        Positions recorded by earlier runs, as from `FolderState.known`; ``earlier`` reads their frames.
    """

    def __init__(
        self,
        task: Acquire | AcquireTarget | AcquireUntil,
        plan: ScanPlan | TargetPlan,
        options: Options,
        *,
        resume: bool = False,
        redo: Sequence[tuple[int, int, int]] = (),
        known: EarlierRuns | None = None,
    ) -> None:
        self.task, self.folder, self.recorded, self.options, self.resume = task, task.out, plan, options, resume
        self.plan = plan.scan
        self.redo = tuple(Position(*p) for p in redo)
        self.goal = task.goal if isinstance(task, AcquireUntil) else None
        """Target error of H that ends the recording of chosen positions. None: all positions are recorded."""
        self.ended = ""
        self.steps: list[AdaptiveStep] = []
        self.fit: Fit | None = None
        self.control, self.preview = Control(), Preview()
        self.cover = CoveredByHand(self.control)
        self.quality = _watching(plan, options)
        self.earlier = EarlierFrames(self.folder, self.quality, known)
        self.taken = 0
        """Number of positions, or of frames of a target, recorded by this run so far."""
        positions = coarse_order(self.plan) if options.order == "coarse" else self.plan.order_indices()
        self.order = np.ravel_multi_index(tuple(positions.T), self.plan.shape[:3])
        self.started = time.monotonic()

    def work(self, station: Station) -> Work[Outcome]:
        """Return the recording as work with exclusive use of the devices of ``station``."""
        return station.use(self._iter_session(station))

    def _iter_session(self, station: Station) -> Work[Outcome]:
        """Record; keep the last fit here and not as the job's result, because finished jobs stay in memory."""
        if not isinstance(self.task, AcquireUntil) and self.task.redo is not None:
            RedoList.of(self.redo).write(self.task.redo)
        how: dict[str, Any] = {"seen": self.steps.append} if self.goal else {}
        how |= {"resume": self.resume, "control": self.control, "preview": self.preview}
        seeing, rig = (self.quality, self._count), station.rig
        if self.resume or self.redo:
            self.quality.remember(self.folder)
        # a light that can be switched makes it unnecessary to cover the lens
        if self.task.cover and rig.light is None:
            rig = replace(rig, light=self.cover)
            if self.options.darks and not (self.resume or self.redo) and not (yield from self.cover.iter_wanted()):
                self.task = replace(self.task, darks=0, dark_every=None, cover=False)
                self.options = self.task.options()
        found = yield from self.task.iter_session(self.recorded, rig, self.options, observers=seeing, **how)
        outcome: Outcome = found if self.goal is None else found.outcome
        if self.goal is not None:
            self.ended, self.fit = found.words, found.fit
        return outcome

    @property
    def counted(self) -> str:
        """Noun for the recorded units: positions or frames."""
        return "positions" if isinstance(self.recorded, ScanPlan) else "frames"

    @property
    def rate(self) -> float:
        """Positions per second of this run so far."""
        seconds = time.monotonic() - self.started
        return self.taken / seconds if seconds > 0 else 0.0

    def _count(self, step: ScheduledFrame, *_: Any) -> None:
        self.taken += step.kind is Kind.POSITION


def target_facts(plan: ScanPlan | TargetPlan, rates: ScanRates) -> dict[str, Any]:
    """Return what the next step depends on if a target is recorded: number, time (s) and bytes of its frames."""
    if isinstance(plan, ScanPlan):
        return {}
    frames, size = len(plan.frames), plan.single().frame_bytes / plan.scan.n_positions
    return {
        "counted": "frame",
        "positions": frames,
        "record_s": 3600 * plan.forecast(**rates.forecast_keywords()).hours,
        "frame_bytes": frames * size,
    }


def _watching(plan: ScanPlan | TargetPlan, options: Options) -> LiveQuality | LiveCoverage:
    return LiveQuality(plan, window_shape(plan, options)) if isinstance(plan, ScanPlan) else LiveCoverage(plan)


@dataclass(frozen=True, eq=False)
class RecordPicture:
    """State of a recording at one time, ready to be drawn.

    Attributes
    ----------
    values, recorded
        For the shown plane ``(ny, nx)``: the quantity (NaN if unknown), and which positions are recorded.
    depth_sum
        Sum of the plane's cutouts so far ``(rows, columns)``, above the background (counts).
    curves
        For each of `QUANTITIES`: index and value of the known positions, in the order of recording.
    alarms
        Quantities outside their limits, in words.
    lamp
        Drift of the lamp in words; empty if unknown.
    complete
        Whether the plane is complete.
    done, total
        Number of recorded positions (or frames of a target), and number of all.
    covered
        Whether the map shows how many frames of a target cover each position, instead of a recorded quantity.
    reading
        Progress of reading the frames of earlier runs, in words; empty when complete.
    planes
        Fraction of the positions of each plane that is recorded.
    """

    values: NDArray[np.float64]
    recorded: NDArray[np.bool_]
    depth_sum: NDArray[np.float64]
    curves: dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]
    alarms: tuple[str, ...]
    lamp: str
    complete: bool
    done: int
    total: int
    covered: bool = False
    reading: str = ""
    planes: tuple[float, ...] = ()

    def spread(self, quantity: str) -> str:
        """Return the range of a quantity of `QUANTITIES` in this plane as text; empty if no value is known."""
        known = self.values[np.isfinite(self.values)]
        if self.covered or not known.size:
            return ""
        if quantity == "energy":
            mean = float(known.mean())
            return f"within {50 * float(np.ptp(known)) / mean:.2g} %" if mean > 0 else ""
        return f"up to {float(known.max()):.2g} px"


def record_picture(
    quality: QualityState,
    order: NDArray[np.intp],
    z: int,
    quantity: str,
    earlier: NDArray[np.bool_] | None,
    read: PlaneSum | None = None,
) -> RecordPicture:
    """Return the drawing of a recording; a pure function.

    Parameters
    ----------
    quality
        Quality data of this run and of earlier runs as far as they are read, with the depth sum of plane ``z`` only.
    order
        Flat indices of the positions in the order of recording.
    z, quantity
        Plane and key of `QUANTITIES` for the map.
    earlier
        Positions recorded by earlier runs ``(nz, ny, nx)`` (bool).
    read
        Sum of the frames of earlier runs in this plane.
    """
    seen = np.isfinite(quality.energy)
    arrays = {
        "energy": quality.energy,
        "residual": quality.residual_px.astype(float),
        "saturated": np.where(seen, quality.saturated, np.nan),
    }
    curves: dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]] = {}
    for key, values in arrays.items():
        line = values.ravel()[order]
        at = np.flatnonzero(np.isfinite(line))
        curves[key] = (np.asarray(at + 1.0, np.float64), line[at])
    there = seen if earlier is None or earlier.shape != seen.shape else seen | earlier
    alarms = tuple(one.line for one in quality.alarms)
    return RecordPicture(
        arrays[quantity][z],
        there[z],
        quality.depth_sums[0] + (0.0 if read is None else read.light),
        curves,
        alarms,
        lamp_words(quality.lamp),
        bool(there[z].all()),
        int(there.sum()),
        there.size,
        reading="" if read is None else read.words,
        planes=tuple(there.reshape(len(there), -1).mean(axis=1).tolist()),
    )


def lamp_words(lamp: NDArray[np.float64]) -> str:
    """Return the drift of the lamp in words, from its reference frames ``(n, 2)``; empty without two of them."""
    if len(lamp) < 2 or lamp[0, 1] <= 0:
        return ""
    change = 100 * (lamp[:, 1] / lamp[0, 1] - 1)
    return f"lamp {change[-1]:+.2f} % after {format_seconds(float(lamp[-1, 0] - lamp[0, 0]))}, {len(lamp)} references"


def coverage_picture(state: CoverageState, z: int) -> RecordPicture:
    """Return the drawing of the recording of a target: number of frames per position, light of each frame."""
    shown = state.shown[z]
    seen = np.flatnonzero(np.isfinite(state.light))
    number = np.asarray(seen + 1.0, np.float64)
    none = np.zeros(0)
    curves = {
        "energy": (number, state.light[seen]),
        "residual": (none, none),
        "saturated": (number, state.saturated[seen].astype(np.float64)),
    }
    alarms = tuple(one.line for one in state.alarms)
    return RecordPicture(
        shown.astype(np.float64),
        shown > 0,
        np.zeros((1, 1)),
        curves,
        alarms,
        lamp_words(state.lamp),
        False,
        state.done,
        state.total,
        covered=True,
        planes=tuple((state.shown > 0).reshape(len(state.shown), -1).mean(axis=1).tolist()),
    )


def picture_of(made: Recorder, z: int, quantity: str, earlier: NDArray[np.bool_] | None) -> RecordPicture:
    """Return the drawing of a recording of single points or of a target; arguments as in `record_picture`."""
    if isinstance(made.quality, LiveCoverage):
        return coverage_picture(made.quality.state(), z)
    return record_picture(made.quality.state(z), made.order, z, quantity, earlier, made.earlier.sum_of(z))


PART, CHOICE = "record", ("error of H", "information of patterns", "choose positions")
"""Progress stages that count positions, and that choose positions; all others are those of a fit."""


@dataclass(frozen=True)
class ErrorCurve:
    """Error of H (%) as a function of the number of recorded positions, ready to be drawn.

    Attributes
    ----------
    positions, stated
        For each fit: the number of recorded positions, and the error from the standard deviations of its unknowns.
    aside, below, above
        For each fit: the error at held-out positions, and the lengths of its error bar downwards and upwards (two
        standard deviations). Where only an upper limit is known, ``aside`` is that limit and ``below`` is NaN.
    wanted
        The error that ends the recording.
    most
        Largest number of positions to record. None: all of the plan.
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
        now = f"{self.positions[-1]} positions: estimated error {format_share(self.stated[-1] / 100)}"
        return f"{now}, {apart} at held-out positions"


def check_goal(plan: ScanPlan, options: Options, folder: FolderState) -> None:
    """Raise `InputError` if the noise of a frame is unknown, or if the folder contains a scan of every position."""
    if folder.there is not None and folder.chosen is None:
        got, remedy = "a scan of every position", "record every position, or choose another folder"
        raise InputError.expected("session folder", "a session of chosen positions", got, remedy)
    if not options.plain:
        got, remedy = "several exposures per frame", "enter 1 for Exposures"
        raise InputError.expected("exposures", "one exposure per frame, whose noise is known", got, remedy)
    if stated_noise(plan.camera) is None:
        remedy = "measure read noise and full well in Set up, or state them"
        raise InputError.expected("noise of the camera", "a measured or stated noise", "an assumed noise", remedy)


def error_curve(steps: Sequence[AdaptiveStep], goal: Goal) -> ErrorCurve:
    """Return the error curve of the completed fits."""
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
    """Return result so far and current activity as text; ``safe``: number of positions recorded by this run."""
    done = f"{steps[-1].positions} positions" if steps else f"{safe} positions"
    if record.stage == PART:
        now = f"recording {record.done} of {record.total} more" if steps else f"recording the first {record.total}"
    elif record.stage in CHOICE:
        now = "choosing the next positions" if steps else "choosing the first positions"
    else:
        now = f"fitting: {record.stage}"
    known = (
        f"H from {done}, estimated error {format_share(steps[-1].expected_error)}" if steps else f"{done}, no fit yet"
    )
    return known, now + (f", {record.note}" if record.note and record.stage == PART else "")


def progress_words(recorder: Recorder, record: Progress, lamp: str) -> tuple[str, str, float | None]:
    """Return the progress in words, details with ``lamp``, and the completed fraction; None if it is unknown."""
    if recorder.goal is not None:
        words, detail = until_words(record, recorder.steps, recorder.taken)
        return words, _joined(detail, lamp), record.fraction if record.total else None
    rate = recorder.rate
    left = (record.total - record.done) / rate if rate > 0 else None
    pace = f"{rate:.0f} per second, {rough_seconds(left)} left" if left else ""
    words = f"{record.done} of {record.total} {recorder.counted}"
    return words, _joined(record.note or pace, lamp), record.fraction


def asked_words(control: Control, *, stopping: bool) -> str:
    """Return the pending request of a recording (abort, stop, pause); ``stopping``: its job must stop."""
    if control.aborting:
        return "Aborting; no more frames are recorded …"
    if control.stopping or stopping:
        return "Stopping when the current position is saved …"
    if control.pausing and control.held != "paused":
        return "Pausing when the current position is saved …"
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
        f"The camera changes frames automatically: {devices.automatic_words}. Switch this off in "
        "the manufacturer's program and connect again, or tick Allow automatic settings."
    )


def _joined(*parts: str) -> str:
    return ", ".join(part for part in parts if part)


def advice_words(folder: FolderState, *, recording: bool, backend: str, measured: bool) -> str:
    """Return advice on the next step, in words.

    Parameters
    ----------
    folder
        State of the session's folder.
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
        return "Complete. Assemble H uses points whose phases match positions of the plan; lfcal fit uses all points."
    if folder.complete and folder.chosen is not None:
        return "Fit opens the fit of the recorded positions; enter a smaller error to continue the session."
    if folder.complete:
        return "Complete. Assemble H, or choose another folder for a new session."
    if backend:
        name = "the simulator" if backend == "sim" else backend
        return f"Start connects {name}, and asks for a folder if none is chosen."
    return (
        ""
        if measured
        else "The stage axes are not measured yet. Measure them under Adjust the rig, which takes a few seconds."
    )
