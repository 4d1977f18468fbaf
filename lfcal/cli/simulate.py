"""``lfcal simulate``: simulate the PSF matrix of a camera, with the effects that matter for it and no others."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from lfcal.cli._task_command import add_task
from lfcal.tasks import task_set

if TYPE_CHECKING:
    from lfcal.tasks import SimulatedFrames, SimulatedH, SimulatedRegions, SimulationForecast

    Made = tuple[SimulatedH | SimulatedRegions | SimulatedFrames | SimulationForecast, ...]


def register(app: typer.Typer) -> None:
    """Add ``simulate`` to the app."""
    add_task(app, task_set("simulate"), show)


def show(made: Made) -> None:
    """Print what was simulated, or what would be."""
    from lfcal.tasks import SimulatedFrames, SimulatedH, SimulatedRegions

    for one in made:
        if isinstance(one, SimulatedRegions):
            for region in one.regions.values():
                _show_reached(region)
        elif isinstance(one, SimulatedH):
            _show_reached(one)
        elif not isinstance(one, SimulatedFrames):
            _show_forecast(one)
            continue
        facts = one.to_dict()
        typer.echo(f"written: {facts['path']} ({facts['what']})")


def _show_reached(made: SimulatedH) -> None:
    """Print what the planes reached: what is left out, as estimated, and the computation, as some positions show."""
    from lfcal.cli._console import report

    lowest, highest = 100 * min(made.errors), 100 * max(made.errors)
    reached = f"{highest:.2g} %" if highest < 1.1 * lowest else f"{lowest:.2g} to {highest:.2g} %"
    what = "with that of storage" if made.stored is not None else "of what is left out and of the computation"
    report(f"error {what}: {reached} ({100 * made.limit:.3g} % asked for)")
    least, most = 100 * min(made.light), 100 * max(made.light)
    report(f"light in the cutout: {least:.3g}" + ("" if most - least < 0.1 else f" to {most:.3g}") + " %")


def _show_forecast(forecast: SimulationForecast) -> None:
    from lfcal.base import format_seconds
    from lfcal.cli._console import print_table

    found = forecast.effects
    rows = [["on" if row.on else "off", row.effect.title, row.reason] for row in found.rows]
    title = f"effects for a tolerance of {100 * found.tolerance:g} %, level {found.level}"
    print_table(["", "effect", "why"], rows, title=title)
    typer.echo(
        f"whole H: about {format_seconds(found.seconds)} of processor time (ideal camera: "
        f"{format_seconds(found.ideal_seconds)})"
    )
