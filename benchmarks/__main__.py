"""The program ``python -m benchmarks``: a command for each public module of this folder."""

from __future__ import annotations

from functools import cache
from typing import Any

import typer

from lfcal import cli
from lfcal.cli._lazy import LazyCommands, LazyGroup, listed_commands

__all__ = ["command_line", "main"]

PROGRAM = "python -m benchmarks"


class _Benchmarks(LazyGroup):
    """All benchmarks."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands = LazyCommands(listed_commands("benchmarks"))


@cache
def command_line() -> Any:
    """Return the parser of all benchmarks; one is loaded when it is called."""
    app = typer.Typer(
        name=PROGRAM,
        cls=_Benchmarks,
        help="Compare the time and the error of lfcal with those of other methods.",
        add_completion=False,
        no_args_is_help=True,
        rich_markup_mode="markdown",
        pretty_exceptions_enable=False,
    )
    app.callback()(lambda: None)
    return typer.main.get_command(app)


def main() -> None:
    """Run ``python -m benchmarks``, which ends as ``lfcal`` does."""
    cli.main(command_line, PROGRAM)


if __name__ == "__main__":
    main()
