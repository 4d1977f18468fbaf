"""``python -m benchmarks retrieve``: the error of a fitted and a recorded H against the number of frames."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lfcal.cli._console import print_json, print_table
from lfcal.cli._options import ForceOption, JsonOption, WorkersOption

if TYPE_CHECKING:
    from lfcal.camera import ScanPlan

__all__ = ["register"]

COUNTS = "6,12,24,48,96"


def register(bench: typer.Typer) -> None:
    """Add ``retrieve`` to the benchmarks."""
    bench.command("retrieve")(command)


@dataclass(frozen=True)
class Reached:
    """Result for a number of frames.

    Attributes
    ----------
    frames
        Number of recorded frames.
    seconds
        Processor time of the fit (s); 0 for a recorded H.
    errors
        Relative L1 error of H for each camera.
    """

    frames: int
    seconds: float
    errors: tuple[float, ...]

    @property
    def median(self) -> float:
        """Median over the cameras."""
        import numpy as np

        return float(np.median(self.errors))


def command(
    camera: str = typer.Argument("bench", help="bench or r29."),
    *,
    counts: str = typer.Option(COUNTS, "--counts", help="Numbers of recorded patterns: A,B,C."),
    cameras: int = typer.Option(3, min=1, help="Number of random cameras for each number of patterns."),
    positions: int = typer.Option(30, min=1, help="Positions per plane at which H is judged."),
    cutout: int = typer.Option(0, min=0, help="Side of the patterns (px); 0: default of the camera."),
    per_frame: float = typer.Option(2.0, "--per-frame", min=0.001, help="Time of stage and exposure for a frame (s)."),
    seed: int = typer.Option(0, help="Seed of the first camera."),
    chart: Path | None = typer.Option(
        None, "--chart", help="File for a plot of the error against frames, stage time and processor time (.png)."
    ),
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Fit random cameras to few and many noisy patterns, and compare the fitted H with that of a whole scan.

    Example: `python -m benchmarks retrieve --chart frames.png`
    """
    from benchmarks._fit_cameras import CUTOUTS, described_plan
    from lfcal.base.checks import check_choice
    from lfcal.tasks import check_output

    check_choice("camera", camera, tuple(CUTOUTS))
    if chart is not None:
        check_output(chart, force=force)
    numbers = _numbers(counts)
    plan, seeds = described_plan(camera, cutout=cutout or None), range(seed, seed + cameras)
    fitted = []
    for count in numbers:
        fitted.append(_fitted(plan, count, seeds, positions, workers))
        if not json:
            typer.echo(f"{count} patterns: error of H {100 * fitted[-1].median:.2f} %, {fitted[-1].seconds:.0f} s")
    whole = _recorded(plan, seeds, positions)
    if chart is not None:
        _draw(chart, fitted, whole, camera, per_frame)
    named = [("fitted", one) for one in fitted] + [("recorded, every position", whole)]
    if json:
        print_json({"fitted": [vars(one) for one in fitted], "recorded": vars(whole)})
        return
    rows = [_row(name, one, per_frame) for name, one in named]
    print_table(
        ["H", "frames", "minutes", "processor s", "error, median", "worst"], rows, title=f"{camera}, two depths"
    )


def _row(name: str, one: Reached, per_frame: float) -> list[str]:
    errors = [f"{100 * value:.2f} %" for value in (one.median, max(one.errors))]
    return [name, f"{one.frames}", f"{one.frames * per_frame / 60:.2g}", f"{one.seconds:.0f}", *errors]


def _numbers(text: str) -> list[int]:
    from lfcal.base.errors import InputError

    try:
        found = sorted({int(part) for part in text.split(",")})
    except ValueError:
        found = []
    if not found or found[0] < 3:
        raise InputError.expected("--counts", "whole numbers of at least 3", repr(text), "for example 6,24,96")
    return found


def _fitted(plan: ScanPlan, count: int, seeds: range, positions: int, workers: int | None) -> Reached:
    """Return the result of fits to ``count`` patterns."""
    import numpy as np

    from benchmarks._fit_cameras import random_truth, recorded
    from benchmarks.fit import measured_error
    from lfcal.fit import fit_camera

    errors, seconds = [], []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        truth = random_truth(plan, rng)
        measured = recorded(truth, count, rng)
        start = time.process_time()
        fit = fit_camera(measured, workers=workers)
        seconds.append(time.process_time() - start)
        errors.append(measured_error(fit, truth, positions)["error_l1"])
    return Reached(count, float(np.median(seconds)), tuple(errors))


def _recorded(plan: ScanPlan, seeds: range, positions: int) -> Reached:
    """Return the error of an H with one recorded frame per position."""
    import numpy as np

    from benchmarks._fit_cameras import random_truth, recorded
    from lfcal.fit.model import Fineness, predict

    errors = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        truth = random_truth(plan, rng)
        data = recorded(truth, positions * plan.shape[0], rng)
        still = np.zeros((len(data), 2))
        light = predict(truth.setup, plan, data.index, still, Fineness.finest).astype(np.float64)
        light *= (data.patterns * light).sum() / np.square(light).sum()
        errors.append(float(np.abs(data.patterns - light).sum() / light.sum()))
    return Reached(plan.n_positions, 0.0, tuple(errors))


def _draw(path: Path, fitted: list[Reached], whole: Reached, camera: str, per_frame: float) -> None:
    from lfcal.base.figures import LINES, figure, save_figure

    axes: list[tuple[str, Any]] = [
        ("recorded frames", lambda one: one.frames),
        (f"stage time (minutes), {per_frame:g} s per frame", lambda one: one.frames * per_frame / 60),
        ("processor time of the fit (s)", lambda one: one.seconds),
    ]
    with figure(9.0, 3.2) as fig:
        first = None
        for k, (label, value) in enumerate(axes):
            panel = fig.add_subplot(1, 3, k + 1, sharey=first)
            first = first or panel
            panel.plot(
                [value(o) for o in fitted], [100 * o.median for o in fitted], "o-", color=LINES[0], label="fitted"
            )
            for one in fitted:
                panel.plot([value(one)] * 2, [100 * min(one.errors), 100 * max(one.errors)], color=LINES[0], alpha=0.4)
            if k < 2:
                panel.plot(value(whole), 100 * whole.median, "s", color=LINES[1], label="recorded, every position")
                panel.legend(loc="upper right")
            panel.set_xscale("log")
            panel.set_yscale("log")
            panel.set_xlabel(label)
            if k == 0:
                panel.set_ylabel("error of H (%, relative L1)")
        fig.suptitle(f"{camera}: H of two depths, brightest pixel at 80 % of the full well", fontsize=10)
        save_figure(fig, path)
