"""``lfcal reconstruct``: reconstruct the volume behind a light-field frame, or those of a series, with H."""

from __future__ import annotations

from typing import Any

import typer

from lfcal.base import format_bytes, format_seconds
from lfcal.cli._console import print_table, report
from lfcal.tasks import Reconstructed, ReconstructionForecast


def show(made: tuple[Reconstructed | ReconstructionForecast, ...]) -> None:
    """Print the reconstructed volumes, or the forecast cost."""
    from lfcal.tasks import Reconstructed

    for one in made:
        if isinstance(one, Reconstructed):
            for result in one.results:
                _show_volume(result, one)
        else:
            _show_forecast(one)


def _show_volume(result: Any, made: Reconstructed) -> None:
    if result.failed:
        report(f"{result.name}: no volume; {result.failed}")
        return
    for note in result.notes:
        report(f"note: {result.name}: {note}")
    took = format_seconds(result.seconds)
    fit = f"residual {result.residual:.4f}" + (f", chi2 per pixel {result.chi2:.3g}" if result.chi2 >= 0 else "")
    typer.echo(f"{made.files[result.name]}: volume {made.shape}, {result.iterations} iterations in {took}, {fit}")
    if result.stopped:
        typer.echo(f"stopped: {result.stopped}")


def _show_forecast(made: ReconstructionForecast) -> None:
    """Print the cost of each projection method, and the time and memory of the whole run."""
    run = made.run
    P, choice = run.projector, run.choice
    found = P.forecast()
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
    some = f"{run.iterations} iterations" + (" (it stops automatically)" if choice.auto else "")
    typer.echo(f"{len(run.frames)} frames, {some}: about {format_seconds(run.seconds)}{beyond}")
    typer.echo(f"memory {run.memory}")
    if P.device is not None:
        typer.echo(f"{P.device.name}: {found.device}")
