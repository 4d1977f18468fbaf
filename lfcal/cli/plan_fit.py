"""``lfcal plan fit``: choose the few positions of a scan that a fit of the optics needs."""

from __future__ import annotations

import typer

from lfcal.base import format_seconds, format_share
from lfcal.cli._console import print_table, print_written, report
from lfcal.tasks import PositionsPlanned


def show(made: tuple[PositionsPlanned]) -> None:
    """Print time and expected error of H for each number of positions, and the time of the complete scan."""
    from lfcal.fit import ERRORS, Fineness

    (one,) = made
    found, whole, earlier = one.plan, one.forecast, one.earlier
    rows = [
        [str(p.positions), format_seconds(3600 * p.hours), format_share(p.error), format_share(p.spread_error)]
        for p in found.curve
    ]
    head = ["positions", "on the stage", "error of H expected", "spread evenly instead"]
    print_table(head, rows, title=f"{len(found.fitted)} positions to fit, {len(found.held_out)} held out")
    if found.start_error is not None:
        typer.echo(f"error of H in the earlier fit: {format_share(found.start_error)}")
    typer.echo(
        f"the complete scan instead: {whole.positions} positions, "
        f"{format_seconds(3600 * whole.hours)}{one.task.unread}, "
        f"{format_share(found.pattern_error)} noise in each pattern"
    )
    if earlier is not None and not earlier.complete:
        report("note: the model of the earlier fit is incomplete: more patterns do not correct it")
    floor = ERRORS[Fineness.finest]
    if found.curve[-1].error < floor:
        report(f"note: computed patterns have an error of about {format_share(floor)}, which no recording reduces")
    report("note: expected errors assume that the unknowns describe the optics; other errors of the model remain")
    print_written(*one.task.files("out"))
