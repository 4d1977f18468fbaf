"""``python -m benchmarks reconstruct``: error against time for iterations, precision, threshold and solvers."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lfcal.cli._options import JsonOption, WorkersOption

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lfcal.psf import PSFMatrix

DEPTHS = (2.2, 2.8, 3.4, 4.0, 4.6)
"""Virtual depths of the planes."""


def register(bench: typer.Typer) -> None:
    """Add ``reconstruct`` to the benchmarks."""
    bench.command("reconstruct")(command)


@dataclass(frozen=True, slots=True)
class Setting:
    """Settings of one reconstruction."""

    group: str
    name: str
    solver: str = "rl"
    method: str = "auto"
    threshold: float = 0.0
    double: bool = False
    strength: float | None = None


PLAIN = Setting("", "Richardson-Lucy")
SETTINGS = (
    PLAIN,
    Setting("method and precision", "polyphase", method="polyphase"),
    Setting("method and precision", "direct", method="direct"),
    Setting("method and precision", "float64", double=True),
    Setting("threshold of H", "threshold 1e-4", threshold=1e-4),
    Setting("threshold of H", "threshold 1e-3", threshold=1e-3),
    Setting("threshold of H", "threshold 1e-2", threshold=1e-2),
    Setting("threshold of H", "threshold 5e-2", threshold=5e-2),
    Setting("solver", "Biggs-Andrews", solver="rl-biggs"),
    Setting("solver", "Nesterov", solver="rl-nesterov"),
    Setting("solver", "ordered subsets", solver="osem"),
    Setting("solver", "phase space", solver="phase-space"),
    Setting("solver", "ISRA", solver="isra"),
    Setting("regularisation", "total variation 0.01", solver="rl-tv", strength=0.01),
    Setting("regularisation", "Tikhonov 0.1", solver="rl-tikhonov", strength=0.1),
)
"""Settings that are compared."""


@dataclass(frozen=True, slots=True)
class Curve:
    """Error and likelihood against time of one setting."""

    setting: Setting
    method: str
    setup_s: float
    iterations: tuple[int, ...]
    seconds: tuple[float, ...]
    errors: tuple[float, ...]
    likelihoods: tuple[float, ...]


def command(
    *,
    image: int = typer.Option(320, min=64, help="Side of the image (px)."),
    iterations: int = typer.Option(60, "--iterations", "-n", min=2, help="Number of iterations of each setting."),
    photons: float = typer.Option(2000.0, help="Photons in the brightest pixel."),
    phantom_name: str = typer.Option("vesicle", "--phantom", help="Test volume: points, vesicle or plume."),
    psf: Path | None = typer.Option(
        None, "--psf", help="H file; default: a simulation of the preset bench with 5 planes."
    ),
    chart: Path = typer.Option(
        Path("bench_reconstruct.png"), "--chart", help="File for a plot of the error against time (.png)."
    ),
    two_point: bool = typer.Option(
        False, "--two-point", help="Measure the two-point resolution against depth instead."
    ),
    workers: WorkersOption = None,
    json: JsonOption = False,
) -> None:
    """Reconstruct a known volume with many settings; print and draw the error against time.

    The command also compares 20 iterations of Richardson-Lucy with one per-position projection of the same volume.

    Example: `python -m benchmarks reconstruct -n 60 --chart error.png`
    """
    from lfcal.base.threads import worker_count
    from lfcal.cli._console import print_json

    count = worker_count(workers)
    H = simulated() if psf is None else _opened(psf)
    if two_point:
        show_resolution(H, image, iterations, photons, chart, json)
        return
    reference = against_reference(H, image, count)
    truth, frame = scene(H, image, photons, phantom_name, count)
    curves = [measure(setting, H, truth, frame, iterations, count) for setting in SETTINGS]
    draw(curves, chart)
    if json:
        print_json({"twenty_iterations": reference, "curves": curves, "chart": chart})
        return
    show(
        curves, reference, f"{phantom_name}, H {H.shape}, image {image} x {image}, {photons:g} photons, {count} threads"
    )
    typer.echo(f"error against time: {chart}")


def simulated() -> PSFMatrix:
    """Return the wave-optical H of the bench preset: 33 x 19 positions, cutout 61, 5 planes."""
    from lfcal.camera import ScanPlan, preset
    from lfcal.simulate.simulate import simulate_psf

    camera = preset("bench")
    plan = ScanPlan.for_camera(camera, virtual_depths=DEPTHS, cutout=61)
    return simulate_psf(plan, "auto", tolerance=0.1)


def _opened(path: Path) -> PSFMatrix:
    from lfcal.psf import open_psf

    return open_psf(path)


def against_reference(H: PSFMatrix, image: int, workers: int) -> dict[str, float]:
    """Return the times of one per-position projection of all planes and of 20 Richardson-Lucy iterations (s)."""
    import numpy as np

    from lfcal.reconstruct import Projector
    from lfcal.reconstruct.solvers.multiplicative import richardson_lucy

    shape = (image, image)
    g = np.random.default_rng(0).random((H.shape[0], *shape), np.float32)
    slow = Projector(H, shape, method="fft", workers=workers)
    start = time.perf_counter()
    f = slow.forward(g)
    one = time.perf_counter() - start
    start = time.perf_counter()
    fast = Projector(H, shape, workers=workers).prepare()
    setup = time.perf_counter() - start
    start = time.perf_counter()
    richardson_lucy(fast, f, 20)
    twenty = time.perf_counter() - start
    return {"reference_projection_s": one, "setup_s": setup, "twenty_iterations_s": twenty, "ratio": twenty / one}


def scene(H: PSFMatrix, image: int, photons: float, name: str, workers: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the true volume and its noisy image, both in photons."""
    import numpy as np

    from lfcal.reconstruct import Projector
    from lfcal.reconstruct.phantoms import phantom

    P = Projector(H, (image, image), workers=workers, dtype=np.float64)
    truth = phantom(name, P.volume_shape)
    clean = np.maximum(P.forward(truth), 0)
    # volume and image have the same scale, so that the error is in photons
    scale = photons / clean.max()
    return truth * scale, np.random.default_rng(1).poisson(clean * scale).astype(np.float64)


