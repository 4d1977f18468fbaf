"""``lfcal reduce``: store H in a fraction of its bytes; each pattern stays within a tolerance that the file states."""

from __future__ import annotations

import typer

from lfcal.base import format_bytes, format_seconds
from lfcal.tasks import ReducedFile


def show(made: tuple[ReducedFile, ...]) -> None:
    """Print the path, the sizes before and after, the largest loss and the time of each reduced H."""
    for one in made:
        before, after = format_bytes(one.source_bytes), format_bytes(one.bytes)
        entries = 8 * one.bytes / one.matrix.size
        typer.echo(
            f"{one.out}: H {one.matrix.shape}, {before} to {after} ({entries:.1f} bits per entry) in "
            f"{format_seconds(one.seconds)}; no pattern loses more than {100 * one.bound[:, 2].max():.3g} %"
        )
