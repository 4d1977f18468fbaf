"""``lfcal compare``: compare two H."""

from __future__ import annotations

import time
from contextlib import ExitStack
from pathlib import Path

import typer

from lfcal.base import InputError
from lfcal.cli._console import print_json, print_table, run_work
from lfcal.cli._options import ForceOption, JsonOption, MatOrderOption, WorkersOption

MATRIX = "H file (.h5), another code's file (.mat v7.3, .lfc of napari-LF, .tif stack), or .npy array."


def command(
    first: Path = typer.Argument(help=MATRIX),
    second: Path = typer.Argument(help=MATRIX),
    *,
    report: Path | None = typer.Option(None, "--report", help="Folder for an HTML page with the images side by side."),
    region: list[str] | None = typer.Option(
        None,
        "--region",
        help="Name of the region to compare, for files with several regions. Give it twice to choose one region for "
        "each H.",
    ),
    by_number: bool = typer.Option(False, "--by-number", help="Match planes by their numbers, not by their depths."),
    mat_order: MatOrderOption = "",
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Compare two H: error, scale and sub-pixel shift of every plane and lens type.

    Planes are matched by their depths, positions by the sensor's pixels; cutouts are cropped to the smaller one.
    Planes and positions that only one H has are reported.

    Example: `lfcal compare may/H.h5 june/H.h5 --report compared/`
    """
    from lfcal.judge import iter_compare
    from lfcal.judge.report import (
        COLUMNS,
        compared_report_files,
        compared_words,
        figure_rows,
        iter_compared_report,
        verdict,
    )
    from lfcal.tasks import check_mat_files, check_outputs, open_matrix

    check_mat_files(mat_order, first, second)
    if report is not None:
        check_outputs(compared_report_files(report), first, second, force=force)
    page, names = None, _regions(region or [])
    with ExitStack() as files:
        pairs = zip((first, second), names, strict=True)
        a, b = (files.enter_context(open_matrix(path, region=name, mat_order=mat_order)) for path, name in pairs)
        start = time.perf_counter()
        found = run_work(iter_compare(a, b, by_number=by_number, workers=workers), quiet=json)
        seconds = time.perf_counter() - start
        if report is not None:
            page = run_work(iter_compared_report(found, report, seconds), quiet=json)
    if json:
        extra = {} if page is None else {"report": page}
        print_json(found.to_dict() | {"files": [first, second], "verdict": verdict(found)} | extra)
        return
    typer.echo(f"{compared_words(found)}")
    typer.secho(verdict(found), bold=True)
    print_table(list(COLUMNS), [list(row) for row in figure_rows(found)])
    for k, y, x in found.worst(3):
        typer.echo(f"differs most at {(found.pair.planes[k][0], y, x)}: {100 * found.error[k, y, x]:.3g} %")
    for note in found.notes:
        typer.echo(f"note: {note}")
    if page is not None:
        typer.echo(f"report: {page}")


def _regions(names: list[str]) -> tuple[str, str]:
    """Return the region of each H; empty selects the default one of the file."""
    if len(names) > 2:
        raise InputError.expected(
            "--region", "one for both H, or one for each", f"{len(names)} regions", "leave the others out"
        )
    return (names[0], names[-1]) if names else ("", "")
