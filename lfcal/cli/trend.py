"""``lfcal trend``: fits of a camera over months."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from lfcal.base import InputError
from lfcal.cli._options import ForceOption, JsonOption

if TYPE_CHECKING:
    from lfcal.judge import Course, CoursePoint, DatedInspection, Trend

SIGMAS = 5.0
"""Standard deviations beyond which a parameter has moved."""


SHOWN = 5
"""Sessions whose values stand in the table, the newest of them."""


def _trend_of_inspections(paths: Sequence[Path], out: Path | None, *, force: bool) -> Trend:
    from lfcal.judge import inspections_in, labels_of, trend
    from lfcal.tasks import check_output

    places = list(dict.fromkeys(found.resolve() for path in paths for found in inspections_in(path)))
    if out is not None:
        check_output(out, *places, force=force)
    return trend([_inspection(place, label) for place, label in zip(places, labels_of(places), strict=True)])


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


def _show_inspections(found: Trend, out: Path | None) -> None:
    from lfcal.base import format_dates, format_slope
    from lfcal.cli._console import print_table

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
    _show_rest(found, ("worse than before", [one.title for one in found.worse], "nothing got worse"), out)


def _show_rest(found: Trend, worse: tuple[str, list[str], str], out: Path | None) -> None:
    """Print what is ``worse``, by its name in messages, or that nothing is; then notes and the picture."""
    from lfcal.cli._console import report

    what, names, nothing = worse
    colour = typer.colors.RED if names else typer.colors.GREEN
    typer.secho(f"{what}: {', '.join(names)}" if names else nothing, fg=colour, bold=True)
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


def command(
    fits: list[Path] = typer.Argument(
        metavar="FIT...",
        help="Folders that lfcal fit wrote, in any order, or a folder that holds them; with --quality, inspections.",
    ),
    *,
    out: Path | None = typer.Option(None, "--out", "-o", help="Picture of every parameter over time (.png, .svg)."),
    sigmas: float = typer.Option(
        SIGMAS,
        "--sigmas",
        help="A parameter has moved that changed by more standard deviations of both values than this.",
    ),
    quality: bool = typer.Option(
        False,
        "--quality",
        help="Hold inspections side by side: reports of lfcal inspect, their quality.json, or H files to be measured.",
    ),
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Hold fits of one camera side by side: what has moved, how fast, and what has jumped.

    With --quality, inspections: which metrics got worse, and which faults are new.

    Exit code 0: nothing has moved, or got worse; 1: something has; 2: these cannot be compared.

    Example: `lfcal trend fits/ -o trend.png`, `lfcal trend --quality reports/`
    """
    if quality and sigmas != SIGMAS:
        raise InputError.expected("--sigmas", "fits", "inspections (--quality)", "leave it out")
    from lfcal.cli._console import print_json
    from lfcal.judge import draw_trend

    found = _trend_of_inspections(fits, out, force=force) if quality else _trend_of_fits(fits, out, sigmas, force=force)
    if out is not None:
        draw_trend(found, out)
    if json:
        print_json(found.to_dict())
    else:
        (_show_inspections if quality else _show_fits)(found, out)
    if found.worse:
        raise typer.Exit(1)


def _trend_of_fits(paths: Sequence[Path], out: Path | None, sigmas: float, *, force: bool) -> Trend:
    from lfcal.judge import fits_in, read_dated_fit, trend
    from lfcal.tasks import check_output

    folders = list(dict.fromkeys(found.resolve() for path in paths for found in fits_in(path)))
    if out is not None:
        check_output(out, *(one / name for one in folders for name in ("fit.json", "camera.json")), force=force)
    # of 2026-05/fit and 2026-06/fit the name alone says nothing
    alike = len({one.name for one in folders}) < len(folders)
    return trend(
        [read_dated_fit(one, f"{one.parent.name}/{one.name}" if alike else one.name) for one in folders], sigmas
    )


def _show_fits(found: Trend, out: Path | None) -> None:
    from lfcal.base import format_dates, format_slope
    from lfcal.cli._console import print_table

    rows = []
    for one in found.courses:
        last = next(point for point in reversed(one.points) if point is not None)
        known = one.change == one.change
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
    _show_rest(found, ("moved", [one.name for one in found.worse], "nothing has moved"), out)
