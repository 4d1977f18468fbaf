"""Test for each frame of a series of unknown objects whether H is still valid."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import datetime
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Cancelled, Clock, InputError, LfcalError, Work, check_number, drained
from lfcal.camera import NoLatticeError, ScanPlan
from lfcal.fit import NewFrame, Setup
from lfcal.recalibrate._alarm import LEAST_QUIET, AlarmTest, MeasuredDrift, mean_drift, rejected
from lfcal.recalibrate._drift import COPIES, FLOORS, DriftWindow
from lfcal.recalibrate._frames import distinct_label, whole_frame, windows_within
from lfcal.recalibrate._scene import ObjectFrame
from lfcal.recalibrate.model import Contents
from lfcal.recalibrate.recalibrate import ALARM
from lfcal.recalibrate.score import Goodness, Score
from lfcal.recalibrate.watched import DRIFT_NAMES, DriftTrend, DriftWatch, Three, WatchedFrame, WatchedMean

__all__ = ["RATE", "iter_watch", "watch"]

F8 = NDArray[np.float64]

RATE = 0.01
"""Default probability of a false alarm in each test."""

LINEAR = np.array([0.1, 0.1, 0.5])
"""Steps (px, px, %) above which derivatives are computed again at the drift, if H does not explain a frame."""

STEP_ERROR = 0.1
"""Error of a linear step, relative to its length."""

ROUNDS, MOST_LOST = 4, 2
"""Largest number of steps for a frame, and largest number of frames for which several steps may fail."""

HOURS, SHORTEST = 48.0, 1 / 6
"""Time span (hours) above which slopes are stated per day, and up to which they are stated per frame."""


def iter_watch(
    frames: Sequence[NewFrame],
    setup: Setup,
    plan: ScanPlan,
    *,
    quiet: Sequence[NewFrame] = (),
    times: Sequence[datetime | None] | None = None,
    noise: tuple[float, float] | None = None,
    rate: float = RATE,
    mean: int = 1,
    contents: Contents | None = None,
    windows: int | None = None,
    workers: int | None = None,
) -> Work[DriftWatch]:
    """Test whether H is still valid for the frames of a series of unknown objects; return a `DriftWatch`.

    The object of each frame is estimated with H unchanged. One step of the orthogonal score (see
    `lfcal.recalibrate.score`), or several if the drift is large, then estimates the shift of the array and the change
    of the gap.

    Parameters
    ----------
    frames
        Frames of the sensor, with their dark level subtracted. Each is read once, so the sequence may read lazily.
    setup, plan
        Camera with effects, and scan of H.
    quiet
        Frames directly after the calibration, of any objects: at least 6, or none. The drift is relative to them, and
        their scatter determines the threshold. Without them, the threshold follows from the stated noise.
    times
        Time of each frame; None: unknown.
    noise
        Variance of a sample without light (counts²), and its increase per count of signal; None: as stated by the
        frames.
    rate
        Probability of a false alarm in each test if H is valid; above 0 and below 0.5.
    mean
        Number of consecutive frames to average before each test.
    contents
        Assumptions about the contents of frames; None: the planes of H and a bilinear dark field.
    windows
        Number of windows of the sensor to use; None: one, or five for a large sensor.
    workers
        Number of threads; None: all processors.

    Yields
    ------
    Progress
        First in matrices H and derivatives that are computed, then in frames.

    Raises
    ------
    InputError
        If no frame can be used, the quiet frames are too few, ``rate`` or ``mean`` is out of range, or the camera has
        no lenslet lattice.

    Examples
    --------
    >>> from lfcal.base import drain
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.fit import Setup
    >>> from lfcal.recalibrate import iter_watch
    >>> plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[3, 4], cutout=49)
    >>> drain(iter_watch([], Setup(plan.camera, (), (0.0, 0.0)), plan, rate=2))
    Traceback (most recent call last):
    lfcal.base.errors.InputError: rate of false alarms: expected a number > 0 and < 0.5, got 2; correct this value
    """
    check_number("rate of false alarms", rate, above=0, below=0.5)
    check_number("mean", mean, at_least=1)
    if not frames:
        raise InputError.expected("frames", "at least one", "none", "give frames of structured objects")
    if 0 < len(quiet) < LEAST_QUIET:
        raise InputError.expected(
            "quiet frames",
            f"at least {LEAST_QUIET}, or none",
            len(quiet),
            "give more frames from after the calibration",
        )
    if not plan.camera.has_lattice:
        raise NoLatticeError.of("watching frames")
    array = _Array(setup, plan, contents or Contents(plan.depths_um), noise, windows, workers)
    clock = Clock("watch", len(quiet) + len(frames))
    yield clock.at(0)
    calm: list[_Measured] = []
    found: list[_Measured] = []
    for series, own in ((quiet, calm), (frames, found)):
        for k in range(len(series)):
            own.append((yield from array.iter_measured(series, k, [one.name for one in own])))
            yield clock.at(len(calm) + len(found))
    return _summary(calm, found, times or [None] * len(frames), rate, mean)


watch = drained(
    iter_watch,
    """
    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.fit import Setup
    >>> from lfcal.recalibrate import watch
    >>> plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[3, 4], cutout=49)
    >>> watch([], Setup(plan.camera, (), (0.0, 0.0)), plan)
    Traceback (most recent call last):
    lfcal.base.errors.InputError: frames: expected at least one, got none; give frames of structured objects
    """,
)


class _Measured(NamedTuple):
    """Drift in a frame, or the reason why there is none."""

    name: str
    drift: MeasuredDrift | None = None
    goodness: Goodness | None = None
    problem: str = ""

    def seen(self, when: datetime | None, start: F8, test: AlarmTest) -> WatchedFrame:
        """Return the result for the frame, relative to the drift ``start``."""
        if self.drift is None:
            return WatchedFrame(self.name, when, goodness=self.goodness, problem=self.problem)
        sigmas = test.errors(self.drift)
        return WatchedFrame(
            self.name, when, _three(self.drift.values - start), _three(sigmas), self.goodness, self.problem
        )


_Used = tuple[str, MeasuredDrift, datetime | None]
"""Name, drift and time of a frame that is used."""


class _Array:
    """H and its derivatives with respect to the drifts in all windows, for the camera of H or a drifted one."""

    def __init__(
        self,
        setup: Setup,
        plan: ScanPlan,
        contents: Contents,
        noise: tuple[float, float] | None,
        windows: int | None,
        workers: int | None,
    ) -> None:
        self.plan, self.noise, self.lost = plan, noise, 0
        places = windows_within(plan, windows, COPIES, every=True)
        self.windows = [DriftWindow(one, setup, contents, workers) for one in places]
        self.at: F8 = np.zeros(len(DRIFT_NAMES))
        self._prepared = False

    def iter_prepared(self) -> Work[None]:
        """Compute H and its derivatives at the drift ``at``."""
        clock = Clock("H and its derivatives", (1 + len(DRIFT_NAMES)) * len(self.windows))
        yield clock.at(0)
        done = 0
        for window in self.windows:
            for _ in window.iter_prepared(self.at):
                done += 1
                yield clock.at(done)
        self._prepared = True

    def iter_measured(self, frames: Sequence[NewFrame], k: int, taken: Sequence[str]) -> Work[_Measured]:
        """Return the drift in a frame; a frame that cannot be used does not end the series."""
        name = distinct_label(f"frame {k + 1}", taken)
        try:
            frame = frames[k]
            name = distinct_label(frame.label or name, taken)
            whole = whole_frame(frame, name, self.plan, self.noise)
            return (yield from self._iter_drift(whole))
        except Cancelled:
            raise
        except LfcalError as error:
            return _Measured(name, problem=str(error))

    def _iter_drift(self, frame: ObjectFrame) -> Work[_Measured]:
        """Return the drift; a large one is found in several steps, after which the array stays where it was found."""
        begin = self.at
        if not self._prepared:  # only after a frame was read: a large sensor needs minutes
            yield from self.iter_prepared()
        for _ in range(ROUNDS):
            found = self._step(frame)
            assert found.drift is not None
            step = found.drift.values - self.at
            if not found.problem or self.lost >= MOST_LOST or (np.abs(step) < LINEAR).all():
                break
            self.at = found.drift.values
            yield from self.iter_prepared()
        if found.problem and self.at is not begin:
            self.lost += 1
            self.at = begin
            yield from self.iter_prepared()
        return found

    def _step(self, frame: ObjectFrame) -> _Measured:
        """Return the drift after one step from the drift ``self.at``."""
        parts = [one for window in self.windows if (one := window.measured(frame)) is not None]
        if not parts:
            raise InputError.expected(
                frame.name, "valid pixels in a window of the sensor", "none", "check mask and saturation level"
            )
        total = sum((score for score, _ in parts), Score.none(len(self.at)))
        goodness = max((one for _, one in parts), key=lambda one: one.ratio)
        if np.linalg.eigvalsh(total.information)[0] <= 0:
            raise InputError.expected(
                f"{frame.name}, objects", "structure that shows the lenslets", "none", "give brighter frames"
            )
        noise = np.asarray(np.linalg.inv(total.information), np.float64)
        step = noise @ total.gradient
        noise = max(1.0, goodness.ratio) * noise
        drift = MeasuredDrift(self.at + step, noise, FLOORS, STEP_ERROR * np.abs(step))
        limit = max(ALARM, 1 + 3 * math.sqrt(2 / max(1.0, goodness.freedom)))
        words = (
            f"H does not explain it: the goodness of fit is {goodness.ratio:.2f}, but at most {limit:.2f} is allowed"
        )
        return _Measured(frame.name, drift, goodness, words if goodness.ratio > limit else "")


def _summary(
    quiet: Sequence[_Measured],
    frames: Sequence[_Measured],
    times: Sequence[datetime | None],
    rate: float,
    mean: int,
) -> DriftWatch:
    """Return the tests of all frames."""
    if all(one.drift is None for one in frames):
        raise InputError(frames[0].problem)
    calm = [one.drift for one in quiet if one.drift is not None and not one.problem]
    if quiet and len(calm) < LEAST_QUIET:
        reason = next(one for one in quiet if one.problem)
        raise InputError.expected(
            "quiet frames",
            f"at least {LEAST_QUIET} that H explains",
            f"{len(calm)}; {reason.name}: {reason.problem}",
            "calibrate again, or give other frames",
        )
    test = AlarmTest(calm, rate)
    start = test.start
    used = [
        (one.name, one.drift, when) for one, when in zip(frames, times, strict=True) if one.drift and not one.problem
    ]
    groups = [used[k : k + mean] for k in range(0, len(used), mean)]
    means = [_tested(own, start, test) for own in groups]
    every = [_tested(used, start, test, floored=True)] if len(means) > 1 else []
    significant = rejected([one.chance for one in (*means, *every)], rate)
    moved = [one for k in significant if k < len(groups) for one in groups[k]]
    values, sigmas = _mean([drift for _, drift, _ in moved or used], start, test)
    dated = zip(frames, times, strict=True)
    return DriftWatch(
        tuple(one.seen(when, start, test) for one, when in dated),
        tuple(one.seen(None, start, test) for one in quiet),
        tuple(means),
        tuple(k for k in significant if k < len(groups)),
        bool(significant),
        values,
        sigmas,
        _trends(
            [drift for _, drift, _ in used],
            [when for _, _, when in used],
            [k for k, one in enumerate(frames) if one.drift and not one.problem],
        ),
        rate,
        test.threshold(),
        not calm,
    )


def _tested(used: Sequence[_Used], start: F8, test: AlarmTest, *, floored: bool = False) -> WatchedMean:
    """Return the mean of frames and its test; with ``floored``, averaging does not reduce the error of the model."""
    drifts = [drift for _, drift, _ in used]
    square, chance = test.tested(drifts, floored=floored)
    names = tuple(name for name, _, _ in used)
    return WatchedMean(names, *_mean(drifts, start, test), square, chance, square > test.threshold())


def _mean(drifts: Sequence[MeasuredDrift], start: F8, test: AlarmTest) -> tuple[Three, Three]:
    """Return the mean of drifts relative to ``start``, and its standard deviations; NaN without drifts."""
    if not drifts:
        return (math.nan,) * 3, (math.nan,) * 3
    found = mean_drift(drifts)
    return _three(found.values - start), _three(test.errors(found))


def _trends(
    drifts: Sequence[MeasuredDrift], times: Sequence[datetime | None], index: Sequence[int]
) -> tuple[DriftTrend, ...]:
    """Return the slopes of weighted straight lines. Their errors include a scatter that is larger than stated.

    ``index`` is the position of the frame of each drift in the series, including frames without a drift.
    """
    known = [one.timestamp() / 3600 for one in times if one is not None]
    t, per = np.array(index, np.float64), "frame"
    if len(known) == len(drifts) > 0 and np.ptp(known) > SHORTEST:
        t, per = np.array(known), "hour"
        if np.ptp(t) > HOURS:
            t, per = t / 24, "day"
    if len(drifts) < 3:
        return ()
    values = np.stack([one.values for one in drifts])
    weights = 1 / np.stack([np.diag(one.noise) for one in drifts])
    found = []
    for name, v, w in zip(DRIFT_NAMES, values.T, weights.T, strict=True):
        away = t - np.average(t, weights=w)
        power = float((w * away**2).sum())
        slope = float((w * away * v).sum()) / power
        left = v - np.average(v, weights=w) - slope * away
        scatter = max(1.0, float((w * left**2).sum()) / max(1, len(v) - 2))
        found.append(DriftTrend(name, slope, math.sqrt(scatter / power), per))
    return tuple(found)


def _three(values: F8) -> Three:
    x, y, gap = values.tolist()
    return x, y, gap
