"""``lfcal simulate``: simulate the PSF matrix of a camera with the effects that matter for it."""

from __future__ import annotations

import typer

from lfcal.base import format_seconds
from lfcal.cli._console import print_table, report
from lfcal.tasks import SimulatedRegions, SimulationForecast


def show(made: tuple[SimulationForecast | SimulatedRegions, ...]) -> None:
    """Print the simulation, or its forecast."""
    from lfcal.tasks import SimulationForecast

    for one in made:
        if type(one) is SimulationForecast:
            _show_forecast(one)
            continue
        for words in one.reached:
            report(words)
        for sentence in one.undescribed_words:
            report(f"{sentence}; --plan-only lists measurements that determine them")
        facts = one.to_dict()
        typer.echo(f"written: {facts['path']} ({facts['what']})")


def _show_forecast(forecast: SimulationForecast) -> None:
    found = forecast.effects
    rows = [["on" if row.on else "off", row.effect.title, row.reason] for row in found.rows]
    title = f"effects for a tolerance of {100 * found.tolerance:g} %, level {found.level}"
    print_table(["", "effect", "why"], rows, title=title)
    typer.echo(
        f"whole H: about {format_seconds(found.seconds)} of processor time (ideal camera: "
        f"{format_seconds(found.ideal_seconds)})"
    )
    missing = forecast.undescribed
    if missing.sentence:
        typer.echo(f"{missing.sentence}\nmeasurements that determine them, the cheapest first:")
        for words in missing.lines(forecast.camera):
            typer.echo(f"  {words}")
