"""``lfcal reduce``: H file to a smaller one, within a tolerance."""

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

RATE = 50e6
"""Bytes of H that are read, rounded and written in a second of processor time, about."""


def register(app: typer.Typer) -> None:
    """Add ``reduce`` to the app."""
    app.command("reduce")(command)


def command(
    source: MatrixArgument,
    *,
    out: Path = typer.Option(..., "--out", "-o", help="H file to write (.h5)."),
    tolerance: float = typer.Option(0.005, "--tolerance", help="Share (L1) of itself that every pattern may lack."),
    mat_order: MatOrderOption = "",
    compression: CompressionOption = "gzip",
    workers: WorkersOption = None,
    executor: ExecutorOption = "",
    scheduler: SchedulerOption = "",
    resume: ResumeOption = False,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Store H in a fraction of its bytes, each pattern within a tolerance that the file states as its bound.

    Example: `lfcal reduce H.h5 -o small.h5 --tolerance 0.005`
    """
    import time

    from lfcal.base import format_bytes, format_seconds
    from lfcal.cli._console import print_json, run_work
    from lfcal.cli._runs import may_replace, run_choice, run_kept
    from lfcal.psf import check_store_tolerance, iter_save, open_psf
    from lfcal.tasks import check_mat_files, check_output, open_matrix, report_missing, report_regions

    check_store_tolerance(tolerance)
    check_output(out, source, force=may_replace(out, resume=resume, force=force))
    start = time.perf_counter()
    check_mat_files(mat_order, source)
    with open_matrix(source, mat_order=mat_order) as matrix:
        report_regions(source, matrix, "written")
        report_missing(matrix)
        run = run_choice(out, executor, scheduler, workers, resume=resume, force=force, seconds=matrix.nbytes / RATE)
        work = iter_save(matrix, out, compression=compression, workers=workers, store_tolerance=tolerance, run=run)
        run_work(work, quiet=json) if run is None else run_kept(work, out, quiet=json)
        shape, before = matrix.shape, source.stat().st_size
    seconds = time.perf_counter() - start
    with open_psf(out) as made:
        bound = made.facts.known()["bound"]
    nbytes = out.stat().st_size
    if json:
        print_json(
            {
                "out": out,
                "shape": shape,
                "tolerance": tolerance,
                "bound": bound,
                "bytes": nbytes,
                "source_bytes": before,
                "seconds": seconds,
            }
        )
        return
    entries = 8 * nbytes / made.size
    typer.echo(
        f"{out}: H {shape}, {format_bytes(before)} to {format_bytes(nbytes)} ({entries:.1f} bits an entry) in "
        f"{format_seconds(seconds)}; no pattern lacks more than {100 * bound[:, 2].max():.3g} %"
    )
