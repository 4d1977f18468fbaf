"""What is wrong with data, as commands print it: the verdict, and a table of findings by subject."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from lfcal.base import Judgement

__all__ = ["show_judgement"]

LISTED = 20
"""Findings that a table lists; all of them are in the JSON output."""

COLOURS = {"good": typer.colors.GREEN, "fair": typer.colors.YELLOW, "bad": typer.colors.RED}


def show_judgement(judgement: Judgement, name: str = "") -> None:
    """Print the verdict on what is called ``name`` and, of several findings, a table by subject."""
    from lfcal.cli._console import print_table

    head = f"{name}: {judgement.verdict}" if name else judgement.verdict
    typer.secho(head, fg=COLOURS.get(judgement.merit), bold=True)
    if len(judgement.findings) > 1:
        rows = [
            [subject, one.merit, one.what, "; ".join(filter(None, (one.detail, one.where))), one.cost_words, one.remedy]
            for subject, found in judgement.by_subject().items()
            for one in found
        ]
        if len(rows) > LISTED:
            rows = [*rows[:LISTED], ["", "", f"and {len(rows) - LISTED} more", "--json lists all", "", ""]]
        print_table(["subject", "merit", "finding", "what was found", "cost", "what to do"], rows)
