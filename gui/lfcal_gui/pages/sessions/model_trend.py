"""Quality reports of several sessions over time: reading, table rows, and curves. No Qt."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, format_dates, format_number, format_slope

if TYPE_CHECKING:
    from lfcal.judge import Course, CoursePoint, Trend

TREND_COLUMNS = ("Check", "Before", "Newest", "Per month", "Change")

F8 = NDArray[np.float64]
UNITS = (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0), ("seconds", 1.0))
"""Units of time with their lengths in seconds, longest first."""


@dataclass(frozen=True, eq=False)
class TrendCurve:
    """A metric over time: times since the first session in a unit, values, and the limits of good and bad."""

    label: str
    times: F8
    values: F8
    good: float
    bad: float
    unit: str = "days"


def trend_of(folders: Sequence[Path]) -> Trend:
    """Read the quality reports in these folders; raise `LfcalError` if there are fewer than two to compare."""
    from lfcal.judge import inspections_in, labels_of, read_inspection, trend

    places = [place for folder in folders for place in inspections_in(folder)]
    if len(places) < 2:
        raise InputError.expected(
            "quality reports in the gallery",
            "two or more",
            len(places),
            "open each H and choose Write report in H > Checks",
        )
    return trend([read_inspection(place, label) for place, label in zip(places, labels_of(places), strict=True)])


def courses_of(found: Trend) -> tuple[Course, ...]:
    """Return the curves over time to show: faults, then metrics, with those that got worse first."""
    return tuple(one for one in found.courses if any(one.points))


def rows_of(found: Trend) -> list[tuple[str, ...]]:
    """Return the rows of the table."""
    rows: list[tuple[str, ...]] = []
    for one in courses_of(found):
        known = [value for value in one.points[:-1] if value is not None]
        change = "worse" if one.worse else "better" if one.better else ""
        rows.append(
            (_title(one), _value_text(known[-1] if known else None), _value_text(one.newest), _slope(one), change)
        )
    return rows


def _title(course: Course) -> str:
    return f"{course.title} ({course.unit})" if course.unit else course.title


def _slope(course: Course) -> str:
    """Return the slope as text; empty if no value changed."""
    known = {value.value for value in course.points if value is not None}
    return format_slope(course.per_month, course.span_s) if len(known) > 1 else ""


def _value_text(value: CoursePoint | None) -> str:
    if value is None:
        return "–"
    return f"{format_number(value.value)} {value.merit}" if math.isfinite(value.value) else value.merit


def merits_of(found: Trend) -> list[str]:
    """Return the merit of the newest value in each row, for its colour."""
    return ["unknown" if one.newest is None else one.newest.merit for one in courses_of(found)]


def trend_words(found: Trend) -> tuple[str, str]:
    """Return two texts: what got worse, and which sessions were compared, with notes on them."""
    from lfcal.judge import TOO_SHORT

    names = ", ".join(one.title for one in found.worse)
    first, newest = found.sessions[0], found.sessions[-1]
    about = f"{len(found.sessions)} sessions, {format_dates(first.when, newest.when)}"
    newest_words = f"{newest.label}: {newest.verdict}"
    words = f"Worse than before: {names}." if names else "Nothing got worse."
    notes = (f"{note[:1].upper()}{note[1:]}" if note == TOO_SHORT else note for note in found.notes)
    return words, ". ".join(part.rstrip(".") for part in (about, newest_words, *notes)) + "."


def curve_of(found: Trend, row: int) -> TrendCurve:
    """Return the curve of a row over the sessions in which it is known."""
    one = courses_of(found)[row]
    start = found.sessions[0].when
    times = [(session.when - start).total_seconds() for session in found.sessions]
    unit, length = next((one for one in UNITS if max(times) >= one[1]), UNITS[-1])
    known = [(time / length, value.value) for time, value in zip(times, one.points, strict=True) if value is not None]
    x, y = np.array(known, np.float64).T
    return TrendCurve(_title(one), x, y, float(one.good), float(one.bad), unit)
