"""``lfcal status``: where a long run stands."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lfcal.cli.options import JsonOption

if TYPE_CHECKING:
    from lfcal.work import RunState

SHOWN = 40
"""Units of a table; of more those that are done or wait are only counted."""


def register(app: typer.Typer) -> None:
    """Add ``status`` to the app."""
    app.command("status")(command)


def command(
    run: Path = typer.Argument(help="What the run makes (H.h5), or the folder of its units (H.h5.parts)."),
    *,
    json: JsonOption = False,
) -> None:
    """Show where a long run stands: its units, what is under way and by whom, and what failed and why.

    Example: `lfcal status H.h5`
    """
    from lfcal.cli.console import print_json
    from lfcal.work import parts_folder, read_run

    folder = run if run.is_dir() else parts_folder(run)
    if run.is_file() and not folder.exists():
        if json:
            print_json({"path": run, "whole": True})
        else:
            typer.echo(f"{run}: is whole; no run is under way")
        return
    state = read_run(folder)
    if json:
        print_json(_plain(run, state))
        return
    _show(folder, state)


def _plain(run: Path, state: RunState) -> dict[str, Any]:
    units = [
        {
            "name": unit.name,
            "state": unit.state,
            "attempts": unit.attempts,
            "seconds": None if math.isnan(unit.seconds) else unit.seconds,
            "worker": unit.worker,
            "reason": unit.reason,
        }
        for unit in state.units
    ]
    return {
        "path": run,
        "whole": False,
        "title": state.title,
        "running": state.running,
        "executor": state.executor,
        "workers": state.workers,
        "place": state.place,
        "done": state.count("done"),
        "total": len(state.units),
        "eta_seconds": state.eta_seconds,
        "units": units,
    }


def _show(folder: Path, state: RunState) -> None:
    from lfcal.cli.console import print_table
    from lfcal.units import format_seconds

    who = f"{state.executor}, {state.workers} at work" if state.running else "not running"
    typer.echo(f"{state.title}: {state.count('done')} of {len(state.units)} units done; {who}")
    if state.place and state.running:
        typer.echo(f"watch it at {state.place}")
    told = [u for u in state.units if len(state.units) <= SHOWN or u.state in ("under way", "failed") or u.reason]
    rows = [
        [
            unit.name,
            unit.state,
            str(unit.attempts or ""),
            "" if math.isnan(unit.seconds) else format_seconds(unit.seconds),
            unit.worker,
            unit.reason,
        ]
        for unit in told
    ]
    print_table(["unit", "state", "attempts", "time", "by", "why"], rows)
    if state.running and state.eta_seconds is not None:
        typer.echo(f"about {format_seconds(state.eta_seconds)} left")
    elif not state.running:
        typer.echo(f"{folder}: the command that began it goes on with --resume")
