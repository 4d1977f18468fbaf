"""``lfcal transpose``: transpose H into HT, from file to file, with one plane of each in memory."""

from __future__ import annotations

import typer

from lfcal.base import format_bytes, format_seconds
from lfcal.tasks import TransposedFile


def show(made: tuple[TransposedFile, ...]) -> None:
    """Print the path, shape, size, method and time of each transposed file."""
    for one in made:
        done = f"{format_bytes(one.bytes)} transposed ({one.method}) in {format_seconds(one.seconds)}"
        typer.echo(f"{one.out}: {one.made} {one.shape}, {done}")
