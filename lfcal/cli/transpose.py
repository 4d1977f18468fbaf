"""``lfcal transpose``: H file to HT file."""

from __future__ import annotations

from pathlib import Path

import typer

from lfcal.cli._options import (
    CompressionOption,
    ExecutorOption,
    ForceOption,
    JsonOption,
    MatOrderOption,
    MatrixArgument,
    ResumeOption,
    SchedulerOption,
    WorkersOption,
)

RATE = 150e6
"""Bytes of H that are read, transposed and written in a second of processor time, about."""


def register(app: typer.Typer) -> None:
    """Add ``transpose`` to the app."""
    app.command("transpose")(command)


def command(
    source: MatrixArgument,
    *,
    out: Path = typer.Option(..., "--out", "-o", help="HT file to write (.h5)."),
    method: str = typer.Option("exact", help="'exact', or 'paper' for the published loop with its unwritten border."),
    mat_order: MatOrderOption = "",
    compression: CompressionOption = "gzip",
    workers: WorkersOption = None,
    executor: ExecutorOption = "",
    scheduler: SchedulerOption = "",
    resume: ResumeOption = False,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Transpose H into HT, file to file, with one plane of each in memory.

    Example: `lfcal transpose H.h5 -o HT.h5`
    """
    import time

    from lfcal.base import format_bytes, format_seconds
    from lfcal.cli._console import print_json, report_dark, run_work
    from lfcal.cli._runs import may_replace, run_choice, run_kept
    from lfcal.psf import iter_transpose_file
    from lfcal.tasks import check_mat_files, check_output, open_matrix, report_missing, report_regions

    check_output(out, source, force=may_replace(out, resume=resume, force=force))
    start = time.perf_counter()
    check_mat_files(mat_order, source)
    with open_matrix(source, mat_order=mat_order) as matrix:
        report_regions(source, matrix, "written")
        dark, missing = report_dark(matrix), report_missing(matrix)
        # file to file by planes: H may be far larger than the memory.
        ahead = matrix.nbytes / RATE
        run = run_choice(out, executor, scheduler, workers, resume=resume, force=force, seconds=ahead)
        work = iter_transpose_file(matrix, out, method=method, compression=compression, workers=workers, run=run)
        run_work(work, quiet=json) if run is None else run_kept(work, out, quiet=json)
        shape, nbytes = matrix.shape, matrix.nbytes
        made = "H" if matrix.is_transposed and method == "exact" else "HT"
    seconds = time.perf_counter() - start
    if json:
        told = {"out": out, "shape": shape, "bytes": nbytes, "seconds": seconds, "method": method}
        print_json(told | {"dark": dark, "missing": missing})
    else:
        typer.echo(f"{out}: {made} {shape}, {format_bytes(nbytes)} transposed ({method}) in {format_seconds(seconds)}")
