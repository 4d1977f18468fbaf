"""``lfcal trend``: fits of a camera over months."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from lfcal.base import InputError
from lfcal.cli._options import ForceOption, JsonOption

if TYPE_CHECKING:
    from lfcal.judge import Trend

__all__ = ["register"]

SIGMAS = 5.0
"""Standard deviations beyond which a parameter has moved."""


def register(app: typer.Typer) -> None:
    """Add ``trend`` to the app."""
    app.command("trend")(command)


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
    from lfcal.base import plain
    from lfcal.cli._console import print_json
    from lfcal.cli.outputs import check_output
    from lfcal.judge import draw_trend, fits_in, read_dated, trend

    folders = list(dict.fromkeys(found.resolve() for path in fits for found in fits_in(path)))
    if out is not None:
        check_output(out, *(one / name for one in folders for name in ("fit.json", "camera.json")), force=force)
    # of 2026-05/fit and 2026-06/fit the name alone says nothing
    alike = len({one.name for one in folders}) < len(folders)
    found = trend([read_dated(one, f"{one.parent.name}/{one.name}" if alike else one.name) for one in folders], sigmas)
    if out is not None:
        draw_trend(found, out)
    if json:
        dates = [{"fit": one.label, "when": one.when.isoformat(), "complete": one.complete} for one in found.fits]
        drifts = [
            plain(one) | {"points": [plain(point) | {"when": point.when.isoformat()} for point in one.points]}
            for one in found.drifts
        ]
        print_json(
            {
                "format": "lfcal-trend",
                "version": 1,
                "camera": found.fits[-1].camera.name,
                "sigmas": sigmas,
                "fits": dates,
                "parameters": drifts,
                "moved": [one.name for one in found.moved],
                "notes": found.notes,
            }
        )
    else:
        _show(found, out)
    if found.moved:
        raise typer.Exit(1)


def _show(found: Trend, out: Path | None) -> None:
    from lfcal.base import format_dates, format_slope
    from lfcal.cli._console import print_table, report

    rows = []
    for one in found.drifts:
        last = one.points[-1]
        told = one.change == one.change
        rows.append(
            [
                one.name,
                f"{last.value:.6g} ± {last.sigma:.2g}",
                f"{one.change:+.3g}" if told else "",
                f"{one.change_sigmas:+.1f}" if told else "",
                format_slope(one.per_month, one.span_s, one.per_month_sigma),
                one.unit,
                "moved" if one.moved else "",
            ]
        )
    first, newest = found.fits[0], found.fits[-1]
    title = f"{newest.camera.name}: {len(found.fits)} fits, {format_dates(first.when, newest.when)}"
    print_table(["parameter", "newest", "change", "sigmas", "per month", "unit", ""], rows, title=title)
    for one in found.moved:
        for jump in one.jumps:
            by = f"{jump.change:+.3g} {one.unit}".strip()
            typer.echo(f"  {one.name}: {by} from {jump.before} to {jump.after}, {abs(jump.sigmas):.1f} sigma")
    names = ", ".join(one.name for one in found.moved)
    colour = typer.colors.RED if found.moved else typer.colors.GREEN
    typer.secho(f"moved: {names}" if names else "nothing has moved", fg=colour, bold=True)
    for note in found.notes:
        report(f"note: {note}")
    if out is not None:
        typer.echo(str(out))
