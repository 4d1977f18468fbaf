"""Quality over sessions: what got worse, since when, and which faults are new."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import COLOURS, LINES, FileFormatError, InputError, figure, parse_json, read_text, save_figure
from lfcal.judge.quality.metric import Merit
from lfcal.judge.quality.report import QualityReport

__all__ = [
    "SHORTEST_S",
    "TOO_SHORT",
    "Course",
    "Judged",
    "QualityTrend",
    "draw_quality_trend",
    "judged_of",
    "months_since_first",
    "panels_over_time",
    "quality_trend",
    "read_judged",
]

FORMAT, NAME = "lfcal-quality", "quality.json"
MONTH_S = 365.25 / 12 * 86400.0
SHORTEST_S = 7 * 86400.0
"""Span of values from which a change per month is told: from less, their noise would be made more than four times
as large."""

TOO_SHORT = "no change per month is told from less than a week: a month is more than four times as long"

WORSE: dict[str, int] = {"good": 0, "fair": 1, "bad": 2}
"""Merits from the best to the worst; an unknown one is neither."""

COLUMNS, MOST_PANELS = 3, 18


@dataclass(frozen=True, slots=True)
class Value:
    """A metric in one session; NaN where it is not known."""

    value: float
    merit: Merit


@dataclass(frozen=True, slots=True)
class Scale:
    """What a metric's values are: title, unit, where they are good and bad."""

    title: str
    unit: str
    good: float
    bad: float


@dataclass(frozen=True, eq=False)
class Judged:
    """One inspection among others.

    Attributes
    ----------
    label, when, dated
        What it is called, when it was inspected (UTC), and whether that is said or is the file's own time.
    verdict
        In a sentence.
    values, scales
        Of each metric by its key.
    faults
        Share of the light of each fault by its title; None: nothing was compared with a camera.
    period
        Positions ``(ny, nx)`` of H; None where it is not said.
    """

    label: str
    when: datetime
    dated: bool
    verdict: str
    values: Mapping[str, Value]
    scales: Mapping[str, Scale]
    faults: Mapping[str, float] | None
    period: tuple[int, int] | None = None


@dataclass(frozen=True, eq=False)
class Course:
    """A metric, or a fault's share of the light, over sessions.

    Attributes
    ----------
    key, scale
        Which one; the key of a fault is its title.
    values
        In each session, the oldest first; None where it is not known.
    span_s
        Time from the first known value to the last (s); NaN where fewer than two are.
    per_month
        Slope of the line through the known values; NaN where they are fewer than two, or lie within `SHORTEST_S`.
    worse, better
        Whether the newest merit is another than that of the last one before that is known.
    """

    key: str
    scale: Scale
    values: tuple[Value | None, ...]
    span_s: float
    per_month: float
    worse: bool
    better: bool

    @property
    def newest(self) -> Value | None:
        """The newest value, None where it is not known."""
        return self.values[-1]

    @property
    def notable(self) -> bool:
        """Whether it is anything but good in any session."""
        return any(one is not None and one.merit != "good" for one in self.values)


@dataclass(frozen=True, eq=False)
class QualityTrend:
    """All metrics and faults over sessions.

    Attributes
    ----------
    sessions
        The oldest first.
    metrics, faults
        What got worse first, then what is worst now.
    notes
        What the numbers do not say.
    """

    sessions: tuple[Judged, ...]
    metrics: tuple[Course, ...]
    faults: tuple[Course, ...]
    notes: tuple[str, ...]

    @property
    def worse(self) -> tuple[Course, ...]:
        """What got worse with the newest session."""
        return tuple(one for one in (*self.faults, *self.metrics) if one.worse)

    def to_dict(self) -> dict[str, object]:
        """Return everything as plain values."""

        def rows(courses: Sequence[Course]) -> list[dict[str, object]]:
            return [
                {
                    "key": one.key,
                    "title": one.scale.title,
                    "unit": one.scale.unit,
                    "values": [None if v is None else v.value for v in one.values],
                    "merits": ["unknown" if v is None else v.merit for v in one.values],
                    "span_s": one.span_s,
                    "per_month": one.per_month,
                    "worse": one.worse,
                    "better": one.better,
                }
                for one in courses
            ]

        return {
            "format": "lfcal-quality-trend",
            "version": 1,
            "sessions": [
                {"label": one.label, "when": one.when.isoformat(), "dated": one.dated, "verdict": one.verdict}
                for one in self.sessions
            ],
            "metrics": rows(self.metrics),
            "faults": rows(self.faults),
            "worse": [one.key for one in self.worse],
            "notes": list(self.notes),
        }


