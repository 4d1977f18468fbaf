"""``lfcal trend --quality``: inspections of several sessions side by side."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from lfcal.judge import Course, CoursePoint, DatedInspection, Trend

__all__ = ["tell_quality"]

SHOWN = 5
"""Sessions whose values stand in the table, the newest of them."""


def tell_quality(paths: Sequence[Path], out: Path | None, *, force: bool, json: bool) -> None:
    """Hold inspections side by side; end with exit code 1 when something got worse."""
    from lfcal.cli._console import print_json
    from lfcal.judge import draw_trend, inspections_in, labels_of, trend
    from lfcal.tasks import check_output

    places = list(dict.fromkeys(found.resolve() for path in paths for found in inspections_in(path)))
    if out is not None:
        check_output(out, *places, force=force)
    found = trend([_inspection(place, label) for place, label in zip(places, labels_of(places), strict=True)])
    if out is not None:
        draw_trend(found, out)
    if json:
        print_json(found.to_dict())
    else:
        _show(found, out)
    if found.worse:
        raise typer.Exit(1)


def _inspection(place: Path, label: str) -> DatedInspection:
    """Return what is known of a session: of an H file its metrics are measured now."""
    from lfcal.cli._console import run_work
    from lfcal.judge import inspection_of, iter_inspect, read_inspection
    from lfcal.tasks import open_matrix

    if place.suffix.lower() == ".json":
        return read_inspection(place, label)
    with open_matrix(place) as opened:
        H = opened.T if opened.is_transposed else opened
        report = run_work(iter_inspect(H), quiet=True)
    return inspection_of(report, label, datetime.fromtimestamp(place.stat().st_mtime, UTC))


def _show(found: Trend, out: Path | None) -> None:
    from lfcal.base import format_dates, format_slope
    from lfcal.cli._console import print_table, report

    shown = found.sessions[-SHOWN:]
    listed = [one for one in found.courses if one.notable]
    first, newest = found.sessions[0], found.sessions[-1]
    title = f"{len(found.sessions)} sessions, {format_dates(first.when, newest.when)}"
    rows = [
        [
            one.title,
            *map(_value_words, one.points[-SHOWN:]),
            one.unit,
            format_slope(one.per_month, one.span_s),
            _change(one),
        ]
        for one in listed
    ]
    header = ["what", *(one.label for one in shown), "unit", "per month", ""]
    print_table(header, rows, title=title)
    rest = sum(not one.notable and one.newest is not None for one in found.courses if one.group == "metric")
    typer.echo(f"{rest} metrics were good in all sessions")
    typer.echo(f"{newest.label}: {newest.verdict}")
    names = ", ".join(one.title for one in found.worse)
    colour = typer.colors.RED if found.worse else typer.colors.GREEN
    typer.secho(f"worse than before: {names}" if names else "nothing got worse", fg=colour, bold=True)
    for note in found.notes:
        report(f"note: {note}")
    if out is not None:
        typer.echo(str(out))


def _value_words(value: CoursePoint | None) -> str:
    if value is None:
        return "–"
    return f"{value.value:.3g} {value.merit}" if math.isfinite(value.value) else value.merit


def _change(course: Course) -> str:
    return "worse" if course.worse else "better" if course.better else ""
