"""``lfcal status`` of a recorded session: what is safe on the disk, and what its frames show."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lfcal.cli._console import print_json

if TYPE_CHECKING:
    from lfcal.acquire import SessionFile

__all__ = ["is_session", "tell_session"]


def is_session(path: Path) -> bool:
    """Return whether ``path`` is the folder of a session."""
    from lfcal.acquire import NAME

    return (path / NAME).is_file()


def tell_session(folder: Path, *, json: bool) -> None:
    """Print how far a session is, how its last run ended, and how it goes on."""
    from lfcal.acquire import SessionFile

    session = SessionFile.read(folder)
    facts = _facts(folder, session)
    if json:
        print_json(facts)
        return
    what = "frames of a target" if session.target is not None else "positions"
    ended = f"; the last run: {facts['how']}" if facts["how"] else ""
    if facts["recording"]:
        ended = "; on hold: " + facts["held"] if facts["held"] else "; being recorded"
        ended += f" (process {facts['process']})" if facts["process"] else ""
    typer.echo(f"{folder}: {facts['done']} of {facts['total']} {what} are safe on the disk{ended}")
    if session.target is not None:
        from lfcal.cli.acquire import show_coverage

        show_coverage(facts["shown"])
    if session.devices.automatic:
        typer.echo(f"  camera: {session.devices.automatic_words}: frames may not be proportional to light")
    if facts["recording"]:
        return
    if facts["done"] < facts["total"]:
        typer.echo("  lfcal acquire with its plan and --resume goes on")
    elif session.target is not None:
        typer.echo(f"  lfcal fit {folder} finds the camera and H; lfcal assemble {folder} makes H of what meets phases")
    else:
        typer.echo(f"  lfcal assemble {folder} makes H of it")


def _facts(folder: Path, session: SessionFile) -> dict[str, Any]:
    from lfcal.acquire.recording import holder_of

    done = _recorded(folder, session)
    target = session.target
    total = session.positions
    if target is None and session.redo[0]:
        total = len({tuple(at) for part in session.redo for at in part})
    at_work = holder_of(folder)
    facts: dict[str, Any] = {
        "path": folder,
        "session": "scan" if target is None else "target",
        "done": done,
        "total": total,
        "how": session.runs[-1].how if session.runs else "",
        "recording": at_work is not None,
        "process": None if at_work is None else at_work.process or None,
        "held": "" if at_work is None else at_work.held,
    }
    if session.devices.automatic:
        facts["automatic"] = {name: session.devices.settings[name] for name in session.devices.automatic}
    if target is None:
        return facts
    from lfcal.tasks import coverage_facts, recorded_before

    watching = recorded_before(target, folder)  # type: ignore[arg-type]  # a session's frame plan is a target's
    return facts | {"shown": coverage_facts(watching.state())}


def _recorded(folder: Path, session: SessionFile) -> int:
    """Return how many of the plan's positions are acknowledged."""
    from lfcal.acquire.recording import RecordingFile

    there: set[int] = set()
    for name in session.recordings:
        with RecordingFile(folder / name) as file:
            there |= set(file.records["index"][file.taken].tolist())
    return len(there)
