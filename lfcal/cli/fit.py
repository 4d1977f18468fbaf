"""``lfcal fit``: find the camera that explains measured patterns, and compute its H without noise."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import typer

from lfcal.cli._console import print_table, report, show_judgement
from lfcal.tasks import FitOutcome

if TYPE_CHECKING:
    from lfcal.fit import FieldFit, Fit


def show(made: tuple[FitOutcome, ...]) -> None:
    """Print parameters, verdict, notes and files of each fit."""
    from lfcal.judge import judgement_of

    for one in made:
        if one.points is not None:
            show_judgement(judgement_of(one.points))
        _show_parameters(one.fit)
        if one.field is not None:
            _show_field(one.field, points=one.points is not None)
        fit = one.fit
        typer.secho(fit.verdict, fg=typer.colors.GREEN if fit.complete else typer.colors.RED, bold=True)
        for note in _notes(one):
            report(note)
        for name, summary in one.hybrids.items():
            typer.echo(f"{name}: {summary}" if name else str(summary))
        typer.echo(f"{one.out}: {', '.join(str(path.relative_to(one.out)) for path in one.files)}")


def _show_parameters(fit: Fit) -> None:
    rows = [
        [one.name, f"{one.value:.6g}", f"{one.sigma:.2g}", f"{one.start:.6g}", one.unit]
        for one in fit.parameters.values()
    ]
    print_table(["parameter", "found", "±", "described", "unit"], rows)


def _show_field(field: FieldFit, *, points: bool) -> None:
    """Print the wavefront over the field, and the error of the model in each region or part of the field."""
    from lfcal.fit import wavefront_table

    headers, lines = wavefront_table(field) if not points else ([], [])
    if lines:
        print_table(headers, lines, title="wavefront (waves)")
    rows = [
        [name, str(len(own.residuals)), str(own.here.error), f"{own.here.chi_square.lit:.3f}"]
        for name, own in field.fits.items()
        if own.here is not None
    ]
    what = ["part of the field", "points"] if points else ["region", "patterns"]
    print_table([*what, "error of the model", "χ²"], rows)


def _notes(one: FitOutcome) -> Iterable[str]:
    """Yield validation results, outliers and undetermined parameters, one line each."""
    if one.points is not None:
        if one.holes:
            yield f"note: {one.holes}"
    else:
        fits = {"": one.fit} if one.field is None else one.field.fits
        yield from (f"note: {name}: {answer}" for name, answer in one.fit.answers.items() if one.field is None)
        for name, own in fits.items():
            region = f"{name}, " if name else ""
            for left in own.outliers:
                yield f"left out: {region}(z, y, x) = ({left.z}, {left.y}, {left.x}): {left.reason}"
            if own.unseen:
                yield f"note: {region}{own.unseen_words}"
    what = "these points" if one.points is not None else "this scan" if one.field is None else "these scans"
    yield from (f"note: not separated by {what}: {combination}" for combination in one.fit.unidentified)
