"""``python -m benchmarks aperture``: synthetic sums of irises, round stops with ripple, and stuck blades."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import typer

from lfcal.cli._options import JsonOption

BLADES = (5, 6, 7, 8, 9, 10, 11)
CURVATURES = (0.0, 0.3, 0.6)
SNRS = (0.5, 1.0, 2.0, 5.0, 20.0)

RIPPLES = (0.0, 0.02, 0.04, 0.08)
PITCHES = (12.0, 20.0, 26.0, 31.0, 40.0, 55.0)
PATTERNS = ("square", "hexagonal", "random")
ROUND_SNRS = (20.0, 50.0, 100.0, 200.0, 500.0)
"""SNRs of round stops: with little noise, ripple must not be mistaken for blades."""

OUT = (-0.2, -0.08, 0.08, 0.2)
STUCK_SNR = 2.0
"""Signal divided by the noise of one pixel, as for all SNRs of this benchmark."""

FILL = {"stuck": 0.36}
"""Radius divided by the side of the image, so that a blade displaced outwards stays in the image."""


def register(bench: typer.Typer) -> None:
    """Add ``aperture`` to the benchmarks."""
    bench.command("aperture")(command)


@dataclass(frozen=True, slots=True)
class Trial:
    """One synthetic aperture: an ``iris``, a ``round`` stop with ripple, or an iris with a ``stuck`` blade.

    ``out`` is the outward displacement of the blade ``stuck``, as a fraction of the apothem.
    """

    blades: int
    curvature: float
    snr: float
    number: int
    side: int
    case: str = "iris"
    ripple: float = 0.04
    pitch_px: float = 31.0
    pattern: str = "square"
    stuck: int = -1
    out: float = 0.0


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of the fit: errors in pixels, degrees and per cent, and the time (s).

    ``right`` states whether the number of blades is correct and, for a stuck blade, whether this blade was identified.
    ``out_sigmas`` is the error of its displacement divided by the stated error.
    """

    trial: Trial
    right: bool
    confident: bool
    centre_px: float
    rotation_deg: float
    area_percent: float
    curvature: float
    seconds: float
    kind: str = ""
    out_sigmas: float = math.nan


def trials(per_cell: int, side: int) -> list[Trial]:
    """Return ``per_cell`` trials for each blade count, curvature and SNR: 840 for 8."""
    cells = ((n, k, s) for n in BLADES for k in CURVATURES for s in SNRS)
    return [Trial(n, k, s, t, side) for n, k, s in cells for t in range(per_cell)]


