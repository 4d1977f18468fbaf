"""``lfcal trend``: fits of a camera over months."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from lfcal.base import InputError
from lfcal.cli._options import ForceOption, JsonOption

if TYPE_CHECKING:
    from lfcal.judge import Trend


SIGMAS = 5.0
"""Standard deviations beyond which a parameter has moved."""


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
    if quality:
        from lfcal.cli._trend_quality import tell_quality

        tell_quality(fits, out, force=force, json=json)
        return
    from lfcal.cli._console import print_json
    from lfcal.judge import draw_trend, fits_in, read_dated_fit, trend
    from lfcal.tasks import check_output

    folders = list(dict.fromkeys(found.resolve() for path in fits for found in fits_in(path)))
    if out is not None:
        check_output(out, *(one / name for one in folders for name in ("fit.json", "camera.json")), force=force)
    # of 2026-05/fit and 2026-06/fit the name alone says nothing
    alike = len({one.name for one in folders}) < len(folders)
    fitted = [read_dated_fit(one, f"{one.parent.name}/{one.name}" if alike else one.name) for one in folders]
    found = trend(fitted, sigmas)
    if out is not None:
        draw_trend(found, out)
    if json:
        print_json(found.to_dict())
    else:
        _show(found, fitted[-1].camera.name, out)
    if found.worse:
        raise typer.Exit(1)


def _show(found: Trend, camera: str, out: Path | None) -> None:
    from lfcal.base import format_dates, format_slope
    from lfcal.cli._console import print_table, report

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
    title = f"{camera}: {len(found.sessions)} fits, {format_dates(first.when, newest.when)}"
    print_table(["parameter", "newest", "change", "sigmas", "per month", "unit", ""], rows, title=title)
    for one in found.worse:
        for jump in one.jumps:
            by = f"{jump.change:+.3g} {one.unit}".strip()
            typer.echo(f"  {one.name}: {by} from {jump.before} to {jump.after}, {abs(jump.sigmas):.1f} sigma")
    names = ", ".join(one.name for one in found.worse)
    colour = typer.colors.RED if found.worse else typer.colors.GREEN
    typer.secho(f"moved: {names}" if names else "nothing has moved", fg=colour, bold=True)
    for note in found.notes:
        report(f"note: {note}")
    if out is not None:
        typer.echo(str(out))
