"""``lfcal assemble``: correct and crop point-source frames with the shifting cutout, and assemble them into H."""

from __future__ import annotations

from itertools import groupby
from typing import Any

import typer

from lfcal.base import format_bytes, format_seconds
from lfcal.cli._console import show_judgement
from lfcal.tasks import Assembled

LISTED = 20
"""Largest number of damaged frames listed; the JSON output and the file's provenance have all of them."""


def show(made: tuple[Assembled, ...]) -> None:
    """Print a summary of each assembled H, and the number of regions of each file with several."""
    for out, found in groupby(made, key=lambda one: one.out):
        ones = tuple(found)
        for one in ones:
            _show_one(one) if len(ones) == 1 else _show_region(one)
        if len(ones) > 1:
            typer.echo(f"{out}: H of {len(ones)} regions")


def _show_region(one: Assembled) -> None:
    report = one.report
    typer.echo(f"{one.name}: H {report.matrix.shape} from {report.frames} frames, {len(report.missing)} missing")


def _show_one(one: Assembled) -> None:
    from lfcal.cli._console import report as line
    from lfcal.judge import judgement_of
    from lfcal.tasks import left_words

    report, provenance = one.report, one.report.matrix.provenance
    if one.points is not None and one.target is not None:
        show_judgement(judgement_of(one.points))
        if one.unused:
            line(f"note: {left_words(one.unused, len(one.points), one.target)}")
    notes: list[Any] = [provenance.get("orientation", {}).get("note"), *report.notes]
    copied = provenance.get("half_cell", {}).get("filled", 0)
    if copied:
        notes.append(f"{copied} positions have the patterns recorded half a period away; they are marked")
    if report.filled:
        notes.append(f"{report.filled} of the missing positions are filled by the model of the fit, and marked")
    for note in filter(None, notes):
        line(f"note: {note}")
    for found in report.left_out[:LISTED]:
        where = "dark frame" if found.position is None else f"(z, y, x) = {tuple(found.position)}"
        line(f"left out: {found.label}, {where}")
    size = format_bytes(one.out.stat().st_size)
    # the fraction of a pixel that a cutout moved by whole pixels leaves uncorrected
    rows, columns = report.residual_px
    made = f"H {report.matrix.shape} from {report.frames} frames"
    typer.echo(f"{one.out}: {made}, {size} in {format_seconds(one.seconds)}")
    show_judgement(judgement_of(report))
    typer.echo(f"sub-pixel residual left by the cutout: {rows:.2f} rows, {columns:.2f} columns (px)")
