"""``lfcal bench``: where to find the benchmarks."""

from __future__ import annotations

import typer

from lfcal.base import InputError
from lfcal.cli._console import print_json
from lfcal.cli._options import JsonOption

WHERE = "run `python -m benchmarks` in a checkout of lfcal"


def command(
    name: str = typer.Argument("", help="Name of a benchmark. It is always refused: benchmarks are not installed."),
    json: JsonOption = False,
) -> None:
    """Print where the benchmarks are: in the source, outside the installed package.

    Example: `lfcal bench`
    """
    if name:
        raise InputError(f"bench {name}: benchmarks are not part of the installed program; {WHERE}")
    if json:
        print_json({"benchmarks": WHERE})
        return
    typer.echo(f"The benchmarks compare the run time of lfcal with that of other programs: {WHERE}.")
