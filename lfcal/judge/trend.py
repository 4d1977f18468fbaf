"""Trends of fits or inspections of one camera: what has changed or got worse, how fast, and sudden changes."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import COLOURS, LINES, RANK, InputError, Merit, check_number, figure, format_pixels, plain, save_figure
from lfcal.judge.dated import DatedFit, DatedInspection, MetricValue

__all__ = ["TOO_SHORT", "Course", "CoursePoint", "Jump", "Trend", "draw_trend", "trend"]

SIGMAS = 5.0
"""Standard deviations by which a parameter must have changed to count as moved."""

FAIR_SHARE, BAD_SHARE = 0.01, 0.05
"""Fractions of the light above which a fault is fair, and bad."""

MONTH_S = 365.25 / 12 * 86400.0
SHORTEST_S = 7 * 86400.0
"""Shortest span of values for a change per month (s); with less, noise would be magnified more than four times."""

TOO_SHORT = "a change per month is not estimated from less than a week of data"

AS_DISTANCE = ("gap_um", "f_number", "focal_0_um", "focal_1_um", "focal_2_um")
"""Parameters that have the same effect as a source nearer or farther away than described."""

SHIFTS = {"offset_y_um": 1, "offset_x_um": 0}
"""Parameters that are relative to the description of each fit, so that positions of the array are compared instead."""

PLANNED = ("distance", "depths")
"""Groups of unknowns that are relative to the planned depths."""

COLUMNS, MOST_PANELS = 3, 18


@dataclass(frozen=True, slots=True)
class CoursePoint:
    """A value at one time.

    Attributes
    ----------
    value, sigma
        The value and its standard deviation (NaN: unknown).
    merit
        Rating of the value; "unknown" for parameters of a camera.
    compared
        Whether the value can be compared with the newest one.
    """

    value: float
    sigma: float = math.nan
    merit: Merit = "unknown"
    compared: bool = True


@dataclass(frozen=True, slots=True)
class Jump:
    """A change between the sessions ``before`` and ``after``, and its significance in standard deviations."""

    before: str
    after: str
    change: float
    sigmas: float


@dataclass(frozen=True, eq=False)
class Course:
    """Course of one value over all sessions: a parameter of the camera, a metric of H, or the light changed by a fault.

    Attributes
    ----------
    name, title, unit
        Key, display name, and unit; the key of a fault is its title.
    points
        Value in each session, the oldest first; None where unknown.
    group
        Group of a parameter; "metric" or "fault" for the other values.
    good, bad
        Limits of a metric or a fault; NaN for a parameter.
    span_s
        Time from the first compared value to the last (s); NaN for fewer than two.
    per_month, per_month_sigma
        Slope of the line through the compared values, and its standard deviation. Both are NaN if unknown, for fewer
        than two values, or if they span less than `SHORTEST_S`.
    change, change_sigmas
        Change from the oldest to the newest compared value, absolute and in combined standard deviations; NaN if
        unknown.
    jumps
        Changes of a parameter between consecutive compared sessions that are significant (`Trend.limit`).
    worse, better
        Whether the newest rating is worse, or better, than the previous known rating. For a parameter, ``worse`` states
        whether it has changed significantly.
    """

    name: str
    title: str
    unit: str
    points: tuple[CoursePoint | None, ...]
    group: str
    good: float = math.nan
    bad: float = math.nan
    span_s: float = math.nan
    per_month: float = math.nan
    per_month_sigma: float = math.nan
    change: float = math.nan
    change_sigmas: float = math.nan
    jumps: tuple[Jump, ...] = ()
    worse: bool = False
    better: bool = False

    @property
    def newest(self) -> CoursePoint | None:
        """The value in the newest session; None if unknown."""
        return self.points[-1]

    @property
    def notable(self) -> bool:
        """Whether at least one known value is not rated "good"; True for every parameter with a known value."""
        return any(one is not None and one.merit != "good" for one in self.points)

    def to_dict(self) -> dict[str, object]:
        """Return the values, ratings and slope of a metric or a fault as plain JSON types."""
        return {
            "key": self.name,
            "title": self.title,
            "unit": self.unit,
            "values": [None if one is None else one.value for one in self.points],
            "merits": ["unknown" if one is None else one.merit for one in self.points],
            "span_s": self.span_s,
            "per_month": self.per_month,
            "worse": self.worse,
            "better": self.better,
        }


@dataclass(frozen=True, eq=False)
class Trend:
    """All values over all sessions.

    Attributes
    ----------
    sessions
        Fits or inspections, the oldest first.
    courses
        All parameters of fits; or all faults and then all metrics of inspections, each with those that got worse first.
    limit
        Number of standard deviations above which a change of a parameter is significant.
    notes
        Remarks in addition to the numbers.
    """

    sessions: tuple[DatedFit | DatedInspection, ...]
    courses: tuple[Course, ...]
    limit: float
    notes: tuple[str, ...]

    @property
    def worse(self) -> tuple[Course, ...]:
        """Parameters that have changed, or metrics and faults that got worse in the newest session."""
        return tuple(one for one in self.courses if one.worse)

    def to_dict(self) -> dict[str, object]:
        """Return the sessions, the values over time and the notes as plain JSON types."""
        newest = self.sessions[-1]
        if isinstance(newest, DatedFit):
            fits = [one for one in self.sessions if isinstance(one, DatedFit)]
            return {
                "format": "lfcal-trend",
                "version": 1,
                "camera": newest.camera.name,
                "sigmas": self.limit,
                "fits": [{"fit": one.label, "when": one.when.isoformat(), "complete": one.complete} for one in fits],
                "parameters": [_parameter(one, fits) for one in self.courses],
                "moved": [one.name for one in self.worse],
                "notes": list(self.notes),
            }
        return {
            "format": "lfcal-quality-trend",
            "version": 1,
            "sessions": [
                {"label": one.label, "when": one.when.isoformat(), "dated": one.dated, "verdict": one.verdict}
                for one in self.sessions
                if isinstance(one, DatedInspection)
            ],
            "metrics": [one.to_dict() for one in self.courses if one.group == "metric"],
            "faults": [one.to_dict() for one in self.courses if one.group == "fault"],
            "worse": [one.name for one in self.worse],
            "notes": list(self.notes),
        }


def _parameter(course: Course, fits: Sequence[DatedFit]) -> dict[str, object]:
    """Return the course of a parameter as plain values."""
    points = [
        {
            "fit": fit.label,
            "when": fit.when.isoformat(),
            "value": one.value,
            "sigma": one.sigma,
            "compared": one.compared,
        }
        for fit, one in zip(fits, course.points, strict=True)
        if one is not None
    ]
    names = ("name", "unit", "group", "span_s", "per_month", "per_month_sigma", "change", "change_sigmas")
    found = {name: getattr(course, name) for name in names}
    return found | {"points": points, "jumps": [plain(one) for one in course.jumps], "moved": course.worse}


def trend(sessions: Sequence[DatedFit | DatedInspection], sigmas: float = SIGMAS) -> Trend:
    """Return the changes of values over several sessions.

    Parameters of fits are compared only if they have the same meaning. They must be fitted with the same groups of
    unknowns as in the newest fit. If they are relative to planned depths, these must also be the same. Offsets are
    relative to the description of each fit. Therefore, the position of the array at the middle of the scanned region is
    compared instead.

    Parameters
    ----------
    sessions
        Two or more fits of one camera, or two or more inspections, in any order.
    sigmas
        Number of combined standard deviations above which the change of a parameter is significant.

    Raises
    ------
    InputError
        If there are fewer than two sessions, or both fits and inspections. Also if fits belong to several cameras or
        have the same time, or ``sigmas`` is not positive.
    """
    check_number("threshold of an alarm (standard deviations)", sigmas, above=0)
    fits = [one for one in sessions if isinstance(one, DatedFit)]
    inspections = [one for one in sessions if isinstance(one, DatedInspection)]
    if len(sessions) < 2:
        raise InputError.expected("sessions", "at least two", len(sessions), "give the sessions of several days")
    if fits and inspections:
        raise InputError.expected("sessions", "fits or inspections", "both", "compare each kind separately")
    return _trend_of_fits(fits, sigmas) if fits else _trend_of_inspections(inspections, sigmas)


# -- fits --------------------------------------------------------------------------------------------------
def _trend_of_fits(fits: Sequence[DatedFit], sigmas: float) -> Trend:
    ordered = tuple(sorted(fits, key=lambda one: one.when))
    _check_one_camera(ordered)
    newest = ordered[-1]
    names = list(dict.fromkeys(name for one in reversed(ordered) for name in one.values))
    courses = tuple(_parameter_course(name, ordered, sigmas) for name in names)
    notes = []
    other = [one.label for one in ordered if one.groups != newest.groups]
    if other:
        notes.append(
            f"{', '.join(other)}: not compared, because their unknowns differ from those of the newest fit; "
            "fit the same unknowns"
        )
    unknown = [one.label for one in ordered if one.recorded is None]
    if unknown:
        notes.append(f"{', '.join(unknown)}: no date; the time of the file is used")
    late = [one.label for one in ordered if one.recorded is False]
    if late:
        notes.append(f"{', '.join(late)}: dated by the fit, because the time of the recording is unknown")
    poor = [one.label for one in ordered if not one.complete]
    if poor:
        notes.append(f"{', '.join(poor)}: the model was incomplete; errors may exceed the stated standard deviations")
    if any(one.span_s < SHORTEST_S for one in courses):
        notes.append(TOO_SHORT)
    if "distance" not in newest.groups and any(one.worse and one.name in AS_DISTANCE for one in courses):
        notes.append(
            "the distance was fixed in these fits, but a change of the source distance has the same effect; "
            "fit it as well (add distance to --unknowns)"
        )
    return Trend(ordered, courses, sigmas, tuple(notes))


def _check_one_camera(fits: Sequence[DatedFit]) -> None:
    first = fits[0].camera
    for one in fits[1:]:
        camera = one.camera
        same = camera.name == first.name and camera.sensor.shape == first.sensor.shape
        same = same and camera.sensor.pixel_um == first.sensor.pixel_um
        if not (same and len(camera.lattice.types) == len(first.lattice.types)):
            names = " and ".join(f"{c.name} ({format_pixels(c.sensor.shape)})" for c in (first, camera))
            raise InputError.expected("fits", "fits of one camera", names, f"leave out {one.label}")
        if any(abs(one.when - other.when).total_seconds() < 1 and one is not other for other in fits):
            raise InputError.expected(
                "fits", "fits with different times", f"{one.label} with the time of another", "give each fit once"
            )


def _parameter_course(name: str, fits: Sequence[DatedFit], sigmas: float) -> Course:
    newest = fits[-1]
    last = next(one for one in reversed(fits) if name in one.values)
    points = tuple(
        CoursePoint(_value(name, one, newest), one.values[name][1], compared=_same(name, one, newest))
        if name in one.values
        else None
        for one in fits
    )
    course = Course(name, name, last.units[name], points, last.groups_of[name])
    return _followed(course, fits, sigmas)


def _same(name: str, one: DatedFit, newest: DatedFit) -> bool:
    """Return whether a value has the same meaning as in the newest fit."""
    if one.groups != newest.groups or name not in newest.values:
        return False
    return one.groups_of[name] not in PLANNED or one.depths_um == newest.depths_um


def _value(name: str, one: DatedFit, newest: DatedFit) -> float:
    """Return the value of a parameter; for an offset, the displacement of the array relative to the newest fit."""
    if name not in SHIFTS:
        return one.values[name][0]
    middle = np.array(newest.middle_um)
    there, here = newest.camera.periodic, one.camera.periodic
    q, r = np.rint(there.lenslet_at(middle))
    at = there.centres_um(q, r)
    k = np.rint(here.lenslet_at(at))
    moved: NDArray[np.float64] = here.centres_um(k[0], k[1]) - at
    return float(moved[SHIFTS[name]])


# -- inspections -------------------------------------------------------------------------------------------
def _trend_of_inspections(inspections: Sequence[DatedInspection], sigmas: float) -> Trend:
    ordered = tuple(sorted(inspections, key=lambda one: one.when))
    metrics = []
    for key in dict.fromkeys(key for one in reversed(ordered) for key in one.values):
        scale = next(one.scales[key] for one in reversed(ordered) if key in one.scales)
        points = tuple(_point(one.values.get(key)) for one in ordered)
        metrics.append(Course(key, scale.title, scale.unit, points, "metric", scale.good, scale.bad))
    faults = []
    for title in dict.fromkeys(title for one in reversed(ordered) for title in one.faults or ()):
        shares = [None if one.faults is None else one.faults.get(title, 0.0) for one in ordered]
        points = tuple(None if one is None else CoursePoint(100 * one, merit=_merit(one)) for one in shares)
        limits = (100 * FAIR_SHARE, 100 * BAD_SHARE)
        faults.append(Course(title, title, "% of the light", points, "fault", *limits))
    found = [_ranked([_followed(one, ordered, sigmas) for one in courses]) for courses in (faults, metrics)]
    notes = []
    undated = [one.label for one in ordered if not one.dated]
    if undated:
        notes.append(f"{', '.join(undated)}: no date; the time of the file is used")
    bare = [one.label for one in ordered if one.faults is None]
    if bare:
        notes.append(f"{', '.join(bare)}: not compared with a camera; faults are unknown")
    notes += _of_another_array(ordered) + _at_one_time(ordered)
    if any(one.span_s < SHORTEST_S for courses in found for one in courses):
        notes.append(TOO_SHORT)
    return Trend(ordered, (*found[0], *found[1]), sigmas, tuple(notes))


def _point(value: MetricValue | None) -> CoursePoint | None:
    return None if value is None or value.merit == "unknown" else CoursePoint(value.value, merit=value.merit)


def _of_another_array(sessions: Sequence[DatedInspection]) -> list[str]:
    """Return notes on H whose period differs from the period of the newest H."""
    newest = sessions[-1].period
    return [
        f"{one.label}: a period of {one.period[0]} × {one.period[1]} positions, but {newest[0]} × {newest[1]} "
        "in the newest session; this is another camera or array, whose values cannot be compared"
        for one in sessions
        if one.period is not None and newest is not None and one.period != newest
    ]


def _at_one_time(sessions: Sequence[DatedInspection]) -> list[str]:
    return [
        f"{one.label} and {other.label} have the same time: it is unknown which of them is newer"
        for one, other in pairwise(sessions)
        if one.when == other.when
    ]


def _merit(share: float) -> Merit:
    return "bad" if share >= BAD_SHARE else "fair" if share >= FAIR_SHARE else "good"


def _ranked(courses: list[Course]) -> tuple[Course, ...]:
    def rank(one: Course) -> tuple[bool, int, bool]:
        newest = one.newest
        return not one.worse, 3 if newest is None else RANK[newest.merit], not one.notable

    return tuple(sorted(courses, key=rank))


# -- both --------------------------------------------------------------------------------------------------
def _followed(course: Course, sessions: Sequence[DatedFit | DatedInspection], sigmas: float) -> Course:
    """Return a course with its slope, its change, and its jumps."""
    used = [
        (one.label, one.when, point)
        for one, point in zip(sessions, course.points, strict=True)
        if point is not None and point.compared and math.isfinite(point.value)
    ]
    found: dict[str, Any] = {}
    if len(used) > 1:
        first, last = used[0], used[-1]
        found["span_s"] = (last[1] - first[1]).total_seconds()
        found["change"] = last[2].value - first[2].value
        slope, error = _slope([when for _, when, _ in used], [point for _, _, point in used])
        if found["span_s"] >= SHORTEST_S:
            found |= {"per_month": slope, "per_month_sigma": error}
        if not math.isnan(first[2].sigma):
            found["change_sigmas"] = _apart(first[2], last[2])
            pairs = [(a, b, _apart(a[2], b[2])) for a, b in pairwise(used)]
            jumps = tuple(Jump(a[0], b[0], b[2].value - a[2].value, far) for a, b, far in pairs if abs(far) > sigmas)
            steady = len(used) > 2 and error > 0 and abs(slope) > sigmas * error
            found |= {"jumps": jumps, "worse": bool(jumps) or abs(found["change_sigmas"]) > sigmas or steady}
    merits = [point.merit for point in course.points[:-1] if point is not None and point.merit != "unknown"]
    if course.newest is not None and course.newest.merit != "unknown" and merits:
        step = RANK[merits[-1]] - RANK[course.newest.merit]
        found |= {"worse": step > 0, "better": step < 0}
    return Course(course.name, course.title, course.unit, course.points, course.group, course.good, course.bad, **found)


def _apart(a: CoursePoint, b: CoursePoint) -> float:
    """Return the change from one value to another in combined standard deviations."""
    spread = math.hypot(a.sigma, b.sigma)
    change = b.value - a.value
    return change / spread if spread > 0 else math.copysign(math.inf, change) if change else 0.0


def _slope(times: Sequence[datetime], points: Sequence[CoursePoint]) -> tuple[float, float]:
    """Return slope per month and its standard deviation, by weighted least squares.

    If values scatter about the line by more than their standard deviations, the standard deviation of the slope is
    increased by the same factor. Values without standard deviations have equal weights, and their slope has none.
    """
    months = np.array([(when - times[0]).total_seconds() for when in times]) / MONTH_S
    values = np.array([point.value for point in points])
    sigmas = np.array([point.sigma for point in points])
    known = bool(np.isfinite(sigmas).all())
    weight = 1.0 / np.maximum(sigmas, 1e-300) if known else np.ones(len(values))
    a = np.stack([np.ones(len(months)), months], axis=1) * weight[:, None]
    inverse = np.linalg.pinv(a.T @ a, rcond=1e-15, hermitian=True)
    found = inverse @ (a.T @ (values * weight))
    residual = float(np.square(values * weight - a @ found).sum()) / max(1, len(points) - 2)
    grown = math.sqrt(max(1.0, residual)) if len(points) > 2 else 1.0
    slope, sigma = float(found[1]), grown * math.sqrt(max(0.0, float(inverse[1, 1])))
    if not known:
        # rounding differences of equal values
        return (slope if abs(slope) > 1e-9 * float(np.abs(values).max()) else 0.0), math.nan
    return (slope if abs(slope) > 1e-9 * sigma else 0.0), sigma


def draw_trend(found: Trend, path: str | os.PathLike[str]) -> None:
    """Draw values over time to the file ``path``, with their standard deviations and limits where these are known.

    All parameters are drawn, in grey where they are not compared. Of metrics and faults, at most `MOST_PANELS` are
    drawn: those that are not always good or, if there are none, the first ones.
    """
    shown = [one for one in found.courses if one.notable or one.group not in ("metric", "fault")]
    if isinstance(found.sessions[-1], DatedInspection):
        shown = (shown or [one for one in found.courses if one.newest is not None])[:MOST_PANELS]
    times = [one.when for one in found.sessions]
    rows = max(1, math.ceil(len(shown) / COLUMNS))
    with figure(3.4 * COLUMNS, 0.6 + 2.0 * rows) as fig:
        panels = list(np.ravel(fig.subplots(rows, COLUMNS, squeeze=False)))
        for panel in panels[len(shown) :]:
            panel.set_axis_off()
        for panel, course in zip(panels, shown, strict=False):
            panel.tick_params(axis="x", labelsize=7, labelrotation=30)
            known = [(when, one) for when, one in zip(times, course.points, strict=True) if one is not None]
            _draw_course(panel, course, known)
            panel.set_ylabel(course.unit)
        save_figure(fig, path)


def _draw_course(panel: Any, course: Course, known: Sequence[tuple[datetime, CoursePoint]]) -> None:
    if course.group in ("metric", "fault"):
        panel.plot([when for when, _ in known], [one.value for _, one in known], "-", color=LINES[0], lw=0.8)
        for when, one in known:
            panel.plot(when, one.value, "o", color=COLOURS[one.merit], ms=4)
        for limit, name in ((course.good, "good"), (course.bad, "bad")):
            panel.axhline(limit, color=COLOURS[name], lw=0.7, ls="--")
        panel.set_title(course.title + (": worse" if course.worse else ""))
        return
    for compared, colour in ((False, COLOURS["muted"]), (True, COLOURS["bad"] if course.worse else LINES[0])):
        own = [(when, one) for when, one in known if one.compared is compared]
        if own:
            panel.errorbar(
                [when for when, _ in own],
                [one.value for _, one in own],
                yerr=[one.sigma for _, one in own],
                fmt="o-" if compared else "o",
                color=colour,
                markersize=3,
                linewidth=0.8,
                capsize=2,
            )
    panel.set_title(course.title + (": moved" if course.worse else ""))
