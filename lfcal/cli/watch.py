"""``lfcal watch``: check for each frame of a series whether H is still valid."""

from __future__ import annotations

import typer

from lfcal.cli._console import print_table, report
from lfcal.tasks import Watched

COLOURS = {True: typer.colors.GREEN, False: typer.colors.RED, None: typer.colors.YELLOW}


def show(made: tuple[Watched, ...]) -> None:
    """Print the drift of each frame or group of frames with its test, the trends, and the decision."""
    from lfcal.recalibrate import DRIFT_NAMES

    for one in made:
        found = one.found
        rows = []
        for mean in found.means:
            name = mean.frames[0] if len(mean.frames) == 1 else f"{mean.frames[0]} to {mean.frames[-1]}"
            values = [f"{v:+.3f} ± {s:.3f}" for v, s in zip(mean.values, mean.sigmas, strict=True)]
            worst = max(own.goodness.ratio for own in found.frames if own.name in mean.frames and own.goodness)
            rows.append([name, *values, f"{worst:.3f}", f"{mean.t_squared:.1f}", "above" if mean.alarm else ""])
        threshold = f"threshold {found.threshold:.1f}"
        print_table(["frame", *DRIFT_NAMES.values(), "goodness of fit", "T²", threshold], rows)
        for frame in found.frames:
            if frame.problem:
                report(f"note: left out: {frame.name}: {frame.problem.removeprefix(f'{frame.name}, ')}")
        if found.trends:
            slopes = [f"{own.slope:+.2g} ± {own.sigma:.1g}" + " *" * own.significant for own in found.trends]
            print_table(["trend", *DRIFT_NAMES.values()], [[f"per {found.trends[0].per}", *slopes]])
        typer.secho(found.verdict, fg=COLOURS[found.holds], bold=True)
        report(f"note: {found.basis}")
        if one.recalibration is not None:
            accepted = one.recalibration.accepted
            typer.secho(one.recalibration.verdict, fg=typer.colors.GREEN if accepted else typer.colors.RED, bold=True)
            for words in one.recalibration.notes:
                report(f"note: {words}")
        if one.files:
            folder = one.files[0].parent
            typer.echo(f"{folder}: {', '.join(str(path.relative_to(folder)) for path in one.files)}")
