"""``lfcal export``: H for other programs."""

from __future__ import annotations

import time
from pathlib import Path

import typer

from lfcal.base import InputError
from lfcal.cli._options import ForceOption, JsonOption, MatOrderOption, MatrixArgument, WorkersOption


def register(app: typer.Typer) -> None:
    """Add ``export`` to the app."""
    app.command("export")(command)


def command(
    source: MatrixArgument,
    *,
    out: Path = typer.Option(..., "--out", "-o", help="File to write; its suffix says the format: .h5 .mat .npy .tif"),
    transposed: bool = typer.Option(False, "--transposed", help="Export HT in place of H (.h5, .npy, .tif)."),
    no_ht: bool = typer.Option(False, "--no-ht", help=".mat: leave Ht out; halves the file."),
    rows_first: bool = typer.Option(
        False, "--rows-first", help=".mat: store H(t,s,y,x,z) for codes whose images have rows first."
    ),
    lens_centred: bool = typer.Option(
        False, "--lens-centred", help=".mat: a lens's centre on pixel ceil(Nnum/2), as codes after Prevedel take it."
    ),
    interpolation: str = typer.Option(
        "", help="With --lens-centred: move patterns by what whole pixels leave: linear, cubic or fourier."
    ),
    uncompressed: bool = typer.Option(False, "--uncompressed", help=".mat, .h5: no compression; faster to read."),
    allow_missing: bool = typer.Option(
        False,
        "--allow-missing",
        help=".mat, .npy, .tif: write zeros for positions that were never recorded; these formats cannot mark them.",
    ),
    position: str = typer.Option("", help=".tif: the stack over depth of one position, 'y,x', in place of all."),
    mat_order: MatOrderOption = "",
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Export H (and Ht) for a deconvolution code.

    Example: `lfcal export H.h5 -o H.mat`
    """
    from lfcal.base import format_bytes, format_seconds
    from lfcal.cli._console import print_json, report, report_dark, run_work
    from lfcal.psf import ExportOptions, export_files, export_notes, iter_export, open_psf, opening_notes
    from lfcal.tasks import check_mat_files, check_outputs, report_regions

    suffix = out.suffix.lower()
    given = {"--no-ht": no_ht, "--rows-first": rows_first, "--uncompressed": uncompressed, "--position": bool(position)}
    given |= {"--lens-centred": lens_centred, "--interpolation": bool(interpolation), "--allow-missing": allow_missing}
    _check_given(suffix, {**given, "--transposed": transposed})
    if interpolation and not lens_centred:
        raise InputError("--interpolation: says how --lens-centred moves patterns; add that, or leave it out")
    start = time.perf_counter()
    options = ExportOptions(
        compress=False if uncompressed else None,
        include_transpose=False if no_ht else None,
        rows_first=rows_first or None,
        lens_centred=lens_centred or None,
        interpolation=interpolation or None,
        position=_position(position),
        allow_missing=allow_missing or None,
    )
    check_mat_files(mat_order, source)
    with open_psf(source, mat_order=mat_order) as H:
        matrix = H.T if transposed else H
        # a TIFF of a large H is written under other names: one per plane
        files = export_files(matrix, out, options.position)
        check_outputs(files, source, force=force)
        work = iter_export(matrix, out, **options.given())
        report_regions(source, H, "written")
        dark = report_dark(matrix)
        run_work(work, quiet=json)
        notes = (*opening_notes(H), *export_notes(matrix, out, options))
        shape = matrix.shape
    seconds = time.perf_counter() - start
    sizes = [file.stat().st_size for file in files]
    if json:
        written = [{"file": file, "bytes": size} for file, size in zip(files, sizes, strict=True)]
        total = sum(sizes)
        print_json(
            {
                "out": out,
                "files": written,
                "shape": shape,
                "file_bytes": total,
                "seconds": seconds,
                "dark": dark,
                "notes": notes,
            }
        )
        return
    names = f"{files[0]}" if len(files) == 1 else f"{files[0]} … {files[-1].name} ({len(files)} files)"
    for note in notes:
        report(f"note: {note}")
    typer.echo(f"{names}: {shape}, {format_bytes(sum(sizes))} in {format_seconds(seconds)}")


_KNOWN_TO = {
    "--no-ht": (".mat",),
    "--rows-first": (".mat",),
    "--lens-centred": (".mat",),
    "--interpolation": (".mat",),
    "--uncompressed": (".mat", ".h5"),
    "--position": (".tif", ".tiff"),
    "--allow-missing": (".mat", ".npy", ".tif", ".tiff"),
}
"""Formats that an option is for; the others would ignore it without a word."""


def _check_given(suffix: str, given: dict[str, bool]) -> None:
    if given["--transposed"] and suffix == ".mat":
        raise InputError("--transposed: a .mat file holds both H and Ht; leave the option out")
    for option, suffixes in _KNOWN_TO.items():
        if given[option] and suffix not in suffixes:
            raise InputError.expected(option, f"a {' or '.join(suffixes)} file", suffix or "no suffix", "leave it out")


def _position(text: str) -> tuple[int, int] | None:
    """Return the position written as ``y,x``, None for empty."""
    if not text:
        return None
    try:
        y, x = (int(part) for part in text.split(","))
    except ValueError:
        raise InputError.expected("--position", "y,x", text, "for example --position 9,16") from None
    return y, x