# -- reading -----------------------------------------------------------------------------------------------
def read_judged(path: str | os.PathLike[str], label: str) -> Judged:
    """Return what ``lfcal inspect`` wrote: a report's folder or its quality.json, or what ``--json`` printed.

    Raises
    ------
    FileFormatError
        If it is none, or damaged.
    StorageError
        If it cannot be read.
    """
    place = Path(path) / NAME if Path(path).is_dir() else Path(path)
    data = parse_json(read_text(place), str(place), remedy="inspect H again")
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise FileFormatError.expected(str(place), "what lfcal inspect writes", "something else", "name its report")
    try:
        said = data.get("inspected")
        when = datetime.fromisoformat(said) if isinstance(said, str) else None
        own = datetime.fromtimestamp(place.stat().st_mtime, UTC)
        model = data.get("model")
        faults = None
        if isinstance(model, Mapping) and model["compared"]:
            faults = {str(one["title"]): float(one["share"]) for one in model["faults"]}
        return _judged(label, own if when is None else when, when is not None, data, faults)
    except (KeyError, TypeError, ValueError):
        remedy = "inspect H again"
        raise FileFormatError.expected(str(place), "what lfcal inspect writes", "a damaged file", remedy) from None


def judged_of(report: QualityReport, label: str, when: datetime) -> Judged:
    """Return an inspection that was just made of a file that is as old as ``when``."""
    return _judged(label, when, False, report.to_dict(), None)


def _judged(
    label: str, when: datetime, dated: bool, data: Mapping[str, Any], faults: dict[str, float] | None
) -> Judged:
    values, scales = {}, {}
    for one in data["metrics"]:
        key = str(one["key"])
        value = math.nan if one["value"] is None else float(one["value"])
        merit: Merit = one["merit"]
        if merit not in (*WORSE, "unknown"):
            raise ValueError(merit)
        values[key] = Value(value, merit)
        scales[key] = Scale(str(one["title"]), str(one["unit"]), float(one["good"]), float(one["bad"]))
    when = when if when.tzinfo is not None else when.replace(tzinfo=UTC)
    shape = data.get("shape")
    period = (int(shape[1]), int(shape[2])) if isinstance(shape, list | tuple) and len(shape) == 5 else None
    return Judged(label, when.astimezone(UTC), dated, str(data["verdict"]), values, scales, faults, period)


# -- over time ---------------------------------------------------------------------------------------------
def quality_trend(sessions: Sequence[Judged], fair: float = 0.01, bad: float = 0.05) -> QualityTrend:
    """Return how metrics and faults changed from session to session.

    Parameters
    ----------
    sessions
        Two or more inspections, in any order.
    fair, bad
        Share of the light from which on a fault is fair, and bad.

    Raises
    ------
    InputError
        If there are fewer than two.
    """
    if len(sessions) < 2:
        raise InputError.expected("inspections", "two or more", len(sessions), "name those of several days")
    ordered = tuple(sorted(sessions, key=lambda one: one.when))
    keys = dict.fromkeys(key for one in reversed(ordered) for key in one.values)
    metrics = []
    for key in keys:
        scale = next(one.scales[key] for one in reversed(ordered) if key in one.scales)
        known = [one.values.get(key) for one in ordered]
        metrics.append(_course(key, scale, [v if v and v.merit != "unknown" else None for v in known], ordered))
    titles = dict.fromkeys(title for one in reversed(ordered) for title in one.faults or ())
    faults = []
    for title in titles:
        shares = [None if one.faults is None else one.faults.get(title, 0.0) for one in ordered]
        told = [None if share is None else Value(100 * share, _merit(share, fair, bad)) for share in shares]
        faults.append(_course(title, Scale(title, "% of the light", 100 * fair, 100 * bad), told, ordered))
    notes = []
    undated = [one.label for one in ordered if not one.dated]
    if undated:
        notes.append(f"{', '.join(undated)}: no date; the file's own time is taken")
    bare = [one.label for one in ordered if one.faults is None]
    if bare:
        notes.append(f"{', '.join(bare)}: not compared with a camera; faults are not known")
    notes += _of_another_array(ordered) + _at_one_time(ordered)
    if any(one.span_s < SHORTEST_S for one in (*metrics, *faults)):
        notes.append(TOO_SHORT)
    return QualityTrend(ordered, _ranked(metrics), _ranked(faults), tuple(notes))


