"""``lfcal bench``: time lfcal side by side with other ways to do the same."""

from __future__ import annotations

import importlib
import pkgutil

import typer

import lfcal.bench


def register(app: typer.Typer) -> None:
    """Add ``bench`` with the sub-commands of the modules of `lfcal.bench`."""
    bench = typer.Typer(
        help="Time lfcal side by side with other ways to do the same.",
        epilog="Example: `lfcal bench multiplex --quick`",
        no_args_is_help=True,
    )
    for name in sorted(m.name for m in pkgutil.iter_modules(lfcal.bench.__path__) if not m.name.startswith("_")):
        importlib.import_module(f"lfcal.bench.{name}").register(bench)
    app.add_typer(bench, name="bench")
