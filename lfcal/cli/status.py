"""``lfcal status``: show the progress of a long run or a recorded session."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lfcal.cli._console import print_json, print_table
from lfcal.cli._options import JsonOption

if TYPE_CHECKING:
    from lfcal.acquire import SessionFile
    from lfcal.work import RunState


def command(
    run: Path = typer.Argument(
        help="Output of the run (H.h5), the folder of its units (H.h5.parts), or a recorded session."
    ),
    *,
    json: JsonOption = False,
) -> None:
    """Show the progress of a long run: its units, what is under way and on which worker, and what failed and why.

    For a recorded session, show how many positions are safe on the disk; for a target, also which phases are covered.

    Example: `lfcal status H.h5`
    """
    from lfcal.acquire import NAME, SessionFile
    from lfcal.work import parts_folder, read_run

    if (run / NAME).is_file():
        session = SessionFile.read(run)
        facts = _session_facts(run, session)
        print_json(facts) if json else _show_session(run, session, facts)
        return
    folder = run if run.is_dir() else parts_folder(run)
    if run.is_file() and not folder.exists():
        print_json({"path": run, "whole": True}) if json else typer.echo(f"{run}: complete; no run is in progress")
        return
    state = read_run(folder)
    print_json({"path": run, "whole": False, **state.to_dict()}) if json else _show_run(folder, state)


def _show_run(folder: Path, state: RunState) -> None:
    from lfcal.work import HEADER, run_table

    found = run_table(state)
    typer.echo(found.headline)
    if found.place:
        typer.echo(f"watch it at {found.place}")
    print_table(list(HEADER), [list(row) for row in found.rows])
    if found.pace:
        typer.echo(found.pace)
    elif not state.running:
        typer.echo(f"{folder}: repeat the original command with --resume to continue")


def _session_facts(folder: Path, session: SessionFile) -> dict[str, Any]:
    """Return facts about a session for JSON, such as the number of safe frames and how its last run ended."""
    from lfcal.acquire import LiveCoverage
    from lfcal.acquire.recording import holder_of

    at_work, target, devices = holder_of(folder), session.target, session.devices
    facts: dict[str, Any] = {
        "path": folder,
        "session": "scan" if target is None else "target",
        "done": int(session.acknowledged(folder).sum()),
        "total": int(session.chosen.sum()) if target is None else session.positions,
        "how": session.runs[-1].how if session.runs else "",
        "recording": at_work is not None,
        "process": None if at_work is None else at_work.process or None,
        "held": "" if at_work is None else at_work.held,
    }
    if devices.automatic:
        facts["automatic"] = {name: devices.settings[name] for name in devices.automatic}
    if target is not None:
        watching = LiveCoverage(target, folder)  # type: ignore[arg-type]  # a session's frame plan is a target's
        facts["shown"] = watching.state().to_dict()
    return facts


def _show_session(folder: Path, session: SessionFile, facts: dict[str, Any]) -> None:
    """Print the progress of a session, how its last run ended, and how to continue it."""
    from lfcal.cli.acquire import show_coverage

    what = "positions" if session.target is None else "frames of a target"
    ended = f"; the last run: {facts['how']}" if facts["how"] else ""
    if facts["recording"]:
        ended = "; on hold: " + facts["held"] if facts["held"] else "; being recorded"
        ended += f" (process {facts['process']})" if facts["process"] else ""
    typer.echo(f"{folder}: {facts['done']} of {facts['total']} {what} are safe on the disk{ended}")
    if session.target is not None:
        show_coverage(facts["shown"])
    if session.devices.automatic:
        typer.echo(f"  camera: {session.devices.automatic_words}: frames may not be proportional to light")
    if facts["recording"]:
        return
    if facts["done"] < facts["total"]:
        typer.echo("  lfcal acquire with its plan and --resume continues it")
    elif session.target is not None:
        typer.echo(
            f"  lfcal fit {folder} fits the camera and makes H; lfcal assemble {folder} makes H from points that "
            "show phases"
        )
    else:
        typer.echo(f"  lfcal assemble {folder} makes H")
