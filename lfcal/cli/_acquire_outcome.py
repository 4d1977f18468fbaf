"""What ``lfcal acquire`` does after the last frame: list suspects, assemble H, pack the recording, and say so."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from lfcal.acquire import Outcome, RedoList
    from lfcal.devices import Rig

__all__ = ["finish", "list_suspects", "show_outcome", "simulated_optics", "simulated_words"]

SUSPECTS = "suspects.json"
SHOWN = 10


def simulated_optics(rig: Rig) -> dict[str, str]:
    """Return how frames of the simulator are computed, as the session records it; nothing for real devices."""
    from lfcal.acquire import optics_of

    optics = optics_of(rig)
    return {"optics": optics} if optics else {}


def simulated_words(optics: str) -> str:
    """Return in words what the frames of the simulator are."""
    if optics == "pattern":
        return "simulated, quick pattern without lenslets: for trials of a recording, not for a fit"
    return f"simulated, the plan's camera (optics={optics})"


def list_suspects(out: Path, outcome: Outcome) -> dict[str, Any]:
    """Write the list of suspect positions into the session's folder; return it, and where it is, if there are any."""
    from lfcal.acquire import read_suspects

    path = out / SUSPECTS
    found = read_suspects(out) if outcome.acknowledged else None
    if found is None or not found.positions:
        path.unlink(missing_ok=True)  # of an earlier run: recorded again since
        return {}
    found.write(path)
    return {"suspects": found, "redo": path}


def finish(out: Path, assemble: Path | None, pack: bool, quiet: bool) -> dict[str, Any]:
    """Assemble H of a complete session, and pack its recording, as asked for; return what came of it."""
    from lfcal.acquire import SessionFile, iter_assemble_session, iter_finish
    from lfcal.cli._console import report, run_work
    from lfcal.psf import AssemblySettings

    result: dict[str, Any] = {}
    if assemble is not None:
        # a complete session has every position once: a gap would be a defect, and is not to be filled quietly.
        settings = AssemblySettings(strict=not SessionFile.read(out).redo[0])
        made = run_work(iter_assemble_session(out, assemble, settings=settings), quiet=quiet)
        with made.matrix as matrix:
            result |= {"H": assemble, "shape": matrix.shape, "saturated_positions": made.saturated}
    if pack:
        packed = run_work(iter_finish(out), quiet=quiet)
        result["bytes_gained"] = packed.bytes_gained
        for note in packed.left:
            report(f"note: {note}")
    return result


def _show_suspects(suspects: RedoList, path: Path) -> None:
    """Print the first of the positions that are suspect, and how to record all of them again."""
    for position, why in list(zip(suspects.positions, suspects.reasons, strict=True))[:SHOWN]:
        typer.echo(f"  suspect: (z, y, x) = {tuple(position)}: {why}")
    count = len(suspects.positions)
    more = f", {count - SHOWN} more in the list" if count > SHOWN else ""
    typer.echo(f"  {count} suspect{more}: remove the cause, then record them again with --redo {path}")


def show_outcome(result: dict[str, Any], outcome: Outcome, out: Path, json: bool) -> None:
    """Print how a session ended, and what to do next."""
    from lfcal.base import Judgement, format_seconds
    from lfcal.cli._acquire_target import show_coverage
    from lfcal.cli._console import print_json
    from lfcal.cli._findings import show_judgement

    judgement = Judgement.of("recording", result.pop("alarms"), "without an alarm")
    result |= judgement.to_dict()

    if json:
        print_json(result)
    else:
        time_taken = format_seconds(outcome.seconds)
        what = "frames" if "shown" in result else "positions"
        typer.echo(f"{out}: {outcome.how}, {outcome.acknowledged} of {outcome.total} {what} in {time_taken}")
        if "optics" in result:
            typer.echo(f"  frames: {simulated_words(result['optics'])}")
        if "shown" in result:
            show_coverage(result["shown"])
        if outcome.damaged:
            typer.echo(f"  {outcome.damaged} damaged frames were found; those recorded now replace them")
        if judgement.findings:
            show_judgement(judgement)
        if "suspects" in result:
            _show_suspects(result["suspects"], result["redo"])
        if "H" in result:
            typer.echo(f"  {result['H']}: H {result['shape']}")
        if outcome.how != "complete":
            typer.echo("  resume with --resume")
