"""The application: all commands of this package, in the order of the data flow."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any

import typer

from lfcal.base import full_version
from lfcal.cli._lazy import LazyCommands, LazyGroup, listed_commands

__all__ = ["build_app", "command_line"]

HEADINGS = {
    "Getting started": ("demo", "doctor"),
    "Camera and plan": ("camera", "plan", "white", "views", "depth", "simulate", "accuracy"),
    "Recording": ("acquire", "verify"),
    "H and its quality": ("assemble", "inspect", "compare", "fit", "watch", "trend", "transpose", "reduce", "export"),
    "Using H": ("reconstruct", "multiplex"),
}
"""The commands under their headings, in the order of the data; others follow at the end."""


def _version(value: bool) -> None:
    if value:
        typer.echo(f"lfcal {full_version()}")
        raise typer.Exit


class _Commands(LazyGroup):
    """Group of all commands."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands = LazyCommands(listed_commands("lfcal.cli", sum(HEADINGS.values(), ())))

    def headings(self, names: tuple[str, ...]) -> Iterator[tuple[str, tuple[str, ...]]]:
        """Yield the headings of the list of commands."""
        yield from HEADINGS.items()
        yield "Other commands", tuple(name for name in names if name not in sum(HEADINGS.values(), ()))


def build_app() -> typer.Typer:
    """Return the application; a command is imported when it is called."""
    app = typer.Typer(
        name="lfcal",
        cls=_Commands,
        help="PSF calibration and acquisition for plenoptic (light-field) cameras.",
        no_args_is_help=True,
        rich_markup_mode="markdown",
        # main prints errors as one line; Python prints the traceback of a defect.
        pretty_exceptions_enable=False,
    )

    @app.callback()
    def _root(
        *,
        version: bool = typer.Option(False, "--version", callback=_version, is_eager=True, help="Show the version."),
    ) -> None:
        """PSF calibration and acquisition for plenoptic (light-field) cameras."""

    return app


@cache
def command_line() -> Any:
    """Return the parser of the whole command line, which is created once."""
    return typer.main.get_command(build_app())
