"""What a reconstruction will cost: the table of ``lfcal reconstruct --forecast``."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from lfcal.reconstruct import Projector, SolverChoice

__all__ = ["show_forecast", "total_seconds"]

USUAL = 20
"""Iterations that a run takes which stops by itself, for a forecast; it may be half or twice as many."""


def total_seconds(P: Projector, choice: SolverChoice, frames: int) -> float:
    """Return the seconds of so many frames, set-up included."""
    found = P.forecast().chosen
    return found.prepare_s + frames * _iterations(choice) * found.pair_s


def show_forecast(P: Projector, choice: SolverChoice, frames: int, *, warm: bool, json: bool) -> None:
    """Print what each way to project costs, and time and memory of the whole run."""
    from lfcal.base import format_bytes, format_seconds
    from lfcal.cli._console import print_json, print_table
    from lfcal.reconstruct import run_memory

    found = P.forecast()
    memory = run_memory(P, choice, warm=warm)
    total = total_seconds(P, choice, frames)
    if json:
        known = {"memory": memory, "memory_bytes": memory.total, "seconds": total}
        print_json({"forecast": found.chosen, "options": found.options, "device": _device(P), **known})
        return
    rows = [
        [
            c.method + (" *" if c is found.chosen else ""),
            format_seconds(c.prepare_s),
            format_seconds(c.forward_s),
            format_seconds(c.adjoint_s),
            format_bytes(c.memory_bytes),
            "yes" if c.resident else "no",
        ]
        for c in found.options
    ]
    print_table(["method", "set-up", "forward", "adjoint", "memory", "kept"], rows, title=f"{P.volume_shape} volume")
    beyond = f", margin of {choice.margin} pixels included" if choice.margin else ""
    some = f"{_iterations(choice)} iterations" + (" (it stops by itself)" if choice.auto else "")
    typer.echo(f"{frames} frames, {some}: about {format_seconds(total)}{beyond}")
    typer.echo(f"memory {memory}")
    if P.device is not None:
        typer.echo(f"{P.device.name}: {found.device}")


def _device(P: Projector) -> dict[str, Any] | None:
    use = P.forecast().device
    return None if P.device is None or use is None else {"name": P.device.name, **asdict(use)}


def _iterations(choice: SolverChoice) -> int:
    return min(choice.iterations, USUAL) if choice.auto else choice.iterations
