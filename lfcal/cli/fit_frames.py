"""``lfcal fit frames``: recalibrate a camera with ordinary frames, and compute its H."""

from __future__ import annotations

import typer

from lfcal.cli._console import print_table, report
from lfcal.tasks import Recalibrated


def show(made: tuple[Recalibrated, ...]) -> None:
    """Print the fitted parameters, the goodness of fit of each frame, the decision and the files."""
    for one in made:
        found = one.found
        rows = [
            [own.name, f"{own.value:.6g}", f"{own.sigma:.2g}", f"{own.start:.6g}", own.unit]
            for own in found.parameters.values()
        ]
        print_table(["parameter", "found", "±", "described", "unit"], rows)
        print_table(["frame", "goodness of fit"], [[name, f"{own.ratio:.3f}"] for name, own in found.goodness.items()])
        typer.secho(found.verdict, fg=typer.colors.GREEN if found.accepted else typer.colors.RED, bold=True)
        for words in found.notes:
            report(f"note: {words}")
        if one.files:
            typer.echo(f"{one.out}: {', '.join(path.name for path in one.files)}")
