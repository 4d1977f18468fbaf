"""``lfcal bench``: side-by-side timings."""

from __future__ import annotations

import typer

from lfcal.cli.app import command_modules


def register(app: typer.Typer) -> None:
    """Add ``bench`` with one sub-command per module of `lfcal.bench`."""
    bench = typer.Typer(help="Time lfcal side by side with other ways to do the same.", no_args_is_help=True)
    for module in command_modules("lfcal.bench"):
        module.register(bench)
    app.add_typer(bench, name="bench")
