"""``lfcal plan --for-fit``: the few positions that a fit of the optics needs, and what to expect of them."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import typer
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.cli._console import print_json, print_table, report, run_work
from lfcal.cli._options import parse_groups
from lfcal.tasks import check_outputs

if TYPE_CHECKING:
    from lfcal.camera import Forecast, ScanPlan
    from lfcal.cli._plan_pace import Pace
    from lfcal.fit import Earlier, PositionDesign, Spread

__all__ = ["WantedPositions", "check_wanted", "half_positions", "show_chosen", "write_positions"]

FIT_FILES = ("camera.json", "effects.json", "fit.json")

BESIDE = 0.05
"""Rms of sources beside their places where no fit tells it (px)."""

TOLD, ASIDE = "tells most of the optics", "kept aside: tells how good the fit is"


@dataclass(frozen=True)
class WantedPositions:
    """Which positions are to be chosen, by the options' words."""

    count: int
    half_cell: bool
    out: Path | None
    earlier: Path | None
    unknowns: str
    full: float
    beside: float | None
    candidates: int
    draw: Path | None
    pace: Pace
    workers: int | None

    @property
    def files(self) -> list[Path]:
        """What is to be written."""
        return [path for path in (self.out, self.draw) if path is not None]


def check_wanted(wanted: WantedPositions, out: Path | None, *inputs: Path | str | None, force: bool) -> None:
    """Raise where positions are not to be chosen and options say how, or an output cannot be written."""
    if wanted.count and wanted.half_cell:
        raise InputError("--half-cell: is a whole scan of half the positions; leave it out beside --for-fit")
    given = {
        "--list": None if wanted.half_cell else wanted.out,
        "--from": wanted.earlier,
        "--unknowns": wanted.unknowns or None,
        "--beside": wanted.beside,
        "--draw": wanted.draw,
    }
    names = [name for name, value in given.items() if value is not None]
    if not wanted.count and names:
        raise InputError(f"{names[0]}: is of positions for a fit; say how many with --for-fit COUNT")
    written = [path.absolute() for path in (*wanted.files, out) if path is not None]
    if len(set(written)) < len(written):
        raise InputError.expected("outputs", "each under a name of its own", str(written[-1]), "choose other names")
    read = [] if wanted.earlier is None else [wanted.earlier / name for name in FIT_FILES]
    check_outputs(wanted.files, *inputs, *read, force=force)


def half_positions(plan: ScanPlan) -> NDArray[np.intp]:
    """Return the positions ``(n, 3)`` of a half-cell scan; raises where half of them are not enough."""
    from lfcal.camera import half_cell

    return half_cell(plan).half(plan)


def write_positions(positions: NDArray[np.intp], out: Path, *, json: bool) -> None:
    """Write the list of positions ``(n, 3)`` to record."""
    from lfcal.acquire import RedoList

    RedoList.of(positions.tolist()).write(out)
    if not json:
        typer.echo(f"written: {out}")


def show_chosen(plan: ScanPlan, wanted: WantedPositions, *, json: bool) -> dict[str, Any]:
    """Choose positions, write the list and the picture, and print the curve; return what ``--json`` prints."""
    from lfcal.acquire import RedoList
    from lfcal.fit import Expected, draw_design, iter_next_positions, read_earlier

    earlier = None if wanted.earlier is None else read_earlier(wanted.earlier)
    work = iter_next_positions(
        plan,
        wanted.count,
        groups=parse_groups(wanted.unknowns, automatic=False) if wanted.unknowns else None,
        earlier=earlier,
        expected=Expected(wanted.full, **asdict(_steadiness(wanted, earlier))),
        candidates=wanted.candidates,
        stage_um_per_s=wanted.pace.stage_um_per_s,
        workers=wanted.workers,
    )
    # a frame rate that makes no sense must not wait for the choice
    whole = wanted.pace.forecast(plan)
    found = _read_out(run_work(work, quiet=json), plan, wanted.pace)
    fitted, aside = found.fitted.tolist(), found.held_out.tolist()
    if wanted.out is not None:
        reasons = [TOLD] * len(fitted) + [ASIDE] * len(aside)
        RedoList.of([*fitted, *aside], reasons, kept_aside=aside).write(wanted.out)
    if wanted.draw is not None:
        draw_design(found, wanted.draw, whole.positions, whole.hours)
    facts = {
        "positions": found.positions,
        "kept_aside": found.held_out,
        "curve": list(found.curve),
        "pattern_error": found.pattern_error,
        "start_error": found.start_error,
        "sigmas": found.sigmas,
        "candidates": found.candidates,
        "whole_scan": {"positions": whole.positions, "hours": whole.hours, "readout_hours": whole.readout_hours},
        "files": wanted.files,
    }
    if json:
        print_json(facts)
    else:
        _show(found, whole, earlier, wanted.pace)
        for path in wanted.files:
            typer.echo(f"written: {path}")
    return facts


def _read_out(found: PositionDesign, plan: ScanPlan, pace: Pace) -> PositionDesign:
    """Return what was found with the readout of its frames in its times."""
    each = pace.reading(plan.frames_averaged)
    return replace(found, curve=tuple(replace(p, hours=p.hours + p.positions * each) for p in found.curve))


def _steadiness(wanted: WantedPositions, earlier: Earlier | None) -> Spread:
    """Return what an earlier fit found, or else what is usual; sources lie as far beside their places as is wanted."""
    from lfcal.fit import Spread

    found = Spread(BESIDE) if earlier is None else earlier.spread
    return found if wanted.beside is None else replace(found, stage_px=wanted.beside)


def _show(found: PositionDesign, whole: Forecast, earlier: Earlier | None, pace: Pace) -> None:
    from lfcal.base import format_seconds, format_share
    from lfcal.fit import ERRORS, Fineness

    rows = [
        [str(p.positions), format_seconds(3600 * p.hours), format_share(p.error), format_share(p.spread_error)]
        for p in found.curve
    ]
    head = ["positions", "on the stage", "error of H expected", "spread evenly instead"]
    print_table(head, rows, title=f"{len(found.fitted)} positions to fit, {len(found.held_out)} kept aside")
    if found.start_error is not None:
        typer.echo(f"error of H by the earlier fit: {format_share(found.start_error)}")
    typer.echo(
        f"the whole scan instead: {whole.positions} positions, {format_seconds(3600 * whole.hours)}{pace.note}, "
        f"each pattern with {format_share(found.pattern_error)} of noise"
    )
    if earlier is not None and not earlier.complete:
        report("note: the model of the earlier fit is incomplete: more patterns do not help where it does not suffice")
    floor = ERRORS[Fineness.finest]
    if found.curve[-1].error < floor:
        report(f"note: the computation of patterns itself errs by about {format_share(floor)}, whatever is recorded")
    report("note: expected errors hold where the unknowns suffice; what they do not contain stays in the model")
