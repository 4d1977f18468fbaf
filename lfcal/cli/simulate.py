"""``lfcal simulate``: simulate the PSF matrix of a camera with the effects that matter for it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from lfcal.base import format_seconds
from lfcal.cli._console import print_table, report
from lfcal.tasks import SimulatedRegions, SimulationForecast

if TYPE_CHECKING:
    from lfcal.simulate import PlannedEffect


def show(made: tuple[SimulationForecast | SimulatedRegions, ...]) -> None:
    """Print the path and contents of each simulated file, with notes, or print the forecast."""
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
    rows = [["on" if row.on else "off", row.effect.title, *_times(row), row.reason] for row in found.rows]
    engines = tuple(dict.fromkeys(forecast.engines))
    names = f"engine{'s' if len(engines) > 1 else ''} {' and '.join(engines)}"
    title = f"effects for a tolerance of {100 * found.tolerance:g} %, {names}"
    print_table(["", "effect", "time with it", "without it", "why"], rows, title=title)
    typer.echo(
        f"whole H: about {format_seconds(found.seconds)} of processor time (ideal camera: "
        f"{format_seconds(found.ideal_seconds)})"
    )
    missing = forecast.undescribed
    if missing.sentence:
        typer.echo(f"{missing.sentence}\nmeasurements that determine them, the cheapest first:")
        for words in missing.lines(forecast.camera):
            typer.echo(f"  {words}")


def _times(row: PlannedEffect) -> tuple[str, str]:
    """Return the forecasts of H with and without an effect as text; empty if the effect costs no time."""
    if row.seconds_with == row.seconds_without:
        return "", ""
    return format_seconds(row.seconds_with), format_seconds(row.seconds_without)
