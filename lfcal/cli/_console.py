"""Output of the commands: progress bars, tables, JSON, one-line errors."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

import typer

from lfcal.base import Judgement, Progress, Work, drain, plain

__all__ = [
    "KEPT",
    "done_text",
    "print_json",
    "print_result",
    "print_table",
    "print_written",
    "report",
    "run_work",
    "show_judgement",
]

R = TypeVar("R")

KEPT = "complete units are kept"
"""Note on an exception that ends a run whose complete units are kept; the last message then states this."""


def report(message: str) -> None:
    """Print one line to standard error."""
    with suppress(OSError):  # a full disk behind the output must not end the work
        print(f"lfcal: {' '.join(message.split())}", file=sys.stderr)


def run_work(work: Work[R], *, quiet: bool = False, seen: Callable[[Any], object] | None = None) -> R:
    """Run ``work`` to its end with a progress bar on standard error (none if ``quiet`` or not a terminal).

    Each record is passed to ``seen``, so that intermediate results can be printed if the work ends early.
    """
    # bars are noise in a log file, and for a program that reads JSON
    if quiet or not sys.stderr.isatty():
        return drain(work, seen)  # type: ignore[arg-type]  # what it returns is not used
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[said]}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}"),
    )
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        tasks: dict[str, Any] = {}

        def show(record: Progress) -> None:
            if seen is not None:
                seen(record)
            # one bar per stage, added when the stage begins: their number is not known in advance
            if record.stage not in tasks:
                tasks[record.stage] = bar.add_task(record.stage, total=record.total or None, note="", said="")
            task = tasks[record.stage]
            bar.update(task, completed=record.done, total=record.total or None, note=record.note)
            speed = bar.tasks[bar.task_ids.index(task)].speed
            bar.update(task, said=done_text(record, speed))

        return drain(work, show)


def done_text(record: Progress, speed: float | None) -> str:
    """Return a text with the number done, the total, and the rate per second, minute or hour."""
    counted = record.count or f"{record.done // record.per}"
    if not speed:
        return counted
    rate = speed / record.per
    unit, seconds = next(((u, s) for u, s in (("s", 1.0), ("min", 60.0)) if rate * s >= 1), ("h", 3600.0))
    return f"{counted}, {rate * seconds:.3g}/{unit}"


def print_json(value: Any) -> None:
    """Print ``value`` as JSON to standard output."""
    typer.echo(json.dumps(plain(value), indent=2, ensure_ascii=False, allow_nan=False))


def print_table(headers: list[str], rows: list[list[str]], *, title: str = "") -> None:
    """Print a table to standard output, with numbers aligned to the right."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title or None, box=box.SIMPLE_HEAD, title_justify="left")
    for k, header in enumerate(headers):
        numeric = bool(rows) and all(_numeric(row[k]) for row in rows)
        table.add_column(header, justify="right" if numeric else "left", overflow="fold")
    for row in rows:
        table.add_row(*row)
    # a pipe has no width: a fixed one gives the same output everywhere
    Console(width=None if sys.stdout.isatty() else 132).print(table)


def print_result(facts: Any, headers: list[str], rows: list[list[str]], *, title: str = "", json: bool) -> None:
    """Print a result as JSON of ``facts``, or as a table."""
    if json:
        print_json(facts)
    else:
        print_table(headers, rows, title=title)


def print_written(*paths: Path | None) -> None:
    """Print the paths of the files that were written."""
    for path in filter(None, paths):
        typer.echo(f"written: {path}")


LISTED = 20
"""Largest number of findings in a table; the JSON output has all of them."""

COLOURS = {"good": typer.colors.GREEN, "fair": typer.colors.YELLOW, "bad": typer.colors.RED}


def show_judgement(judgement: Judgement, name: str = "") -> None:
    """Print the verdict on ``name`` and, if there are several findings, a table by subject."""
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


def _numeric(text: str) -> bool:
    return not text or text[0].isdigit() or text[0] in "-+–<≈" or text == "—"
