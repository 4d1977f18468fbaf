"""``python -m benchmarks forecast``: seconds foretold against seconds taken, over depths and cutouts of a camera."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING

import typer

from lfcal.cli._console import print_json, print_table
from lfcal.cli._options import CameraArgument, JsonOption

if TYPE_CHECKING:
    from lfcal.camera import Camera, ScanPlan

__all__ = ["register"]

VIRTUAL_DEPTHS, DEPTHS_UM = (-3.0, 0.0, 1.2, 4.0, 12.0), (-25.0, 0.0, 2.0, 10.0, 50.0)
CUTOUTS = (31, 61, 121)


def register(bench: typer.Typer) -> None:
    """Add ``forecast`` to the benchmarks."""
    bench.command("forecast")(command)


def command(
    camera: CameraArgument = "bench",
    *,
    tolerance: float = typer.Option(0.03, help="Relative L1 error asked for."),
    rows: int = typer.Option(0, min=0, help="Rows of positions that are simulated; 0: all."),
    json: JsonOption = False,
) -> None:
    """Compare processor time foretold with processor time taken, at five depths and three cutouts.

    Example: `python -m benchmarks forecast r29 --rows 6`
    """
    from lfcal.tasks import load_camera

    described = load_camera(camera)
    found = [_timed(plan, tolerance) for plan in _plans(described, rows)]
    if json:
        print_json(found)
        return
    table = [
        [
            f"{one['depth_um']:g} µm",
            f"{one['cutout']} px",
            f"{one['planned']:.3g} s",
            f"{one['predicted']:.3g} s",
            f"{one['taken']:.3g} s",
            f"{one['planned'] / one['taken']:.2f}",
            f"{one['predicted'] / one['taken']:.2f}",
        ]
        for one in found
    ]
    headers = ["depth", "cutout", "by the description", "by a short run", "taken", "description/taken", "run/taken"]
    print_table(headers, table, title=f"{described.name}, tolerance {100 * tolerance:g} %")


def _plans(camera: Camera, rows: int) -> list[ScanPlan]:
    from lfcal.base.errors import LfcalError
    from lfcal.camera import MainLens, ScanPlan

    lens = isinstance(camera.optics, MainLens)
    plans = []
    for depth in VIRTUAL_DEPTHS if lens else DEPTHS_UM:
        for cutout in CUTOUTS:
            where = {"virtual_depths": [depth]} if lens else {"depths_um": [depth]}
            try:
                plan = ScanPlan.for_camera(camera, cutout=cutout, **where)  # type: ignore[arg-type]
            except LfcalError as error:  # a cutout larger than the sensor
                typer.echo(f"left out: {error}")
                continue
            plans.append(replace(plan, period=(min(rows or plan.period[0], plan.period[0]), plan.period[1])))
    return plans


def _timed(plan: ScanPlan, tolerance: float) -> dict[str, float]:
    """Return the seconds of one plane: foretold by its description, by a short run, and taken (processor time)."""
    from lfcal.simulate import plan_effects, predict_seconds, simulate_psf

    chosen = plan_effects(plan, tolerance)
    predicted = predict_seconds(plan, chosen, tolerance=tolerance)
    start = time.process_time()
    simulate_psf(plan, chosen, tolerance=tolerance)
    taken = time.process_time() - start
    where = {"depth_um": plan.depths_um[0], "cutout": plan.cutout[0]}
    return {**where, "planned": chosen.seconds, "predicted": predicted, "taken": taken}
