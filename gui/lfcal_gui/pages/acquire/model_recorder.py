"""A recording as the window follows it: run, watched, and turned into pictures. No Qt."""

from __future__ import annotations

import shutil
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire import (
    Control,
    Kind,
    LiveCoverage,
    LiveQuality,
    Options,
    Outcome,
    Preview,
    QualityState,
    RedoList,
    ScheduledFrame,
    coarse_order,
    frame_grid,
    frame_positions,
    window_shape,
)
from lfcal.base import Progress, Work, format_seconds
from lfcal.camera import ScanPlan
from lfcal.frames import Position
from lfcal.tasks import Acquire, AcquireTarget, AcquireUntil
from lfcal_gui.pages.acquire.model_earlier import EarlierFrames, EarlierRuns, PlaneSum
from lfcal_gui.pages.acquire.model_station import Station

if TYPE_CHECKING:
    from lfcal.campaign import AdaptiveStep
    from lfcal.fit import Fit
    from lfcal.targets import TargetPlan

__all__ = [
    "QUANTITIES",
    "CoveredByHand",
    "FolderState",
    "RecordPicture",
    "Recorder",
    "folder_state",
    "lamp_words",
    "record_picture",
]

QUANTITIES = (("energy", "energy (counts)"), ("residual", "position residual (px)"), ("saturated", "saturated (px)"))
"""What the map and the curves show."""


ELSEWHERE = "the folder holds a session of {}; lfcal acquire --resume goes on with it"


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
        """Return whether dark frames are wanted: the lens stays uncovered, for the stage is checked first."""
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
        """Record; the last fit is kept here: jobs are remembered long after they ended."""
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
        """What is recorded, for people."""
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
class FolderState:
    """What a session folder holds.

    Attributes
    ----------
    there
        ``(nz, ny, nx)`` which positions are acknowledged; None: the folder holds no session.
    how
        How the last run ended.
    problem
        Why the folder cannot be read, or empty.
    plan, options
        Of the session.
    chosen
        ``(nz, ny, nx)`` the positions that were chosen to be recorded; None: all of the plan.
    target
        The plan of a target whose frames are recorded: then ``there`` counts these, ``(frames,)``.
    recordings
        Names of the files with its frames, oldest first.
    free_bytes
        Space on its disk; None where that is not known.
    """

    there: NDArray[np.bool_] | None = None
    how: str = ""
    problem: str = ""
    plan: ScanPlan | None = None
    options: Options | None = None
    chosen: NDArray[np.bool_] | None = None
    target: TargetPlan | None = None
    recordings: tuple[str, ...] = ()
    free_bytes: float | None = None

    @property
    def counts(self) -> tuple[int, int]:
        """Number of positions, or frames of a target, that are safe, and number of all."""
        if self.there is None:
            return 0, 0
        if self.chosen is None:
            return int(self.there.sum()), self.there.size
        return int(self.there[self.chosen].sum()), int(self.chosen.sum())

    def known(self, but: Sequence[Position] = ()) -> EarlierRuns | None:
        """Return what is acknowledged, without positions to record again; None: nothing is."""
        if self.there is None or self.plan is None:
            return None
        if self.target is None:
            grid = self.plan.shape[:3]
            flat = np.flatnonzero(self.there)
        else:
            grid = frame_grid(self.target)
            flat = np.ravel_multi_index(tuple(frame_positions(self.target)[self.there].T), grid)
        again = np.ravel_multi_index(tuple(np.array(but, np.intp).reshape(-1, 3).T), grid, mode="clip")
        return EarlierRuns(np.setdiff1d(flat, again), grid, self.recordings)

    @property
    def complete(self) -> bool:
        """Whether every position that is to be recorded is."""
        if self.there is None:
            return False
        return bool(self.there.all() if self.chosen is None else self.there[self.chosen].all())

    def planes(self) -> tuple[int, ...]:
        """Return the planes of which every position is recorded."""
        if self.there is None or self.target is not None:
            return ()
        return tuple(np.flatnonzero(self.there.reshape(len(self.there), -1).all(axis=1)).tolist())

    def words(self) -> str:
        """Return the state in a line."""
        if self.problem:
            return self.problem
        if self.there is None:
            return "a new session"
        done, total = int(self.there.sum()), self.there.size
        if self.target is not None:
            return f"{done} of {total} frames of a target safe on disk" + (
                f"; the last run: {self.how}" if self.how else ""
            )
        if self.chosen is not None:
            of = f"{done} of {int(self.chosen.sum())} chosen positions safe on disk, of {total} of the plan"
            return of + (f"; the last run: {self.how}" if self.how else "")
        return f"{done} of {total} positions safe on disk" + (f"; the last run: {self.how}" if self.how else "")


def folder_state(folder: str) -> FolderState:
    """Return what is recorded in ``folder``; a damaged session is a problem in words, not an error."""
    return replace(_state_of(folder), free_bytes=_free_bytes(folder))


def _free_bytes(folder: str) -> float | None:
    """Return the space on the disk of a folder that may not be there yet."""
    path = Path(folder)
    there = next((one for one in (path, *path.parents) if one.is_dir()), None) if folder else None
    try:
        return None if there is None else float(shutil.disk_usage(there).free)
    except OSError:
        return None


def _state_of(folder: str) -> FolderState:
    from lfcal.acquire import SessionFile
    from lfcal.base import LfcalError

    if folder and (Path(folder) / "regions.json").exists():
        return FolderState(problem=ELSEWHERE.format("several regions of the field"))
    if not folder or not (Path(folder) / "session.json").exists():
        return FolderState()
    try:
        session = SessionFile.read(Path(folder))
        there = session.acknowledged(Path(folder))
    except (LfcalError, OSError) as error:
        return FolderState(problem=str(error))
    how = session.runs[-1].how if session.runs else ""
    if session.target is not None:
        target: TargetPlan = session.target  # type: ignore[assignment]  # a session's frame plan is a target's
        there = there[tuple(frame_positions(target).T)]
        return FolderState(there, how, "", session.plan, session.options, None, target, session.recordings)
    chosen = session.chosen if session.redo[0] else None
    return FolderState(there, how, "", session.plan, session.options, chosen, None, session.recordings)


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
        Whether the map tells how many frames of a target show each position, and not what was recorded there.
    reading
        How far the frames of earlier runs are read, in words; empty: nothing is left to read.
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


def record_picture(
    quality: QualityState,
    order: NDArray[np.intp],
    z: int,
    quantity: str,
    earlier: NDArray[np.bool_] | None,
    read: PlaneSum | None = None,
) -> RecordPicture:
    """Return what to draw: pure.

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
    )


def lamp_words(lamp: NDArray[np.float64]) -> str:
    """Return in words how the lamp drifted, by its reference frames ``(n, 2)``; empty where nothing tells."""
    if len(lamp) < 2 or lamp[0, 1] <= 0:
        return ""
    change = 100 * (lamp[:, 1] / lamp[0, 1] - 1)
    return f"lamp {change[-1]:+.2f} % after {format_seconds(float(lamp[-1, 0] - lamp[0, 0]))}, {len(lamp)} references"
