"""``lfcal trend``: compare fits of a camera over months."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from lfcal.base import InputError, format_count, format_dates, format_slope
from lfcal.cli._console import print_json, print_table, report, run_work
from lfcal.cli._options import ForceOption, JsonOption
from lfcal.tasks import check_output, open_matrix

if TYPE_CHECKING:
    from lfcal.judge import CoursePoint, DatedInspection, Trend

SIGMAS = 5.0
"""Default number of standard deviations above which a change of a parameter is reported."""

SHOWN = 5
"""Largest number of sessions in the table, the newest ones."""


def command(
    fits: list[Path] = typer.Argument(
        metavar="FIT...",
        help="Folders that `lfcal fit` wrote, in any order, or a folder that contains them; with --quality: "
        "inspections.",
    ),
    *,
    out: Path | None = typer.Option(
        None, "--out", "-o", help="File for a plot of every parameter over time (.png, .svg)."
    ),
    sigmas: float = typer.Option(
        SIGMAS,
        "--sigmas",
        help="Number of standard deviations above which a change of a parameter is reported.",
    ),
    quality: bool = typer.Option(
        False,
        "--quality",
        help="Compare inspections instead: report folders of `lfcal inspect`, their quality.json, or H files to "
        "inspect.",
    ),
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Compare fits of one camera: which parameters have changed, how fast, and which have jumped.

    With --quality, compare inspections: which checks got worse, and which faults are new.

    Exit code 0: nothing has changed or got worse; 1: something has changed or got worse; 2: the inputs cannot be
    compared.

    Example: `lfcal trend fits/ -o trend.png`, `lfcal trend --quality reports/`
    """
    if quality and sigmas != SIGMAS:
        raise InputError.expected("--sigmas", "fits", "inspections (--quality)", "leave --sigmas out")
    from lfcal.judge import draw_trend, fits_in, inspections_in, labels_of, read_dated_fit, trend

    find = inspections_in if quality else fits_in
    places = list(dict.fromkeys(found.resolve() for path in fits for found in find(path)))
    if out is not None:
        read = places if quality else [one / name for one in places for name in ("fit.json", "camera.json")]
        check_output(out, *read, force=force)
    named = list(zip(places, labels_of(places), strict=True))
    if quality:
        found = trend([_inspection(place, label) for place, label in named])
    else:
        found = trend([read_dated_fit(place, label) for place, label in named], sigmas)
    if out is not None:
        draw_trend(found, out)
    if json:
        print_json(found.to_dict())
    else:
        (_show_inspections if quality else _show_fits)(found)
        for note in found.notes:
            report(f"note: {note}")
        if out is not None:
            typer.echo(str(out))
    if found.worse:
        raise typer.Exit(1)


def _inspection(place: Path, label: str) -> DatedInspection:
    """Return the inspection stored in a JSON file; for an H file, measure its metrics now."""
    from lfcal.judge import inspection_of, iter_inspect, read_inspection

    if place.suffix.lower() == ".json":
        return read_inspection(place, label)
    with open_matrix(place) as opened:
        measured = run_work(iter_inspect(opened.T if opened.is_transposed else opened), quiet=True)
    return inspection_of(measured, label, datetime.fromtimestamp(place.stat().st_mtime, UTC))


def _show_inspections(found: Trend) -> None:
    first, newest = found.sessions[0], found.sessions[-1]
    rows = [
        [
            one.title,
            *map(_value_words, one.points[-SHOWN:]),
            one.unit,
            format_slope(one.per_month, one.span_s),
            "worse" if one.worse else "better" if one.better else "",
        ]
        for one in found.courses
        if one.notable
    ]
    header = ["what", *(one.label for one in found.sessions[-SHOWN:]), "unit", "per month", ""]
    print_table(header, rows, title=f"{len(found.sessions)} sessions, {format_dates(first.when, newest.when)}")
    rest = sum(not one.notable and one.newest is not None for one in found.courses if one.group == "metric")
    typer.echo(f"{format_count(rest, 'check was', 'checks were')} good in all sessions")
    typer.echo(f"{newest.label}: {newest.verdict}")
    _show_worse("worse than before", [one.title for one in found.worse], "nothing got worse")


def _value_words(value: CoursePoint | None) -> str:
    if value is None:
        return "–"
    return f"{value.value:.3g} {value.merit}" if math.isfinite(value.value) else value.merit


def _show_fits(found: Trend) -> None:
    rows = []
    for one in found.courses:
        last = next(point for point in reversed(one.points) if point is not None)
        known = not math.isnan(one.change)
        rows.append(
            [
                one.name,
                f"{last.value:.6g} ± {last.sigma:.2g}",
                f"{one.change:+.3g}" if known else "",
                f"{one.change_sigmas:+.1f}" if known else "",
                format_slope(one.per_month, one.span_s, one.per_month_sigma),
                one.unit,
                "moved" if one.worse else "",
            ]
        )
    first, newest = found.sessions[0], found.sessions[-1]
    title = f"{found.to_dict()['camera']}: {len(found.sessions)} fits, {format_dates(first.when, newest.when)}"
    print_table(["parameter", "newest", "change", "sigmas", "per month", "unit", ""], rows, title=title)
    for one in found.worse:
        for jump in one.jumps:
            by = f"{jump.change:+.3g} {one.unit}".strip()
            typer.echo(f"  {one.name}: {by} from {jump.before} to {jump.after}, {abs(jump.sigmas):.1f} sigma")
    _show_worse("moved", [one.name for one in found.worse], "no parameter has changed")


def _show_worse(what: str, names: list[str], nothing: str) -> None:
    colour = typer.colors.RED if names else typer.colors.GREEN
    typer.secho(f"{what}: {', '.join(names)}" if names else nothing, fg=colour, bold=True)
