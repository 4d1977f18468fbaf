"""``lfcal fit object``: predict the frame of a known object with the H of a fit."""

from __future__ import annotations

import typer

from lfcal.tasks import PredictedObject


def show(made: tuple[PredictedObject, ...]) -> None:
    """Print the error and chi² of each prediction."""
    for found in (one.compared for one in made):
        typer.echo(f"{found.label}: predicted with an error {found.error}, chi² {found.chi_square.lit:.3f}")