def round_stops(count: int, side: int) -> list[Trial]:
    """Return ``count`` round stops, with all combinations of ripple, pitch, pattern and noise in turn."""
    found = []
    for t in range(count):
        ripple, snr = RIPPLES[t % len(RIPPLES)], ROUND_SNRS[t % len(ROUND_SNRS)]
        # strides that yield all combinations
        pitch, pattern = PITCHES[(t // 4) % len(PITCHES)], PATTERNS[(t // 24) % len(PATTERNS)]
        found.append(Trial(9, 1.0, snr, t, side, "round", ripple, pitch, pattern))
    return found


def stuck_blades(count: int, side: int) -> list[Trial]:
    """Return ``count`` irises with one displaced blade."""
    found = []
    for t in range(count):
        blades, curvature = BLADES[t % len(BLADES)], CURVATURES[t // 7 % len(CURVATURES)]
        out, stuck = OUT[t % len(OUT)], t % blades
        found.append(Trial(blades, curvature, STUCK_SNR, t, side, "stuck", stuck=stuck, out=out))
    return found


def run(trial: Trial) -> Outcome:
    """Return the outcome of one trial; its random numbers depend on the trial alone."""
    import numpy as np

    from lfcal.psf.aperture import fit_aperture
    from lfcal.psf.aperture._synthetic import Disturbance, IrisFault, depth_sum_of

    seed = [trial.blades, round(100 * trial.curvature), round(100 * trial.snr), trial.number, trial.side]
    disturbance = Disturbance(1 / trial.snr, 2.0, trial.ripple, trial.pitch_px, trial.pattern)
    fault, fill = IrisFault(trial.stuck, trial.out), FILL.get(trial.case, 0.42)
    image, truth = depth_sum_of(
        trial.side, trial.blades, trial.curvature, disturbance, np.random.default_rng(seed), fill=fill, fault=fault
    )
    start = time.perf_counter()
    found = fit_aperture(image)
    seconds = time.perf_counter() - start
    step = 2 * math.pi / trial.blades
    turn = (found.rotation_rad - truth.rotation_rad + step / 2) % step - step / 2
    sigmas, named = math.nan, found.stuck is not None
    if found.stuck is not None and truth.stuck is not None:
        sigmas = abs(found.stuck.out_px - truth.stuck.out_px) / found.stuck.sigma_px
        away = (found.stuck.direction_rad - truth.stuck.direction_rad + math.pi) % (2 * math.pi) - math.pi
        named = abs(away) < step / 2
    return Outcome(
        trial,
        found.blades == truth.blades and (named or trial.case != "stuck"),
        found.confident,
        math.dist(found.centre, truth.centre),
        math.degrees(abs(turn)),
        100 * abs(found.area_px2 / truth.area_px2 - 1),
        abs(found.curvature - trial.curvature),
        seconds,
        found.kind,
        sigmas,
    )


def command(
    *,
    per_cell: int = typer.Option(8, "--trials", min=1, help="Trials per blade count, curvature and SNR; 8 make 840."),
    rounds: int = typer.Option(500, min=0, help="Number of round stops with ripple."),
    stuck: int = typer.Option(84, min=0, help="Number of irises with a stuck blade."),
    side: int = typer.Option(187, min=63, help="Side of the depth-plane sum (px)."),
    workers: int | None = typer.Option(None, help="Number of processes; default: every processor."),
    json: JsonOption = False,
) -> None:
    """Fit irises to noisy depth-plane sums, recognise round stops with ripple, and identify stuck blades.

    Example: `python -m benchmarks aperture --trials 8`
    """
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor

    from lfcal.base.threads import worker_count
    from lfcal.cli._console import print_json

    work = [*trials(per_cell, side), *round_stops(rounds, side), *stuck_blades(stuck, side)]
    run(work[0])  # compile once, into the cache that the processes share
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(worker_count(workers), mp_context=spawn, initializer=warm_up) as pool:
        # trials depend only on their seeds, so any number of processes gives the same result
        outcomes = list(pool.map(run, work, chunksize=4))
    if json:
        print_json(outcomes)
    else:
        table(outcomes)


def warm_up() -> None:
    """Load all modules of a trial, so that the first one is timed like the others."""
    run(Trial(5, 0.0, 20.0, 0, 95))


def table(outcomes: Sequence[Outcome]) -> None:
    """Print medians per curvature and SNR, then round stops and stuck blades, then the whole."""
    from statistics import median

    from lfcal.base.units import format_seconds as seconds

    _irises([o for o in outcomes if o.trial.case == "iris"])
    for name in ("round", "stuck"):
        cases = [o for o in outcomes if o.trial.case == name]
        if cases:
            _rounds(cases) if name == "round" else _stuck(cases)
    wrong = sum(o.confident and not o.right for o in outcomes)
    typer.echo(f"confident and wrong: {wrong}; median time {seconds(median(o.seconds for o in outcomes))}")


def _irises(outcomes: Sequence[Outcome]) -> None:
    from statistics import median

    from lfcal.cli._console import print_table

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
    print_table(headers, rows, title=f"{len(outcomes)} irises of 5 to 11 blades, median errors")
    typer.echo(f"right counts: {sum(o.right for o in outcomes)} of {len(outcomes)}")


def _rounds(outcomes: Sequence[Outcome]) -> None:
    from lfcal.cli._console import print_table

    rows = []
    for pattern in PATTERNS:
        for ripple in RIPPLES:
            cell = [o for o in outcomes if (o.trial.pattern, o.trial.ripple) == (pattern, ripple)]
            if cell:
                told = _share(o.kind == "round" for o in cell)
                wrong = sum(o.confident and o.kind != "round" for o in cell)
                rows.append([pattern, f"{100 * ripple:g} %", str(len(cell)), f"{told:.0f} %", str(wrong)])
    headers = ["ripple", "amplitude", "stops", "recognised as round", "confident, wrong"]
    pitches = f"{min(PITCHES):g} to {max(PITCHES):g} px"
    print_table(headers, rows, title=f"{len(outcomes)} round stops with ripple of {pitches}, pixel SNR 20 to 500")


def _stuck(outcomes: Sequence[Outcome]) -> None:
    from lfcal.cli._console import print_table

    rows = []
    for out in OUT:
        cell = [o for o in outcomes if o.trial.out == out]
        named = [o for o in cell if o.confident and o.right]
        if cell:
            rows.append(
                [
                    f"{100 * out:+g} %",
                    str(len(cell)),
                    f"{_share(o.confident and o.right for o in cell):.0f} %",
                    f"{_share(o.out_sigmas < 1 for o in named):.0f} %" if named else "none",
                    f"{_share(o.out_sigmas < 3 for o in named):.0f} %" if named else "none",
                    str(sum(o.confident and not o.right for o in cell)),
                ]
            )
    headers = ["displaced by", "irises", "blade named", "within its error", "within three", "confident, wrong"]
    print_table(headers, rows, title=f"{len(outcomes)} irises with a stuck blade, pixel SNR {STUCK_SNR:g}")
    typer.echo(f"stuck blades named: {_share(o.confident and o.right for o in outcomes):.0f} %")


def _share(flags: Iterable[bool]) -> float:
    values = list(flags)
    return 100 * sum(values) / len(values)
