"""``python -m benchmarks work``: time of units by executor, scaling, and a forecast for many workers."""

from __future__ import annotations

import math
import os
import statistics
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from benchmarks._folder import FolderOption
from lfcal.cli._console import print_json, print_table
from lfcal.cli._options import CameraArgument, JsonOption

if TYPE_CHECKING:
    from lfcal.camera import ScanPlan

__all__ = ["register"]

NEAR, FAR = 2.2, 6.0
"""Virtual depths of the first and the last plane."""


def register(bench: typer.Typer) -> None:
    """Add ``work`` to the benchmarks."""
    bench.command("work")(command)


@dataclass(frozen=True, slots=True)
class Forecast:
    """Forecast for workers with one thread each: number of units, bytes per unit, and wall time of all (s)."""

    workers: int
    units: int
    unit_bytes: int
    seconds: float


@dataclass(frozen=True, slots=True)
class Figures:
    """Medians over rounds, each with one run of every executor.

    Attributes
    ----------
    seconds
        Wall time by executor and number of workers (``"dask 2"``), including their start (s).
    cpu_seconds
        Processor time of all processes of the same runs, which other load hardly changes (s).
    overhead
        Time of dask divided by that of threads, minus 1, by number of workers.
    scaling
        Time with one worker divided by time with two, by executor.
    forecast
        Forecast for many workers.
    """

    seconds: dict[str, float]
    cpu_seconds: dict[str, float]
    overhead: dict[str, float]
    scaling: dict[str, float]
    forecast: Forecast


def command(
    camera: CameraArgument = "bench",
    *,
    planes: int = typer.Option(101, min=2, help="Number of planes; each is a unit."),
    rows: int = typer.Option(0, min=0, help="Number of simulated rows of positions; 0: all."),
    cutout: int = typer.Option(61, min=3, help="Side of the cutout (px), odd."),
    tolerance: float = typer.Option(0.03, help="Requested relative L1 error."),
    executors: str = typer.Option("threads,processes,dask", "--executors", help="Executors: A,B,C."),
    rounds: int = typer.Option(3, min=1, help="Number of rounds, each with one run of every executor; medians count."),
    many: int = typer.Option(64, "--many", min=1, help="Number of workers of the forecast."),
    folder: FolderOption = None,
    json: JsonOption = False,
) -> None:
    """Simulate an H in units with every executor and one or two workers; report times, overhead and scaling.

    Example: `python -m benchmarks work bench --planes 101`
    """
    from lfcal.camera import ScanPlan
    from lfcal.tasks import load_camera
    from lfcal.work import EXECUTORS

    chosen = [EXECUTORS.get(name.strip()).name for name in executors.split(",")]
    described = load_camera(camera)
    depths = [NEAR + (FAR - NEAR) * k / (planes - 1) for k in range(planes)]
    plan = ScanPlan.for_camera(described, virtual_depths=depths, cutout=cutout | 1)
    plan = replace(plan, period=(min(rows or plan.period[0], plan.period[0]), plan.period[1]))
    with tempfile.TemporaryDirectory(prefix="lfcal_work_", dir=folder) as place:
        found = _measured(plan, tolerance, chosen, rounds, many, Path(place))
    if json:
        print_json(found)
    else:
        _show(found, plan)


def _measured(plan: ScanPlan, tolerance: float, executors: list[str], rounds: int, many: int, place: Path) -> Figures:
    from lfcal.base.progress import drain
    from lfcal.simulate import plan_effects, predict_seconds
    from lfcal.simulate.simulate import iter_simulate_psf
    from lfcal.work import RunChoice

    effects = plan_effects(plan, tolerance)
    predicted = predict_seconds(plan, effects, tolerance=tolerance)

    def once(executor: str, workers: int, scan: ScanPlan) -> tuple[float, float]:
        """Return wall time and processor time of a run (s)."""
        out, start, spent = place / f"{executor}_{workers}.h5", time.perf_counter(), _cpu_seconds()
        run = RunChoice(executor, workers)
        drain(iter_simulate_psf(scan, effects, run=run, tolerance=tolerance, out=out)).close()
        took = time.perf_counter() - start, _cpu_seconds() - spent
        out.unlink()
        return took

    # a first run compiles the kernels or reads them from the disk, so that no measured time includes this
    exposure = plan.exposure_s[0] if isinstance(plan.exposure_s, tuple) else plan.exposure_s
    first = replace(plan, depths_um=plan.depths_um[:1], exposure_s=exposure)
    for name in executors:
        once(name, 1, first)
    cases = [(name, workers) for workers in (1, 2) for name in executors]
    times: dict[tuple[str, int], list[float]] = {case: [] for case in cases}
    spent: dict[tuple[str, int], list[float]] = {case: [] for case in cases}
    for number in range(rounds):
        # in turn, in another order in each round, because other load changes over minutes
        for case in cases[number % len(cases) :] + cases[: number % len(cases)]:
            wall, cpu = once(*case, plan)
            times[case].append(wall)
            spent[case].append(cpu)

    def ratio(one: tuple[str, int], other: tuple[str, int]) -> float:
        return statistics.median(a / b for a, b in zip(times[one], times[other], strict=True))

    both = {"threads", "dask"} <= set(executors)
    unit = predicted / plan.shape[0]
    turns = math.ceil(plan.shape[0] / many)
    return Figures(
        {f"{name} {workers}": statistics.median(took) for (name, workers), took in times.items()},
        {f"{name} {workers}": statistics.median(took) for (name, workers), took in spent.items()},
        {str(n): ratio(("dask", n), ("threads", n)) - 1 for n in (1, 2)} if both else {},
        {name: ratio((name, 1), (name, 2)) for name in executors},
        Forecast(many, plan.shape[0], 4 * math.prod(plan.shape[1:]), turns * unit),
    )


def _cpu_seconds() -> float:
    """Return the processor time of this process and of its ended children (s)."""
    found = os.times()
    return found.user + found.system + found.children_user + found.children_system


def _show(found: Figures, plan: ScanPlan) -> None:
    from lfcal.base.units import format_bytes, format_seconds

    rows = [
        [
            name,
            *(format_seconds(found.seconds[f"{name} {n}"]) for n in (1, 2)),
            f"{scale:.2f}",
            *(format_seconds(found.cpu_seconds[f"{name} {n}"]) for n in (1, 2)),
        ]
        for name, scale in found.scaling.items()
    ]
    title = f"{plan.camera.name}: H {plan.shape}, {plan.shape[0]} units"
    header = ["executor", "1 worker", "2 workers", "speed-up", "processor, 1", "processor, 2"]
    print_table(header, rows, title=title)
    for workers, more in found.overhead.items():
        typer.echo(f"dask compared with threads, {workers} workers: {100 * more:+.1f} %")
    one = found.forecast
    typer.echo(
        f"{one.workers} workers by forecast: {one.units} units of {format_bytes(one.unit_bytes)}, "
        f"about {format_seconds(one.seconds)} without starting and joining"
    )
