"""``lfcal fit`` of frames of a target: one camera from many points, each where it is on the sensor."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from lfcal.frames import CorrectionRecipe
    from lfcal.simulate.effects import Effect
    from lfcal.targets import TargetPlan

__all__ = ["fit_target"]


def fit_target(
    source: Path,
    plan: TargetPlan,
    recipe: CorrectionRecipe,
    groups: str | tuple[str, ...],
    effects: tuple[dict[str, str], Sequence[Effect]] | None,
    out: Path,
    *,
    regions: str,
    most: int | None,
    with_h: bool,
    workers: int | None,
    json: bool,
) -> None:
    """Fit one camera to the points of a target's frames, and write it with H of its region, or of ``regions``."""
    from lfcal.camera import RegionPlan, parse_regions
    from lfcal.campaign import MOST, hole_words, iter_fit_points, iter_write_points, target_facts
    from lfcal.cli._console import print_json, print_table, report, run_work
    from lfcal.cli._target_frames import found_points
    from lfcal.fit import fit_dict, starting_effects, with_given
    from lfcal.tasks import opened_target

    field = RegionPlan.spread(plan.scan, parse_regions(regions)) if regions else plan.scan
    begins = None if effects is None else with_given(starting_effects(plan.scan), *effects)
    with opened_target(source, plan, recipe) as view:
        points = found_points(view, plan, quiet=json)
        work = iter_fit_points(
            view, points, groups, effects=begins, most=MOST if most is None else most or None, workers=workers
        )
        fit = run_work(work, quiet=json)
    known = target_facts(points)
    holes = hole_words(fit.first, asked=groups != "auto")
    written = run_work(
        iter_write_points(fit, field, out, {"source": source.name, "target": known}, with_h=with_h, workers=workers),
        quiet=json,
    )
    first = fit.first
    if json:
        chi2 = {name: {"chi2": one.here.chi_square.lit} for name, one in fit.fits.items() if one.here is not None}
        print_json(fit_dict(first) | {"source": source, "files": written, "target": known, "parts": chi2})
        return
    rows = [
        [one.name, f"{one.value:.6g}", f"{one.sigma:.2g}", f"{one.start:.6g}", one.unit]
        for one in first.parameters.values()
    ]
    print_table(["parameter", "found", "±", "described", "unit"], rows)
    parts = [
        [name, str(len(one.residuals)), str(one.here.error), f"{one.here.chi_square.lit:.3f}"]
        for name, one in fit.fits.items()
        if one.here is not None
    ]
    print_table(["part of the field", "points", "error of the model", "χ²"], parts)
    typer.secho(first.verdict, fg=typer.colors.GREEN if first.complete else typer.colors.RED, bold=True)
    if holes:
        report(f"note: {holes}")
    for combination in first.unidentified:
        report(f"note: these points do not tell apart: {combination}")
    typer.echo(f"{out}: {', '.join(str(path.relative_to(out)) for path in written)}")
