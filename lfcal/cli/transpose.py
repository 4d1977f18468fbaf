"""``lfcal transpose``: H file to HT file."""

from __future__ import annotations

from pathlib import Path

import typer

from lfcal.cli.options import CompressionOption, ForceOption, JsonOption, MatrixArgument, WorkersOption


def register(app: typer.Typer) -> None:
    """Add ``transpose`` to the app."""
    app.command("transpose")(command)


def command(
    source: MatrixArgument,
    *,
    out: Path = typer.Option(..., "--out", "-o", help="HT file to write (.h5)."),
    method: str = typer.Option("exact", help="'exact', or 'paper' for the published loop with its unwritten border."),
    compression: CompressionOption = "gzip",
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Transpose H into HT, file to file, with one plane of each in memory.

    Example: `lfcal transpose H.h5 -o HT.h5`
    """
    import time

    from lfcal.cli.console import print_json, report_dark, run_work
    from lfcal.cli.outputs import check_output
    from lfcal.psf.opening import open_psf
    from lfcal.psf.transpose_file import iter_transpose_file
    from lfcal.units import format_bytes, format_seconds

    check_output(out, source, force=force)
    start = time.perf_counter()
    with open_psf(source) as matrix:
        dark = report_dark(matrix)
        # File to file by planes: H may be far larger than the memory.
        run_work(iter_transpose_file(matrix, out, method=method, compression=compression, workers=workers), quiet=json)
        shape, nbytes = matrix.shape, matrix.nbytes
    seconds = time.perf_counter() - start
    if json:
        print_json({"out": out, "shape": shape, "bytes": nbytes, "seconds": seconds, "method": method, "dark": dark})
    else:
        typer.echo(f"{out}: HT {shape}, {format_bytes(nbytes)} transposed ({method}) in {format_seconds(seconds)}")
