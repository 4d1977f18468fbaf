"""``python -m benchmarks forecast``: forecast against measured processor time, for a camera or for random ones."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import typer

from lfcal.cli._console import print_json, print_table
from lfcal.cli._options import CameraArgument, JsonOption

if TYPE_CHECKING:
    from lfcal.camera import Camera, ScanPlan
    from lfcal.psf import PSFMatrix
    from lfcal.simulate import EffectSelection

__all__ = ["Kept", "register", "summary_rows"]

VIRTUAL_DEPTHS, DEPTHS_UM = (-3.0, 0.0, 1.2, 4.0, 12.0), (-25.0, 0.0, 2.0, 10.0, 50.0)
CUTOUTS = (31, 61, 121)

TOLERANCES = (0.3, 0.1, 0.05, 0.03, 0.01, 0.005)
"""Tolerances of random cameras, from coarse to fine."""

WIDEST = 41
"""Largest cutout of random cameras (px)."""

RISE = 1.15
"""Ratio of processor time to that of a finer tolerance above which a tolerance counts as too slow."""

REPEATS = 3
"""Number of further measurements of each of two tolerances of which the coarser one was too slow."""


def register(bench: typer.Typer) -> None:
    """Add ``forecast`` to the benchmarks."""
    bench.command("forecast")(command)


def command(
    camera: CameraArgument = "bench",
    *,
    tolerance: float = typer.Option(0.03, help="Requested relative L1 error."),
    rows: int = typer.Option(0, min=0, help="Number of simulated rows of positions; 0: all."),
    scenes: int = typer.Option(
        0, "--random", min=0, help="Number of random cameras to use instead, each with tolerances of 30 to 0.5 %."
    ),
    first: int = typer.Option(0, min=0, help="Number of the first random camera."),
    json: JsonOption = False,
) -> None:
    """Compare forecast with measured processor time, at five depths and three cutouts, or for random cameras.

    Example: `python -m benchmarks forecast r29 --rows 6`, or `python -m benchmarks forecast --random 20`
    """
    from lfcal.tasks import load_camera

    if scenes:
        measured = [one for number in range(first, first + scenes) for one in _scene(number)]
        if json:
            print_json(measured)
        else:
            title = f"{scenes} random planes at {len(TOLERANCES)} tolerances"
            print_table(["condition", "share"], summary_rows(measured), title=title)
        return

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
    headers = ["depth", "cutout", "from the description", "by a short run", "taken", "description/taken", "run/taken"]
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
    """Return the processor time of one plane (s): forecast from the description and by a short run, and measured."""
    from lfcal.simulate import plan_effects, predict_seconds, simulate_psf

    chosen = plan_effects(plan, tolerance)
    predicted = predict_seconds(plan, chosen, tolerance=tolerance)
    start = time.process_time()
    simulate_psf(plan, chosen, tolerance=tolerance)
    taken = time.process_time() - start
    where = {"depth_um": plan.depths_um[0], "cutout": plan.cutout[0]}
    return {**where, "planned": chosen.seconds, "predicted": predicted, "taken": taken}


# -- random cameras --------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Kept:
    """A random plane at one tolerance.

    Attributes
    ----------
    scene
        Number of the random camera.
    tolerance, error
        Relative L1 error requested, and that of a few positions compared with the reference.
    planned, taken
        CPU-seconds forecast from the description, and measured without any tables of earlier simulations.
    predicted, repeated
        CPU-seconds forecast by a short run, and measured after it, with the tables that scenes share.
    engine
        Engine that ran.
    """

    scene: int
    tolerance: float
    error: float
    planned: float
    predicted: float
    taken: float
    repeated: float
    engine: str


def _scene(number: int) -> Iterator[Kept]:
    """Measure a random plane at all tolerances, from fine to coarse."""
    import numpy as np

    from benchmarks._effect_scenes import random_plan
    from benchmarks.effects import difference, finest, other_positions
    from lfcal.base.errors import LfcalError
    from lfcal.simulate import plan_effects, predict_seconds

    plan, _ = random_plan(number)
    plan = replace(plan, cutout=(min(plan.cutout[0], WIDEST), min(plan.cutout[1], WIDEST)))
    ys, xs = other_positions(plan)
    # one wavelength: the time is proportional to their number
    off = {"bandwidth": "off"}
    try:
        truth = finest(plan, plan_effects(plan, 1e-9, off).effects, ys, xs)
    except LfcalError as reason:
        typer.echo(f"left out: camera {number}: {reason}", err=True)
        return
    found: list[Kept] = []
    for tolerance in reversed(TOLERANCES):
        chosen = plan_effects(plan, tolerance, off)
        _forget_tables()
        taken, H, engine = _simulated(plan, chosen, tolerance)
        predicted = predict_seconds(plan, chosen, tolerance=tolerance)
        repeated = _simulated(plan, chosen, tolerance)[0]
        error = difference(np.stack([[H[0, y, x] for x in xs] for y in ys]), truth)
        found.append(Kept(number, tolerance, error, chosen.seconds, predicted, taken, repeated, engine))
        _repeat(plan, off, found)
    yield from found


def _repeat(plan: ScanPlan, settings: dict[str, str], found: list[Kept]) -> None:
    """Measure the last tolerance and the fastest finer one again, in turn, if the last one was slower.

    Other programs may have interfered. For both tolerances, the shortest time counts.
    """
    from lfcal.simulate import plan_effects

    last, fastest = len(found) - 1, min(range(len(found)), key=lambda k: found[k].taken)
    for k in REPEATS * (last, fastest) if found[last].taken > RISE * found[fastest].taken else ():
        chosen = plan_effects(plan, found[k].tolerance, settings)
        _forget_tables()
        taken = _simulated(plan, chosen, found[k].tolerance)[0]
        found[k] = replace(found[k], taken=min(found[k].taken, taken))


def _forget_tables() -> None:
    """Discard the tables of lenslets that simulations of one process share."""
    from lfcal.simulate.engines import masks

    for made in vars(masks).values():
        if clear := getattr(made, "cache_clear", None):
            clear()


def _simulated(plan: ScanPlan, chosen: EffectSelection, tolerance: float) -> tuple[float, PSFMatrix, str]:
    """Return the CPU-seconds of one plane, its H, and the engine."""
    from lfcal.simulate import simulate_psf
    from lfcal.simulate.accuracy.forecast import engine_clock

    start = engine_clock()
    H = simulate_psf(plan, chosen, tolerance=tolerance, workers=1)
    return engine_clock() - start, H, H.provenance["simulated"]["planes"][0]["engine"]


def summary_rows(found: Sequence[Kept]) -> list[list[str]]:
    """Return each condition with the share of the random planes and tolerances that meet it."""
    pairs = [(a, b) for a in found for b in found if a.scene == b.scene and a.tolerance > b.tolerance]
    slow = {(a.scene, a.tolerance) for a, b in pairs if a.taken > RISE * b.taken}
    coarse = {(a.scene, a.tolerance) for a, _ in pairs}

    def within(factor: float, forecast: str, measured: str) -> str:
        ratios = [getattr(one, forecast) / getattr(one, measured) for one in found]
        return _share(sum(1 / factor <= ratio <= factor for ratio in ratios), len(ratios))

    return [
        ["slower than a finer tolerance by more than 15 %", _share(len(slow), len(coarse))],
        ["error within the tolerance", _share(sum(one.error <= one.tolerance for one in found), len(found))],
        ["forecast from the description within a factor of 1.5", within(1.5, "planned", "taken")],
        ["forecast from the description within a factor of 2.5", within(2.5, "planned", "taken")],
        ["forecast by a short run within a factor of 1.5", within(1.5, "predicted", "repeated")],
        ["forecast by a short run within a factor of 2.5", within(2.5, "predicted", "repeated")],
    ]


def _share(count: int, total: int) -> str:
    return f"{100 * count / max(total, 1):.1f} % ({count} of {total})"
