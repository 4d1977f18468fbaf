"""``lfcal status``: where a long run stands."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lfcal.cli._options import JsonOption

if TYPE_CHECKING:
    from lfcal.work import RunState


def register(app: typer.Typer) -> None:
    """Add ``status`` to the app."""
    app.command("status")(command)


def command(
    run: Path = typer.Argument(
        help="What the run makes (H.h5), the folder of its units (H.h5.parts), or that of a recorded session."
    ),
    *,
    json: JsonOption = False,
) -> None:
    """Show where a long run stands: its units, what is under way and by whom, and what failed and why.

    Of a recorded session it says what is safe on the disk; of a target's, which phases its frames show.

    Example: `lfcal status H.h5`
    """
    from lfcal.cli._console import print_json
    from lfcal.cli._status_session import is_session, tell_session
    from lfcal.work import parts_folder, read_run

    if is_session(run):
        tell_session(run, json=json)
        return
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
        "units_per_hour": state.per_hour,
        "eta_seconds": state.eta_seconds,
        "units": units,
    }


def _show(folder: Path, state: RunState) -> None:
    from lfcal.cli._console import print_table
    from lfcal.work import HEADER, run_table

    found = run_table(state)
    typer.echo(found.headline)
    if found.place:
        typer.echo(f"watch it at {found.place}")
    print_table(list(HEADER), [list(row) for row in found.rows])
    if found.pace:
        typer.echo(found.pace)
    elif not state.running:
        typer.echo(f"{folder}: the command that began it goes on with --resume")
