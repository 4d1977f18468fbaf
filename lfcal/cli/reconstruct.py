"""``lfcal reconstruct``: reconstruct the volume behind a light-field frame, or those of a series, with H."""

from __future__ import annotations

import math
from typing import Any

import typer

from lfcal.base import format_bytes, format_seconds
from lfcal.cli._console import print_table, report
from lfcal.tasks import FittedFeatures, Reconstructed, ReconstructedBars, ReconstructionForecast

TESTED = (
    "In tests, 95 % intervals contained the true value for 94 to 98 % of bright voxels and 91 to 98 % of sums over "
    "regions."
)
"""Note on error bars that were computed with the tested settings."""

UNTESTED = "Intervals were tested only with 60 iterations of rl-nesterov, at least 10 replicates and a contrast of 0.9."
"""Note on error bars that were computed with other settings."""

EXACT = "H is assumed to be exact, apart from its recorded noise. If it was fitted, give the folder of the fit (--fit)."
"""Note on error bars that do not include the uncertainty of the fit of H."""


def show(made: tuple[Reconstructed | ReconstructedBars | FittedFeatures | ReconstructionForecast, ...]) -> None:
    """Print the results of reconstructions, or the forecast cost."""
    from lfcal.tasks import FittedFeatures, Reconstructed, ReconstructedBars

    for one in made:
        if isinstance(one, Reconstructed):
            for result in one.results:
                _show_volume(result, one)
        elif isinstance(one, ReconstructedBars):
            _show_bars(one)
        elif isinstance(one, FittedFeatures):
            _show_features(one)
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


def amount(value: float) -> str:
    """Return a sum of voxel values as text, such as ``107,779`` or ``0.0123``."""
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def _show_bars(made: ReconstructedBars) -> None:
    """Print the files, the sums over regions, and notes on the validity of the error bars."""
    bars = made.bars
    for note in bars.notes:
        report(f"note: {note}")
    for path in made.files:
        typer.echo(path)
    if bars.regions:
        rows = []
        for one in bars.regions:
            low, high = (amount(end) for end in one.interval(0.95))
            values = [amount(value) for value in (one.total, one.sigma, one.noise, one.h, one.object)]
            rows.append([str(one.label), *values, f"{low} to {high}"])
        columns = ["region", "sum", "sigma", "noise", "H", "object", "95 % interval"]
        print_table(columns, rows, title="sums over regions; the three parts of sigma add in quadrature")
    unknown = bars.unknown_share
    typer.echo(f"{bars.replicates} replicates; nothing is known about details of {100 * unknown:.0f} % of the voxels")
    typer.echo(TESTED if made.tested else UNTESTED)
    if not made.fitted:
        typer.echo(EXACT)


def _show_features(made: FittedFeatures) -> None:
    """Print the files, and a line for each feature."""
    for note in made.fit.notes:
        report(f"note: {note}")
    for path in made.files:
        typer.echo(path)
    rows = []
    for number, one in enumerate(made.fit.features, 1):
        feature, sigmas = one.feature, one.sigmas
        known = [
            with_sigma(value, sigmas[name])
            for name, value in (
                ("row", feature.row),
                ("column", feature.column),
                ("depth_um", one.depth_um),
                ("brightness", feature.brightness or 0.0),
                ("width", feature.width or 0.0),
            )
        ]
        rows.append([str(number), "bead" if feature.end is None else "line", *known, f"{one.chi2:.2f}"])
    columns = ["number", "kind", "row", "column", "depth (µm)", "brightness", "width", "chi2"]
    print_table(columns, rows, title="beads and lines, with standard uncertainties")
    wrong = sum(not one.fits for one in made.fit.features)
    if wrong:
        limit = made.fit.features[0].limit
        typer.echo(
            f"{wrong} without uncertainties: the frame contradicts them (chi2 above {limit:.2f}), or does not "
            "determine their position, plane or width"
        )


def with_sigma(value: float, sigma: float) -> str:
    """Return a value with its standard uncertainty, ``19.73 ± 0.02``; only the value if ``sigma`` is NaN or 0."""
    if not sigma > 0:
        return f"{value:.4g}"
    places = max(0, 1 - math.floor(math.log10(sigma)))
    return f"{value:,.{places}f} ± {sigma:,.{places}f}"


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