def _of_another_array(sessions: Sequence[Judged]) -> list[str]:
    """Return what is to be said of H whose period is not that of the newest."""
    newest = sessions[-1].period
    return [
        f"{one.label}: a period of {one.period[0]} × {one.period[1]} positions, the newest's has "
        f"{newest[0]} × {newest[1]}: another camera or array, whose values may not be held against it"
        for one in sessions
        if one.period is not None and newest is not None and one.period != newest
    ]


def _at_one_time(sessions: Sequence[Judged]) -> list[str]:
    return [
        f"{one.label} and {other.label} are of the same time: which of them is newer is not known"
        for one, other in pairwise(sessions)
        if one.when == other.when
    ]


def _merit(share: float, fair: float, bad: float) -> Merit:
    return "bad" if share >= bad else "fair" if share >= fair else "good"


def _ranked(courses: list[Course]) -> tuple[Course, ...]:
    def rank(one: Course) -> tuple[bool, int, bool]:
        newest = one.newest
        return not one.worse, -1 if newest is None else -WORSE[newest.merit], not one.notable

    return tuple(sorted(courses, key=rank))


def _course(key: str, scale: Scale, values: Sequence[Value | None], sessions: Sequence[Judged]) -> Course:
    known = [(one.when, v) for one, v in zip(sessions, values, strict=True) if v is not None and math.isfinite(v.value)]
    slope = span = math.nan
    if len(known) > 1:
        span = (known[-1][0] - known[0][0]).total_seconds()
    if span >= SHORTEST_S:
        months = months_since_first([when for when, _ in known])
        slope = float(np.polyfit(months, [v.value for _, v in known], 1)[0])
        # what rounding leaves of values that are the same
        slope = slope if abs(slope) > 1e-9 * max(abs(v.value) for _, v in known) else 0.0
    earlier = [v for v in values[:-1] if v is not None]
    newest = values[-1]
    step = 0
    if newest is not None and earlier:
        step = WORSE[newest.merit] - WORSE[earlier[-1].merit]
    return Course(key, scale, tuple(values), span, slope, step > 0, step < 0)


def draw_quality_trend(found: QualityTrend, path: str | os.PathLike[str]) -> None:
    """Draw what is not good throughout over time, with the limits of good and bad; else what comes first."""
    shown = [one for one in (*found.faults, *found.metrics) if one.notable]
    shown = (shown or [one for one in found.metrics if one.newest is not None])[:MOST_PANELS]
    when = [one.when for one in found.sessions]
    with panels_over_time(len(shown), path) as panels:
        for panel, course in zip(panels, shown, strict=True):
            known = [(t, v) for t, v in zip(when, course.values, strict=True) if v is not None]
            panel.plot([t for t, _ in known], [v.value for _, v in known], "-", color=LINES[0], lw=0.8)
            for t, v in known:
                panel.plot(t, v.value, "o", color=COLOURS[v.merit], ms=4)
            for limit, name in ((course.scale.good, "good"), (course.scale.bad, "bad")):
                panel.axhline(limit, color=COLOURS[name], lw=0.7, ls="--")
            panel.set_title(course.scale.title + (": worse" if course.worse else ""))
            panel.set_ylabel(course.scale.unit)


@contextmanager
def panels_over_time(count: int, path: str | os.PathLike[str]) -> Iterator[list[Any]]:
    """Yield ``count`` panels whose x axis is time, and save the figure of them."""
    rows = max(1, math.ceil(count / COLUMNS))
    with figure(3.4 * COLUMNS, 0.6 + 2.0 * rows) as fig:
        panels = list(np.ravel(fig.subplots(rows, COLUMNS, squeeze=False)))
        for panel in panels[:count]:
            panel.tick_params(axis="x", labelsize=7, labelrotation=30)
        for panel in panels[count:]:
            panel.set_axis_off()
        yield panels[:count]
        save_figure(fig, path)


def months_since_first(times: Sequence[datetime]) -> NDArray[np.float64]:
    """Return how long after the first of them times are (months)."""
    return np.array([(when - times[0]).total_seconds() for when in times]) / MONTH_S
