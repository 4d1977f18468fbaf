"""A recording as the window follows it: run, watched, and turned into pictures. No Qt."""

from __future__ import annotations

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
from lfcal.base import Progress, Work, format_seconds
from lfcal.camera import ScanPlan
from lfcal.frames import Position
from lfcal.tasks import Acquire, AcquireTarget, AcquireUntil
from lfcal_gui.pages.acquire.model_station import Station

if TYPE_CHECKING:
    from lfcal.campaign import AdaptiveStep
    from lfcal.fit import Fit
    from lfcal.targets import TargetPlan

QUANTITIES = (("energy", "Light by position"), ("residual", "Position residual"), ("saturated", "Saturated pixels"))
"""What the map and the curves show."""


ASK_S = 0.1
"""Interval at which a recording that waits for a person looks for a stop (s)."""


class CoveredByHand:
    """A person who covers the lens, in place of a light that can be switched.

    Parameters
    ----------
    control
        Requests to the recording; a stop ends the wait.

    Attributes
    ----------
    asked
        What the person is asked to do; empty: nothing.
    skippable
        Whether dark frames may be skipped instead.
    """

    waits = False  # no driver: a person may take any time

    def __init__(self, control: Control) -> None:
        self._control, self._answered = control, threading.Event()
        self.asked, self.skippable, self._skipped = "", False, False

    def answer(self, *, skip: bool = False) -> None:
        """Continue, or skip the dark frames."""
        self._skipped = skip
        self._answered.set()

    def iter_wanted(self) -> Work[bool]:
        """Return whether dark frames are wanted. The lens stays uncovered, because the stage is checked first."""
        self._ask("Dark frames need a covered lens. You will be asked to cover it.", skippable=True)
        try:
            while not self._answered.wait(ASK_S) and not self._control.stopping:
                yield Progress(0, 1, "record", 0.0, "waiting for an answer")
        finally:
            self.asked = ""
        return not self._skipped

    def switch(self, on: bool) -> None:
        """Ask a person to uncover (``on``) or cover the lens, and wait; raises `Aborted` where the recording stops."""
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
    """One run of a session: its requests, its frames, its quality.

    Parameters
    ----------
    task
        What records into which folder.
    plan, options
        The plan is that of a scan or of a target, `plan` the scan in any case.
    resume
        Whether the folder holds it already.
    redo
        Positions (z, y, x) to be recorded again; empty records all.
    known
        What earlier runs recorded, as `FolderState.known`; ``earlier`` reads it.
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
        """The error of H that ends it, positions being chosen on the way; None: it ends with the last of the plan."""
        self.ended = ""
        self.steps: list[AdaptiveStep] = []
        self.fit: Fit | None = None
        self.control, self.preview = Control(), Preview()
        self.cover = CoveredByHand(self.control)
        self.quality = _watching(plan, options)
        self.earlier = EarlierFrames(self.folder, self.quality, known)
        self.taken = 0
        """Positions, or frames of a target, of this run so far."""
        positions = coarse_order(self.plan) if options.order == "coarse" else self.plan.order_indices()
        self.order = np.ravel_multi_index(tuple(positions.T), self.plan.shape[:3])
        self.started = time.monotonic()

    def work(self, station: Station) -> Work[Outcome]:
        """Return the recording, alone on the devices of ``station``."""
        return station.use(self._iter_session(station))

    def _iter_session(self, station: Station) -> Work[Outcome]:
        """Record; keep the last fit here and not as the job's result, because finished jobs stay in memory."""
        if not isinstance(self.task, AcquireUntil) and self.task.redo is not None:
            RedoList.of(self.redo).write(self.task.redo)
        how: dict[str, Any] = {"seen": self.steps.append} if self.goal else {}
        how |= {"resume": self.resume, "control": self.control, "preview": self.preview}
        seeing, rig = (self.quality, self._count), station.rig
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
        """Number of recorded positions in words."""
        return "positions" if isinstance(self.recorded, ScanPlan) else "frames"

    @property
    def rate(self) -> float:
        """Positions per second of this run so far."""
        seconds = time.monotonic() - self.started
        return self.taken / seconds if seconds > 0 else 0.0

    def _count(self, step: ScheduledFrame, *_: Any) -> None:
        self.taken += step.kind is Kind.POSITION


def _watching(plan: ScanPlan | TargetPlan, options: Options) -> LiveQuality | LiveCoverage:
    """Return what watches a session."""
    return LiveQuality(plan, window_shape(plan, options)) if isinstance(plan, ScanPlan) else LiveCoverage(plan)


@dataclass(frozen=True, eq=False)
class RecordPicture:
    """A recording at one moment, as it is drawn.

    Attributes
    ----------
    values, recorded
        ``(ny, nx)`` of the plane shown: the quantity, NaN where not known; and which positions are safe.
    depth_sum
        ``(rows, columns)`` growing sum of the plane's cutouts above the background (counts).
    curves
        For each of `QUANTITIES` number and value of the positions that are known, in the order of recording.
    alarms
        What is out of bounds, in words.
    lamp
        Words on the lamp's drift, or empty.
    complete
        Whether the plane is complete.
    done, total
        Positions that are safe, or frames of a target; and all of them.
    covered
        Whether the map shows how many frames of a target cover each position, in place of the recorded quantity.
    reading
        How far the frames of earlier runs are read, in words; empty: nothing is left to read.
    planes
        Share of each plane's positions that is recorded.
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
        """Return the range of each of `QUANTITIES` in this plane; empty if no value is known."""
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
    """Return what to draw of a recording; a pure function.

    Parameters
    ----------
    quality
        Of this run, with the depth sum of plane ``z`` only, and of earlier ones as far as it is read.
    order
        Flat positions in the order of recording.
    z, quantity
        Plane and key of `QUANTITIES` for the map.
    earlier
        ``(nz, ny, nx)`` positions that earlier runs recorded.
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
    """Return what to draw of a target's recording: frames that show each position, the light of each frame."""
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
    """Return what to draw of a recording, of single points or of a target; arguments as of `record_picture`."""
    if isinstance(made.quality, LiveCoverage):
        return coverage_picture(made.quality.state(), z)
    return record_picture(made.quality.state(z), made.order, z, quantity, earlier, made.earlier.sum_of(z))
