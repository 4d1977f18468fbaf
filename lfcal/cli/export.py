"""``lfcal export``: H for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer


def register(app: typer.Typer) -> None:
    """Add ``export`` to the app."""
    app.command("export")(command)


def command(
    source: Path = typer.Argument(help="H file (.h5), MATLAB v7.3 file (.mat) or .npy array."),
    out: Path = typer.Option(..., "--out", "-o", help="File to write; its suffix says the format: .h5 .mat .npy .tif"),
    transposed: bool = typer.Option(False, "--transposed", help="Export HT in place of H (.h5, .npy, .tif)."),
    no_ht: bool = typer.Option(False, "--no-ht", help=".mat: leave Ht out; halves the file."),
    rows_first: bool = typer.Option(
        False, "--rows-first", help=".mat: store H(t,s,y,x,z) for codes whose images have rows first."
    ),
    uncompressed: bool = typer.Option(False, "--uncompressed", help=".mat, .h5: no compression; faster to read."),
    position: str = typer.Option("", help=".tif: only the stack over depth of one position, 'y,x'."),
    json: bool = typer.Option(False, "--json", help="Print the result as JSON."),
) -> None:
    """Export H (and Ht) for a deconvolution code.

    Example: `lfcal export H.h5 -o H.mat`
    """
    import time

    from lfcal.cli.console import print_json, report, run_work
    from lfcal.errors import InputError
    from lfcal.psf.export import iter_export
    from lfcal.psf.opening import open_psf
    from lfcal.units import format_bytes, format_seconds

    suffix = out.suffix.lower()
    options: dict[str, Any] = {}
    if suffix == ".mat":
        options = {"include_transpose": not no_ht, "rows_first": rows_first, "compress": not uncompressed}
        if transposed:
            raise InputError("--transposed: a .mat file holds both H and Ht; leave the option out")
    elif suffix == ".h5" and uncompressed:
        options = {"compression": "none"}
    elif suffix in (".tif", ".tiff") and position:
        try:
            y, x = (int(part) for part in position.split(","))
        except ValueError:
            raise InputError.expected("--position", "y,x", position, "for example --position 9,16") from None
        options = {"position": (y, x)}
    start = time.perf_counter()
    with open_psf(source) as matrix:
        if suffix == ".mat" and matrix.period[0] != matrix.period[1] and not json:
            ny, nx = matrix.period
            report(f"note: the period is {ny} x {nx}; codes that take one square period (Nnum) cannot use this H")
        written = run_work(iter_export(matrix.T if transposed else matrix, out, **options), quiet=json)
        shape = matrix.shape
    seconds = time.perf_counter() - start
    size = written.stat().st_size if written.exists() else 0
    if json:
        print_json({"out": written, "shape": shape, "file_bytes": size, "seconds": seconds})
    else:
        typer.echo(f"{written}: {shape}, {format_bytes(size)} in {format_seconds(seconds)}")
