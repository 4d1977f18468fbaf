"""Adaptive acquisition: record some positions, fit, choose the next ones, until the error of H is small enough.

All state is in the recorded session; after a crash, the next positions are chosen again from it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire import (
    Control,
    Observer,
    Options,
    Outcome,
    Preview,
    RecordingSource,
    SessionFile,
    check_devices,
    check_new,
    iter_record,
)
from lfcal.base import InputError, Progress, Work, check_number, format_share
from lfcal.camera import ScanPlan
from lfcal.devices import Rig
from lfcal.fit import (
    ERRORS,
    Earlier,
    Expected,
    Fineness,
    Fit,
    Measured,
    ModelError,
    PositionDesign,
    iter_fit_camera,
    iter_next_positions,
    measured_of,
)
from lfcal.frames import CorrectionRecipe, Position, corrected_view, oriented, stated_noise
from lfcal.psf import iter_pick, iter_upright, scan_noise

__all__ = ["FEWEST", "Adapted", "AdaptiveStep", "Goal", "iter_adaptive", "iter_session_patterns"]


def iter_session_patterns(folder: Path) -> Work[Measured]:
    """Read and return the patterns of all recorded positions of a session; progress counts positions.

    Raises
    ------
    InputError
        If the frames are evidently not oriented as planned, or their noise is unknown.
    StorageError, FileFormatError
        If the folder contains no session, or the session is damaged.
    """
    with RecordingSource(folder) as source:
        view = corrected_view(source, CorrectionRecipe(), source.plan)
        turn, _ = yield from iter_upright(view, source.plan)
        upright = oriented(view, turn, source.plan.camera.sensor.shape)
        index = np.unique(np.array([source.info(k).position for k in range(len(source))], np.intp), axis=0)
        matrix = yield from iter_pick(upright, source.plan, index, noise=scan_noise(upright, source.plan))
        noise = matrix.facts.noise
        known = None if noise is None else noise[tuple(index.T)]
        if known is None or not np.isfinite(known).all() or (known[:, 0] < 0).any():
            got, remedy = "none", "record single exposures and dark frames, with a camera whose noise is known"
            raise InputError.expected(f"{folder}, noise of the frames", "a known variance", got, remedy)
        aside = source.metadata.kept_aside
        return measured_of(matrix, held_out=[list(p) for p in aside])


FIRST = 12
"""Default number of positions before the first fit."""

FEWEST = 5
"""Smallest number of positions added at a time, because a fit follows each time."""


ENDS = {
    "reached": "the target error of H is reached, according to the fit",
    "used up": "no further positions can be recorded, but the target error of H is not reached",
    "incomplete": "the model is incomplete: more patterns do not reduce the error of H",
}
"""Meaning of each way in which the session can end without the user."""


@dataclass(frozen=True, slots=True)
class Goal:
    """Stopping rule of an adaptive session, and unknowns to fit.

    Attributes
    ----------
    error
        Target relative error (L2) of H, such as 0.01 for 1 %; it cannot be below the error of the simulated patterns.
    most
        Largest number of positions. None: all positions of the plan.
    first
        Number of positions before the first fit.
    unknowns
        Groups of unknowns, or ``"auto"``, as in `lfcal.fit.fit_camera`.
    candidates
        Number of candidate positions from which the next positions are chosen; 0: all.

    Examples
    --------
    >>> from lfcal.campaign import Goal
    >>> goal = Goal(error=0.01, most=60)  # an error of H of 1 %, with 60 positions at most
    >>> print(goal.first, "positions before the first fit")
    12 positions before the first fit
    """

    error: float
    most: int | None = None
    first: int = FIRST
    unknowns: str | Sequence[str] = "auto"
    candidates: int = 300

    def __post_init__(self) -> None:
        """Check all values."""
        least = ERRORS[Fineness.finest]
        remedy = f"give a larger error: the simulation of patterns itself has an error of {format_share(least)}"
        check_number("target error of H", self.error, at_least=least, below=1, remedy=remedy)
        check_number("positions before the first fit", self.first, at_least=FEWEST, integer=True)
        if self.most is not None:
            check_number("largest number of positions", self.most, at_least=self.first, integer=True)


@dataclass(frozen=True, slots=True)
class AdaptiveStep:
    """State of an adaptive session after one fit.

    Attributes
    ----------
    positions
        Number of positions recorded so far.
    expected_error
        Expected relative error (L2) of H due to the uncertainties of the fitted unknowns.
    held_out_error
        Relative error (L2) of H, estimated from held-out patterns; if noise hides it, an upper limit.
    chi2, complete
        `ChiSquare.lit` of the fit (1 for a correct model), and whether the model explains the patterns to within their
        noise.
    groups
        Names of the groups of unknowns that were fitted.
    outliers
        Number of patterns that were excluded from the fit.
    """

    positions: int
    expected_error: float
    held_out_error: ModelError
    chi2: float
    complete: bool
    groups: tuple[str, ...]
    outliers: int

    def __str__(self) -> str:
        """Return the error and the number of positions as one line."""
        said = f"{self.positions} positions: expected error of H {format_share(self.expected_error)}"
        return f"{said}, {self.held_out_error} at held-out positions" + ("" if self.complete else "; model incomplete")

    def to_dict(self) -> dict[str, Any]:
        """Return all values as plain JSON types.

        The held-out error is returned as ``left_out_error`` (None: hidden by noise) and ``left_out_limit``, its upper
        limit.
        """
        error = self.held_out_error
        left = {"left_out_error": error.value if error.known else None, "left_out_limit": error.limit}
        return {key: value for key, value in asdict(self).items() if key != "held_out_error"} | left

    def reaches(self, error: float) -> bool:
        """Return whether the model is complete and the expected error of H is at most ``error``.

        It returns False if the error of held-out patterns is known to exceed ``error`` by more than two standard
        deviations.
        """
        known = self.held_out_error.known and self.held_out_error.value - 2 * self.held_out_error.sigma > error
        return self.complete and self.expected_error <= error and not known


@dataclass(frozen=True, eq=False)
class Adapted:
    """Result of an adaptive session.

    Attributes
    ----------
    how
        How the session ended. ``"reached"``: the target error is reached. ``"used up"``: no further positions may be
        recorded. ``"incomplete"``: the model is incomplete, and more patterns do not help. ``"stopped"`` or
        ``"aborted"``: the user ended the session.
    outcome
        Outcome of the recording.
    steps
        State of the session after each fit.
    fit
        The last fit; None if there was none.
    """

    how: str
    outcome: Outcome
    steps: tuple[AdaptiveStep, ...]
    fit: Fit | None

    @property
    def words(self) -> str:
        """Line of text that states why the session ended; empty if the user ended it."""
        return ENDS.get(self.how, "")

    def to_dict(self) -> dict[str, Any]:
        """Return the reason for the end and the results of each fit as plain JSON types, without `outcome` or `fit`."""
        return {"ended": self.how, "steps": [step.to_dict() for step in self.steps]}


R = TypeVar("R")

GAINED = 0.9
"""Ratio of the held-out error to that of the previous step above which an incomplete model has not improved."""


def iter_adaptive(
    folder: Path,
    plan: ScanPlan,
    rig: Rig,
    goal: Goal,
    options: Options | None = None,
    *,
    resume: bool = False,
    control: Control | None = None,
    preview: Preview | None = None,
    observers: tuple[Observer, ...] = (),
    seen: Callable[[AdaptiveStep], object] = lambda _: None,
    workers: int | None = None,
    task: Mapping[str, Any] | None = None,
) -> Work[Adapted]:
    """Record positions of ``plan`` until the error of H is at most ``goal.error``; yield progress.

    The session also ends for the other reasons listed in `Adapted`.

    Parameters
    ----------
    folder
        A new or empty folder; with ``resume``, the folder of an earlier session.
    plan, rig, options, control, preview, observers, task
        As in `lfcal.acquire.iter_record`.
    goal
        Stopping rule and unknowns to fit.
    resume
        Whether to continue the adaptive session in ``folder``.
    seen
        Function that is called with each `AdaptiveStep` after its fit.
    workers
        Number of threads for fits and for the choice of positions. None: all processors.

    Raises
    ------
    InputError
        If the noise of the frames would be unknown, or the simulator computes patterns without lenslets. Also if the
        session to continue is that of a complete scan, or no camera of this kind explains the patterns.
    AcquisitionStopped
        If recording had to end early; it can be resumed.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.campaign import Adapted, AdaptiveStep, Goal, iter_adaptive
    >>> from lfcal.devices import open_rig
    >>> plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0])
    >>> steps: list[AdaptiveStep] = []  # how good H is after each round
    >>> work = iter_adaptive(Path("new"), plan, open_rig(plan, "sim"), Goal(error=0.01), seen=steps.append)
    >>> print(next(work).stage)
    information of patterns
    >>> work.close()  # run to its end, it returns an Adapted
    """
    recording = {"preview": preview, "observers": observers}
    campaign = _Campaign(
        folder, plan, rig, goal, options, control=control or Control(), recording=recording, task=task, workers=workers
    )
    outcome = yield from campaign.begin(resume=resume)
    steps: list[AdaptiveStep] = []
    fit: Fit | None = None
    began = time.perf_counter()
    while True:
        if outcome is None or outcome.how != "complete":
            return Adapted(campaign.ended, campaign.whole(outcome), tuple(steps), fit)
        found = yield from campaign.stoppable(campaign.fitted())
        if found is None:
            return Adapted(campaign.ended, campaign.whole(None), tuple(steps), fit)
        fit, measured = found
        steps.append(campaign.step(fit))
        seen(steps[-1])
        yield Progress(len(steps), 0, "error of H", time.perf_counter() - began, str(steps[-1]))
        how = campaign.over(steps)
        if how:
            return Adapted(how, campaign.whole(outcome), tuple(steps), fit)
        design = yield from campaign.stoppable(campaign.choice(fit, measured))
        outcome = None if design is None else (yield from campaign.more(design, steps[-1]))


class _Campaign:
    """One adaptive session; its recorded frames are read from its folder every time."""

    def __init__(
        self,
        folder: Path,
        plan: ScanPlan,
        rig: Rig,
        goal: Goal,
        options: Options | None,
        *,
        control: Control,
        recording: Mapping[str, Any],
        task: Mapping[str, Any] | None,
        workers: int | None,
    ) -> None:
        self._folder, self._plan, self._rig, self._goal = folder, plan, rig, goal
        self._options, self._control, self._recording = options, control, recording
        self._task, self._workers = task, workers
        self._most = min(plan.n_positions, goal.most or plan.n_positions)
        self._seconds = 0.0
        self._notes: tuple[str, ...] = ()

    @property
    def ended(self) -> str:
        """Reason for the end of the session, if recording was interrupted."""
        return "aborted" if self._control.aborting else "stopped"

    def begin(self, *, resume: bool) -> Work[Outcome | None]:
        """Record the first positions, or the remaining ones of an interrupted session."""
        if resume:
            session = SessionFile.read(self._folder)
            if not session.redo[0]:
                got, remedy = (
                    "a scan of all of them",
                    "resume it as a scan of all positions, or record into another folder",
                )
                raise InputError.expected(f"{self._folder}", "a session of chosen positions", got, remedy)
            return (yield from self._record(resume=True))
        # do slow work only after all checks
        check_new(self._folder)
        if check_devices(self._plan, self._rig).optics == "pattern":
            got, remedy = (
                "the simulator's quick pattern, which has no lenslets",
                "open the simulator with its default optics",
            )
            raise InputError.expected("devices", "a camera that a fit can model", got, remedy)
        options = self._options or Options()
        if not options.plain:
            got, remedy = "frames merged from several exposures", "record without an exposure bracket"
            raise InputError.expected("exposures", "single exposures, whose noise is known", got, remedy)
        if stated_noise(self._plan.camera) is None:
            raise InputError.expected(
                "noise of the camera",
                "a stated or measured noise",
                "an assumed one",
                "measure it from flat-field and dark frames (lfcal camera sensor)",
            )
        work = iter_next_positions(
            self._plan,
            min(self._goal.first, self._most),
            groups=None if isinstance(self._goal.unknowns, str) else self._goal.unknowns,
            candidates=self._goal.candidates,
            workers=self._workers,
        )
        design = yield from self.stoppable(work)
        if design is None:
            return None
        return (yield from self._record(only=_positions(design.positions), kept_aside=_positions(design.held_out)))

    def more(self, design: PositionDesign, step: AdaptiveStep) -> Work[Outcome]:
        """Record the positions of ``design`` that are expected to be sufficient for the goal."""
        # errors of the design exclude the brightness of each plane; those of the fit include it
        scale = step.expected_error / design.start_error if design.start_error else 1.0
        enough = design.enough_for(self._goal.error / max(1.0, scale))
        count = len(design.positions) if enough is None else max(enough.positions, min(FEWEST, len(design.positions)))
        apart = min(len(design.held_out), max(1, round(count * len(design.held_out) / len(design.positions))))
        aside = design.held_out[:apart]
        chosen = np.concatenate([design.fitted[: count - apart], aside])
        return (yield from self._record(redo=_positions(chosen), kept_aside=_positions(aside)))

    def _record(
        self,
        *,
        resume: bool = False,
        only: list[Position] | None = None,
        redo: list[Position] | None = None,
        kept_aside: Sequence[Position] = (),
    ) -> Work[Outcome]:
        options = self._options
        if redo is not None:  # the stage was already checked with the first positions
            options = replace(options or SessionFile.read(self._folder).options, check_stage=False)
        outcome = yield from iter_record(
            self._folder,
            self._plan,
            self._rig,
            options,
            resume=resume,
            redo=redo,
            only=only,
            kept_aside=kept_aside,
            control=self._control,
            task=self._task if redo is None else None,
            **self._recording,
        )
        self._seconds += outcome.seconds
        self._notes += outcome.notes
        return outcome

    def fitted(self) -> Work[tuple[Fit, Measured]]:
        """Fit everything recorded so far."""
        measured = yield from iter_session_patterns(self._folder)
        fit = yield from iter_fit_camera(measured, unknowns=self._goal.unknowns, workers=self._workers)
        return fit, measured

    def choice(self, fit: Fit, measured: Measured) -> Work[PositionDesign]:
        """Choose further positions, at most as many as already recorded."""
        left = self._most - len(self._recorded())
        sensor = self._plan.camera.sensor
        # with the brightness of the recorded patterns, which includes exposure and lamp
        full = float(measured.patterns.max()) / (sensor.max_value - sensor.black_level)
        design = yield from iter_next_positions(
            self._plan,
            min(left, max(FEWEST, len(measured))),
            earlier=Earlier.of(fit),
            recorded=self._recorded(),
            expected=Expected(min(1.0, max(1e-3, full)), **asdict(fit.spread)),
            candidates=self._goal.candidates,
            workers=self._workers,
        )
        return design

    def step(self, fit: Fit) -> AdaptiveStep:
        """Return the state after a fit."""
        error, count = fit.held_out_error, len(self._recorded())
        return AdaptiveStep(count, error.statistical, error, fit.chi2, fit.complete, fit.groups, len(fit.outliers))

    def over(self, steps: Sequence[AdaptiveStep]) -> str:
        """Return how the session ends after these steps; empty if it continues."""
        now = steps[-1]
        if now.reaches(self._goal.error):
            return "reached"
        if now.positions + FEWEST > self._most:
            return "used up"
        # if the expected error is small enough but the actual one is not, the model is wrong
        if now.expected_error <= self._goal.error:
            return "incomplete"
        return "incomplete" if not now.complete and _gained_nothing(steps) else ""

    def whole(self, last: Outcome | None) -> Outcome:
        """Return the outcome of the recording, with the duration and the notes of all of its runs."""
        how = self.ended if last is None else last.how
        there = (self._folder / "session.json").exists()
        count = len(self._recorded()) if there else 0
        damaged = 0 if last is None else last.damaged
        total = count if last is None else max(count, last.total)
        return Outcome(how, count, total, self._seconds, damaged, self._notes)

    def stoppable(self, work: Work[R]) -> Work[R | None]:
        """Do work that can be stopped between its reports; return None if it was stopped."""
        while True:
            try:
                record = next(work)
            except StopIteration as stop:
                found: R = stop.value
                return found
            if self._control.stopping or self._control.aborting:
                work.close()
                return None
            yield record

    def _recorded(self) -> NDArray[np.intp]:
        try:
            with RecordingSource(self._folder) as source:
                return np.array([source.info(k).position for k in range(len(source))], np.intp).reshape(-1, 3)
        except InputError:
            return np.zeros((0, 3), np.intp)


def _gained_nothing(steps: Sequence[AdaptiveStep]) -> bool:
    """Return whether the last patterns neither lowered the held-out error nor added a group of unknowns."""
    if len(steps) < 2:
        return False
    before, now = steps[-2].held_out_error, steps[-1].held_out_error
    same = steps[-2].groups == steps[-1].groups
    return same and now.known and before.known and now.value > GAINED * before.value


def _positions(index: NDArray[np.intp]) -> list[Position]:
    return [Position(*place) for place in index.tolist()]