def measure(
    setting: Setting, H: PSFMatrix, truth: NDArray[Any], frame: NDArray[Any], iterations: int, workers: int
) -> Curve:
    """Return the error against time of one setting; the time excludes the computation of the error."""
    import numpy as np

    from lfcal.reconstruct import Projector
    from lfcal.reconstruct.phantoms import nrmse
    from lfcal.reconstruct.solvers.choice import SolverChoice, iter_reconstruct

    dtype = np.float64 if setting.double else np.float32
    start = time.perf_counter()
    P = Projector(
        H,
        (frame.shape[0], frame.shape[1]),
        method=setting.method,
        dtype=dtype,
        threshold=setting.threshold,
        workers=workers,
    ).prepare()
    setup = time.perf_counter() - start
    points = [
        (r.iteration, r.seconds, nrmse(r.state.volume, truth), r.likelihood)
        for r in iter_reconstruct(P, frame, SolverChoice(setting.solver, iterations, strength=setting.strength))
        if r.state is not None
    ]
    done, seconds, errors, likelihoods = zip(*points, strict=True)
    return Curve(setting, P.method, setup, done, seconds, errors, likelihoods)


def show(curves: list[Curve], reference: dict[str, float], title: str) -> None:
    """Print the smallest error, its time, and the time to 5 % above the smallest error of plain Richardson-Lucy."""
    from lfcal.base.units import format_seconds as seconds
    from lfcal.cli._console import print_table

    # time to the same error, because iterations of the solvers take different times
    goal = 1.05 * min(curves[0].errors)
    rows = []
    for c in curves:
        best = min(range(len(c.errors)), key=c.errors.__getitem__)
        reached = next((k for k, e in enumerate(c.errors) if e <= goal), None)
        rows.append(
            [
                c.setting.name,
                c.method,
                seconds(c.setup_s),
                seconds(c.seconds[-1] / len(c.seconds)),
                f"{c.errors[best]:.4f}",
                str(c.iterations[best]),
                seconds(c.seconds[best]),
                "—" if reached is None else seconds(c.seconds[reached]),
                f"{c.errors[-1]:.4f}",
            ]
        )
    headers = [
        "setting",
        "projection",
        "set-up",
        "per iteration",
        "smallest NRMSE",
        "at iteration",
        "after",
        f"NRMSE {goal:.3f} after",
        "NRMSE at the end",
    ]
    print_table(headers, rows, title=title)
    typer.echo(
        f"20 iterations of Richardson-Lucy: {seconds(reference['twenty_iterations_s'])}, "
        f"{reference['ratio']:.2f} times one per-position reference projection of the volume "
        f"({seconds(reference['reference_projection_s'])})"
    )


def show_resolution(H: PSFMatrix, image: int, iterations: int, photons: float, chart: Path, json: bool) -> None:
    """Print and draw the smallest distance at which two points are resolved, for each plane."""
    from lfcal.base.figures import LINES, figure, save_figure
    from lfcal.cli._console import print_json, print_table, run_work
    from lfcal.reconstruct import Projector, iter_two_point

    P = Projector(H, (image, image))
    found = run_work(iter_two_point(P, iterations=iterations, photons=photons * 100), quiet=json)
    if json:
        print_json(found)
        return
    limit = [f"{r.distance:.0f}" if r.distance < float("inf") else "none tried" for r in found]
    rows = [
        [str(r.plane), f"{r.depth_um:.1f}", d, " ".join(f"{v:.2f}" for v in r.dips)]
        for r, d in zip(found, limit, strict=True)
    ]
    print_table(["plane", "depth (µm)", "resolved from (voxels)", "dip at 2 3 4 6 8 12 16 24 voxels"], rows)
    with figure() as fig:
        axes = fig.add_subplot()
        resolved = [r for r in found if r.distance < float("inf")]
        axes.plot([r.depth_um for r in resolved], [r.distance for r in resolved], "o-", color=LINES[0])
        axes.set_xlabel("depth z (µm)")
        axes.set_ylabel("smallest resolved distance (voxels)")
        save_figure(fig, chart)
    typer.echo(f"resolution against depth: {chart}")


def draw(curves: list[Curve], chart: Path) -> None:
    """Draw the error of each setting against time with set-up: one panel per group, each with plain RL."""
    from lfcal.base.figures import LINES, figure, save_figure

    groups = list(dict.fromkeys(c.setting.group for c in curves if c.setting is not PLAIN))
    with figure(10.0, 7.0) as fig:
        panels = fig.subplots(2, 2, sharex=True, sharey=True).ravel()
        for axes, group in zip(panels, groups, strict=True):
            for k, c in enumerate(c for c in curves if c.setting is PLAIN or c.setting.group == group):
                times = [c.setup_s + s for s in c.seconds]
                colour, style = (LINES[-1], "--") if c.setting is PLAIN else (LINES[k - 1], "-")
                axes.plot(times, c.errors, style, color=colour, label=c.setting.name)
            axes.set_xscale("log")
            axes.set_title(group)
            axes.legend()
        for axes in panels[2:]:
            axes.set_xlabel("time with set-up (s)")
        for axes in panels[::2]:
            axes.set_ylabel("NRMSE relative to the true volume (1)")
        save_figure(fig, chart)
