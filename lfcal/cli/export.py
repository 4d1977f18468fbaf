"""``lfcal export``: export H (and Ht) for a deconvolution code or another program."""

from __future__ import annotations

import typer

from lfcal.base import format_bytes, format_seconds
from lfcal.cli._console import report
from lfcal.tasks import ExportedFiles


def show(made: tuple[ExportedFiles, ...]) -> None:
    """Print path, shape, size and time of the written files, and notes on their use."""
    for one in made:
        files = one.files
        names = f"{files[0]}" if len(files) == 1 else f"{files[0]} … {files[-1].name} ({len(files)} files)"
        for note in one.notes:
            report(f"note: {note}")
        typer.echo(f"{names}: {one.shape}, {format_bytes(one.bytes)} in {format_seconds(one.seconds)}")
