"""``python -m benchmarks``: time lfcal side by side with other ways to do the same."""

from __future__ import annotations

import importlib
import pkgutil

import typer

import benchmarks


def register(app: typer.Typer) -> None:
    """Add ``bench`` with the sub-commands of the modules of `benchmarks`."""
    bench = typer.Typer(
        help="Time lfcal side by side with other ways to do the same.",
        epilog="Example: `python -m benchmarks multiplex --quick`",
        no_args_is_help=True,
    )
    for name in sorted(m.name for m in pkgutil.iter_modules(benchmarks.__path__) if not m.name.startswith("_")):
        importlib.import_module(f"benchmarks.{name}").register(bench)
    app.add_typer(bench, name="bench")
