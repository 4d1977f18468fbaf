"""Measurement of curves, point by point, within a time limit; results are kept if the work is stopped."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace

from lfcal.accuracy.curves import CostPoint, Curve
from lfcal.accuracy.part import AccuracyPart, AccuracyStep, Measuring, Truth
from lfcal.accuracy.subject import Subject
from lfcal.base import LfcalError, Progress, Work, check_number, drained, format_seconds

__all__ = ["SECONDS", "CurveProgress", "iter_measure_curve", "measure_curve"]

SECONDS = 10.0
"""Default time limit for a curve (s)."""

LATEST = 2.0
"""Latest end of the reference and of a step in progress, relative to the time limit (at least `SECONDS`)."""

FOR_POINTS = 0.4
"""Fraction of the time limit that is reserved for the points, however long the reference took."""


@dataclass(frozen=True, slots=True)
class CurveProgress(Progress):
    """Progress of the measurement of a curve, with its results so far.

    Attributes
    ----------
    curve
        The current curve, with the points measured so far. The other attributes are those of `lfcal.base.Progress`.

    Examples
    --------
    >>> from lfcal.accuracy import PARTS, CurveProgress, Subject, iter_measure_curve
    >>> from lfcal.camera import ScanPlan, preset
    >>> subject = Subject("bench", ScanPlan.for_camera(preset("bench"), virtual_depths=[3], cutout=63))
    >>> work = iter_measure_curve(PARTS.get("storage"), subject)
    >>> step: CurveProgress = next(work)
    >>> work.close()
    >>> print(step.curve.title, len(step.curve.points))
    H file: stored type and compression 0
    """

    curve: Curve = field(kw_only=True)


@dataclass
class _Run:
    """A measurement in progress: its results, and its time limit."""

    curve: Curve
    seconds: float
    number: int
    total: int
    start: float = field(default_factory=lambda: time.perf_counter())
    limit: float = field(init=False)
    point_at: float = 0.0
    longest: float = 0.0

    def __post_init__(self) -> None:
        self.limit = self.seconds

    @property
    def elapsed(self) -> float:
        return time.perf_counter() - self.start

    def record(self, note: str = "") -> CurveProgress:
        return CurveProgress(self.number, self.total, "cost of accuracy", self.elapsed, note, curve=self.curve)

    def take(self, found: Truth | AccuracyStep | CostPoint | Progress) -> str:
        """Process one result of the measurement; return a remark on it."""
        if isinstance(found, Truth):
            self.curve = replace(self.curve, truth=found.label, notes=found.notes)
            self.point_at = self.elapsed
            self.limit = max(self.limit, self.point_at + FOR_POINTS * self.seconds)
            return f"{self.curve.title}: reference"
        if isinstance(found, CostPoint):
            self.curve = self.curve.with_point(found)
            now = self.elapsed
            self.longest, self.point_at = now - self.point_at, now
            return f"{self.curve.title}: {found.label}"
        inner = found.label if isinstance(found, AccuracyStep) else found.stage
        return f"{self.curve.title}: {inner}"

    def too_long(self, found: Truth | AccuracyStep | CostPoint | Progress) -> str:
        """Return the reason to end the measurement if the next step would end too late; empty: continue."""
        if isinstance(found, Truth):
            return ""
        started = bool(self.curve.points)
        # a reference and a step in progress may take longer, because ending them would lose their results
        latest, ahead, words = LATEST * max(self.seconds, SECONDS), 0.0, ""
        if isinstance(found, CostPoint):
            latest = self.limit
        elif isinstance(found, AccuracyStep):
            # a step without an estimate is assumed to take as long as the previous point
            ahead = self.longest if found.seconds is None else found.seconds
            latest = self.limit if started else latest
            words = f", before: {found.label}" + f" (about {format_seconds(ahead)})" * (ahead > 0)
            if not started and found.seconds is None:
                return ""
        else:
            words = f", during: {found.stage}" if started else " before any setting was measured"
        if self.elapsed + ahead <= latest:
            return ""
        if isinstance(found, AccuracyStep) and not started:
            return f"not begun: {found.label} takes about {format_seconds(ahead)}"
        return f"ended after {format_seconds(self.elapsed)}{words}"


def iter_measure_curve(
    part: AccuracyPart, subject: Subject, seconds: float = SECONDS, *, number: int = 0, total: int = 1
) -> Work[Curve]:
    """Measure one part of the processing, and return its curve of error against cost.

    If there is no curve for this subject, or the measurement fails or runs out of time before all points are measured,
    `Curve.stopped` states why.

    Parameters
    ----------
    part
        Part of the processing to measure.
    subject
        Plan or H to measure.
    seconds
        Approximate time limit (s): no further point is begun if it is expected to end later. A reference is not begun
        if it is expected to end later than twice the limit or 20 s, whichever is longer. After a slow reference, at
        least 0.4 times the limit remains for the points.
    number, total
        Index of this curve (from 0), and total number of curves, for progress records.

    Yields
    ------
    CurveProgress
        Progress with the curve so far, which remains valid if the measurement is stopped.

    Raises
    ------
    InputError
        If ``seconds`` is not above 0.

    Examples
    --------
    >>> from lfcal.accuracy import AccuracyPart, CostPoint, Subject, Truth, iter_measure_curve
    >>> from lfcal.camera import ScanPlan, preset
    >>> def averaging(subject, seconds):
    ...     yield Truth("the mean of all frames")
    ...     for n in (1, 4):
    ...         yield CostPoint(f"mean of {n}", {}, 0.08 / n**0.5, n, "frames")
    >>> part = AccuracyPart("averaging", "Frames averaged", "noise over the signal", "frames", "frames", averaging)
    >>> subject = Subject("bench", ScanPlan.for_camera(preset("bench"), virtual_depths=[3], cutout=63))
    >>> for step in iter_measure_curve(part, subject):
    ...     print(step.note or "end", [point.error for point in step.curve.points])
    Frames averaged []
    Frames averaged: reference []
    Frames averaged: mean of 1 [0.08]
    Frames averaged: mean of 4 [0.08, 0.04]
    end [0.08, 0.04]
    """
    check_number("time for each measurement (s)", seconds, above=0)
    run = _Run(Curve(part.name, part.title, part.error, part.cost, part.unit), seconds, number, total)
    yield run.record(part.title)
    try:
        yield from _followed(part.measure(subject, seconds), run)
    except LfcalError as error:
        run.curve = replace(run.curve, stopped=str(error))
    yield replace(run.record(), done=number + 1)
    return run.curve


measure_curve = drained(
    iter_measure_curve,
    """
    Examples
    --------
    >>> from lfcal.accuracy import AccuracyPart, CostPoint, AccuracyStep, Subject, Truth, measure_curve
    >>> from lfcal.camera import ScanPlan, preset
    >>> def averaging(subject, seconds):
    ...     yield Truth("the mean of all frames")
    ...     for n in (1, 4, 16):
    ...         yield AccuracyStep(f"mean of {n}")
    ...         yield CostPoint(f"mean of {n}", {}, 0.08 / n**0.5, n, "frames")
    >>> part = AccuracyPart("averaging", "Frames averaged", "noise over the signal", "frames", "frames", averaging)
    >>> subject = Subject("bench", ScanPlan.for_camera(preset("bench"), virtual_depths=[3], cutout=63))
    >>> print(measure_curve(part, subject).answer(0.05))
    An error of 5 % costs 4 frames: mean of 4 (4 %)
    """,
)


def _followed(measuring: Measuring, run: _Run) -> Work[None]:
    """Process results of ``measuring`` until it ends or the time limit is reached."""
    try:
        for found in measuring:
            note = run.take(found)
            if reason := run.too_long(found):
                run.curve = replace(run.curve, stopped=reason)
                return
            yield run.record(note)
    finally:
        measuring.close()
