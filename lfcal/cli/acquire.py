"""``lfcal acquire``: record a frame at each position of a plan; a crash loses no completed frame."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import typer

from lfcal.base import Judgement, format_bytes, format_seconds, format_share
from lfcal.cli._console import print_table, show_judgement
from lfcal.tasks import WITHOUT_READOUT, PlannedSession, RecordedSession

if TYPE_CHECKING:
    from lfcal.campaign import Adapted

SHOWN = 10
"""Largest number of suspect positions that are printed."""


def show(made: tuple[RecordedSession | PlannedSession]) -> None:
    """Print how a recorded session ended and what to do next, or the forecast of a planned one."""
    (one,) = made
    if isinstance(one, PlannedSession):
        _show_forecast(one)
        return

    outcome, facts = one.outcome, one.facts
    judgement = Judgement.of("recording", one.alarms, "without an alarm")
    what = "frames" if "shown" in facts else "positions"
    taken = format_seconds(outcome.seconds)
    typer.echo(f"{one.out}: {outcome.how}, {outcome.acknowledged} of {outcome.total} {what} in {taken}")
    if "optics" in facts:
        typer.echo(f"  frames: {_simulated_words(facts['optics'])}")
    if "shown" in facts:
        show_coverage(facts["shown"])
    if outcome.damaged:
        typer.echo(f"  {outcome.damaged} damaged frames were found; those recorded now replace them")
    if judgement.findings:
        show_judgement(judgement)
    if "suspects" in facts:
        _show_suspects(facts)
    if "H" in facts:
        typer.echo(f"  {facts['H']}: H {facts['shape']}")
    if outcome.how != "complete":
        same = "" if one.adapted is None else " and the same --until-error"
        typer.echo(f"  resume with --resume{same}")
    elif one.adapted is not None and one.error is None:
        _show_adapted(one.adapted)
        typer.echo(f"  lfcal fit {one.out} -o fit/ fits the camera and makes H")


def show_coverage(facts: Mapping[str, Any]) -> None:
    """Print the fraction of phases shown in each plane of a target; ``facts`` is from `CoverageState.to_dict`."""
    shown = ", ".join(format_share(share) for share in facts["coverage_of_planes"])
    typer.echo(
        f"  phases shown if the target is placed as planned: {shown}; {facts['mean_repeats']:.2f} times on average"
    )


def _simulated_words(optics: str) -> str:
    """Return a description of the simulator's frames."""
    if optics == "pattern":
        return "simulated, quick pattern without lenslets: for trials of a recording, not for a fit"
    return f"simulated, the plan's camera (optics={optics})"


def _show_suspects(facts: Mapping[str, Any]) -> None:
    """Print the first suspect positions, and how to record all of them again."""
    found = facts["suspects"]
    for position, why in list(zip(found.positions, found.reasons, strict=True))[:SHOWN]:
        typer.echo(f"  suspect: (z, y, x) = {tuple(position)}: {why}")
    count = len(found.positions)
    more = f", {count - SHOWN} more in the list" if count > SHOWN else ""
    typer.echo(f"  {count} suspect{more}: fix the cause, then record them again with --redo {facts['redo']}")


def _show_adapted(found: Adapted) -> None:
    """Print how an adaptive session ended."""
    colour = typer.colors.GREEN if found.how == "reached" else typer.colors.RED
    typer.echo(f"  {found.steps[-1]}")
    typer.secho(f"  {found.words}", fg=colour, bold=True)


def _show_forecast(one: PlannedSession) -> None:
    found = one.forecast
    unread = f" {WITHOUT_READOUT}" if found.readout_seconds is None else ""
    rows = [
        *([["frames", _simulated_words(one.optics)]] if one.optics else []),
        ["positions", f"{found.positions}"],
        ["other frames (dark, reference, control)", f"{found.other_frames}"],
        ["time at least", format_seconds(found.seconds) + unread],
        ["recording", format_bytes(found.recording_bytes)],
        ["free on the disk", format_bytes(found.free_bytes)],
        ["camera", found.camera],
        ["stage", found.stage],
    ]
    print_table(["what", "value"], rows, title=f"{one.out}: nothing was moved or written")
