"""``lfcal fit validate``: predict recorded points that were not used in the fit."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from lfcal.cli._console import print_table
from lfcal.tasks import Validated

if TYPE_CHECKING:
    from lfcal.fit import Validation

LISTED = 8
"""Largest number of points listed, those with the largest errors; validation.json has all."""


def show(made: tuple[Validated, ...]) -> None:
    """Print the points with the largest errors, and a summary of all."""
    for one in made:
        if one.name:
            typer.echo(f"{one.name}:")
        _show_one(one.validation)


def _show_one(found: Validation) -> None:
    worst = sorted(found.points, key=lambda one: -one.model.error.squared)[:LISTED]
    rows = [
        [
            f"{one.z}, {one.y}, {one.x}",
            f"{one.field:.2f}",
            str(one.model.error),
            "" if one.periodic is None else str(one.periodic.error),
            f"{one.model.chi_square.lit:.2f}",
            f"{one.model.displacement_px[0]:+.3f}, {one.model.displacement_px[1]:+.3f}",
        ]
        for one in worst
    ]
    headers = ["held-out position (z, y, x)", "field", "camera", "H as periodic", "chi²", "displacement (px)"]
    print_table(headers, rows)
    good = not (found.worse(periodic=False) or found.worse(periodic=True))
    typer.secho(found.verdict, fg=typer.colors.GREEN if good else typer.colors.RED, bold=True)
