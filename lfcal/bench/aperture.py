"""``lfcal bench aperture``: iris recovery on synthetic depth-plane sums, by curvature and noise."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from dataclasses import dataclass

import typer

from lfcal.cli.options import JsonOption

BLADES = (5, 6, 7, 8, 9, 10, 11)
CURVATURES = (0.0, 0.3, 0.6)
SNRS = (0.5, 1.0, 2.0, 5.0, 20.0)


def register(bench: typer.Typer) -> None:
    """Add ``aperture`` to the benchmarks."""
    bench.command("aperture")(command)


@dataclass(frozen=True, slots=True)
class Trial:
    """One synthetic iris."""

    blades: int
    curvature: float
    snr: float
    number: int
    side: int


@dataclass(frozen=True, slots=True)
class Outcome:
    """What the fit made of it: errors in pixels, degrees and per cent; seconds."""

    trial: Trial
    right: bool
    confident: bool
    centre_px: float
    rotation_deg: float
    area_percent: float
    curvature: float
    seconds: float


def trials(per_cell: int, side: int) -> list[Trial]:
    """Return ``per_cell`` trials for each blade count, curvature and SNR: 840 for 8."""
    cells = ((n, k, s) for n in BLADES for k in CURVATURES for s in SNRS)
    return [Trial(n, k, s, t, side) for n, k, s in cells for t in range(per_cell)]


def run(trial: Trial) -> Outcome:
    """Return the outcome of one trial; its random numbers depend on the trial alone."""
    import numpy as np

    from lfcal.psf.aperture import fit_aperture
    from lfcal.psf.aperture.synthetic import Disturbance, depth_sum_of

    seed = [trial.blades, round(100 * trial.curvature), round(100 * trial.snr), trial.number, trial.side]
    rng = np.random.default_rng(seed)
    image, truth = depth_sum_of(trial.side, trial.blades, trial.curvature, Disturbance(noise=1 / trial.snr), rng)
    start = time.perf_counter()
    found = fit_aperture(image)
    seconds = time.perf_counter() - start
    step = 2 * math.pi / trial.blades
    turn = (found.rotation_rad - truth.rotation_rad + step / 2) % step - step / 2
    return Outcome(
        trial,
        found.blades == trial.blades,
        found.confident,
        math.dist(found.centre, truth.centre),
        math.degrees(abs(turn)),
        100 * abs(found.area_px2 / truth.area_px2 - 1),
        abs(found.curvature - trial.curvature),
        seconds,
    )


def command(
    *,
    per_cell: int = typer.Option(8, "--trials", min=1, help="Trials per blade count, curvature and SNR; 8 make 840."),
    side: int = typer.Option(187, min=63, help="Side of the depth-plane sum (px)."),
    workers: int | None = typer.Option(None, help="Processes; every processor by default."),
    json: JsonOption = False,
) -> None:
    """Recover irises of 5 to 11 blades from noisy depth-plane sums and print how well it went.

    Example: `lfcal bench aperture --trials 8`
    """
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor

    from lfcal.cli.console import print_json
    from lfcal.threads import worker_count

    work = trials(per_cell, side)
    run(work[0])  # compile once, into the cache that the processes share
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(worker_count(workers), mp_context=spawn, initializer=warm_up) as pool:
        # Trials depend on their seeds alone: any number of processes gives the same result.
        outcomes = list(pool.map(run, work, chunksize=4))
    if json:
        print_json(outcomes)
    else:
        table(outcomes)


def warm_up() -> None:
    """Load everything a trial needs, so that the first one is timed like the others."""
    run(Trial(5, 0.0, 20.0, 0, 95))


def table(outcomes: list[Outcome]) -> None:
    """Print medians per curvature and SNR, then the whole."""
    from statistics import median

    from lfcal.cli.console import print_table, seconds

    rows = []
    for curvature in CURVATURES:
        for snr in SNRS:
            cell = [o for o in outcomes if (o.trial.curvature, o.trial.snr) == (curvature, snr)]
            rows.append(
                [
                    f"{curvature:g}",
                    f"{snr:g}",
                    f"{_share(o.right for o in cell):.1f} %",
                    f"{_share(o.confident for o in cell):.0f} %",
                    str(sum(o.confident and not o.right for o in cell)),
                    f"{median(o.centre_px for o in cell):.3f}",
                    f"{median(o.rotation_deg for o in cell):.2f}",
                    f"{median(o.area_percent for o in cell):.2f}",
                    f"{median(o.curvature for o in cell):.3f}",
                ]
            )
    headers = [
        "curvature",
        "pixel SNR",
        "right count",
        "confident",
        "confident, wrong",
        "centre (px)",
        "rotation (°)",
        "area (%)",
        "curvature error",
    ]
    print_table(headers, rows, title=f"{len(outcomes)} irises of 5-11 blades, medians of errors")
    wrong = sum(o.confident and not o.right for o in outcomes)
    typer.echo(f"confident and wrong: {wrong}; median time {seconds(median(o.seconds for o in outcomes))}")


def _share(flags: Iterable[bool]) -> float:
    values = list(flags)
    return 100 * sum(values) / len(values)
