"""``python -m benchmarks fit``: random cameras fitted to a few noisy patterns, judged at every position."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import typer

from lfcal.cli._console import print_json, print_table
from lfcal.cli._options import JsonOption, WorkersOption

if TYPE_CHECKING:
    from benchmarks._fit_cameras import Truth
    from lfcal.fit import Fit

__all__ = ["judged", "measured_error", "register"]


def register(bench: typer.Typer) -> None:
    """Add ``fit`` to the benchmarks."""
    bench.command("fit")(command)


def command(
    camera: str = typer.Argument("bench", help="bench or r29."),
    *,
    cameras: int = typer.Option(3, min=1, help="Number of random cameras."),
    patterns: int = typer.Option(40, min=6, help="Number of recorded patterns per camera, over all depths."),
    depths: str = typer.Option("3,4", help="Virtual depths of the planes: A,B,C."),
    positions: int = typer.Option(0, min=0, help="Positions per plane at which the model is judged; 0: all."),
    cutout: int = typer.Option(0, min=0, help="Side of the patterns (px); 0: default of the camera."),
    stage: float = typer.Option(0.0, min=0.0, help="Rms error of the source positions (px)."),
    seed: int = typer.Option(0, help="Seed of the first camera."),
    workers: WorkersOption = None,
    json: JsonOption = False,
) -> None:
    """Fit random cameras to a few noisy patterns; report the error of H at all positions, and that of the sigmas.

    Example: `python -m benchmarks fit --cameras 10`
    """
    import numpy as np

    from benchmarks._fit_cameras import CUTOUTS, described_plan, random_truth, recorded
    from lfcal.base.checks import check_choice
    from lfcal.fit import fit_camera

    check_choice("camera", camera, tuple(CUTOUTS))
    plan, found = described_plan(camera, cutout=cutout or None, depths=_numbers(depths)), []
    for k in range(seed, seed + cameras):
        rng = np.random.default_rng(k)
        truth = random_truth(plan, rng)
        measured = recorded(truth, patterns, rng, stage_px=stage)
        start = time.process_time()
        fit = fit_camera(measured, workers=workers)
        taken = time.process_time() - start
        found.append({"seed": k, "seconds": taken, **judged(fit, truth, positions)})
        if not json:
            typer.echo(line(found[-1]))
    if json:
        print_json(found)
        return
    print_table(["over all cameras", ""], summary(found), title=f"{camera}: {cameras} cameras, {patterns} patterns")


def _numbers(text: str) -> tuple[float, ...]:
    from lfcal.base.errors import InputError

    try:
        return tuple(float(word) for word in text.split(","))
    except ValueError:
        raise InputError.expected("--depths", "numbers", repr(text), "for example 3,4") from None


def line(one: dict[str, Any]) -> str:
    """Return the results of a camera as one line."""
    return (
        f"camera {one['seed']}: error of H {100 * one['error_l1']:.2f} % (L1, worst {100 * one['worst_l1']:.2f} %), "
        f"as described {100 * one['described_l1']:.0f} %, stated {one['stated']}, chi² {one['chi2']:.3f}, "
        f"pulls {one['pull_rms']:.2f}, {one['seconds']:.0f} s; {', '.join(one['groups'])}"
    )


def summary(found: list[dict[str, Any]]) -> list[list[str]]:
    """Return the rows of the table over all cameras."""
    import numpy as np

    worst = np.array([one["error_l1"] for one in found])
    pulls = np.concatenate([list(one["pulls"].values()) for one in found])
    return [
        ["error of H at most 0.5 %", f"{int((worst <= 0.005).sum())} of {len(found)}"],
        ["median, worst error of H (L1)", f"{100 * np.median(worst):.2f} %, {100 * worst.max():.2f} %"],
        ["pulls, rms", f"{np.sqrt((pulls**2).mean()):.2f} ({pulls.size} unknowns)"],
        ["beyond 3 sigma", f"{int((np.abs(pulls) > 3).sum())}"],
        ["processor time, median", f"{np.median([one['seconds'] for one in found]):.0f} s"],
    ]


def judged(fit: Fit, truth: Truth, positions: int = 0) -> dict[str, Any]:
    """Return errors of the fitted H relative to the true one, and the pulls of the fitted values."""
    whole = measured_error(fit, truth, positions)
    pulls = {n: (p.value - truth.values[n]) / p.sigma for n, p in fit.parameters.items()}
    return {
        **whole,
        "stated": str(fit.held_out_error),
        "chi2": fit.chi2,
        "complete": fit.complete,
        "groups": list(fit.groups),
        "pulls": pulls,
        "pull_rms": (sum(v * v for v in pulls.values()) / len(pulls)) ** 0.5,
    }


def measured_error(fit: Fit, truth: Truth, positions: int = 0) -> dict[str, float]:
    """Return relative errors of the model over ``positions`` of each plane (0: all): L1, L2, worst pattern.

    Model and truth are computed with the finest sampling. The gain of each plane is fitted, as in a normalised H.
    """
    import numpy as np

    from lfcal.fit.model import Fineness, predict
    from lfcal.fit.setup import Setup, described_effects
    from lfcal.fit.spread import spread_out

    plan = truth.plan
    every = np.argwhere(np.ones(plan.shape[:3], np.bool_))
    at = every if positions == 0 else every[spread_out(every, positions * plan.shape[0], plan.period)]
    still = np.zeros((len(at), 2))
    described = Setup(plan.camera, described_effects(plan.camera), (0.0,) * plan.shape[0])
    wanted, found, plain = (
        predict(setup, plan, at, still, Fineness.finest).reshape(len(at), -1).astype(np.float64)
        for setup in (truth.setup, fit.ideal_places, described)
    )
    for one in (found, plain):
        for z in range(plan.shape[0]):
            own = at[:, 0] == z
            one[own] *= (one[own] * wanted[own]).sum() / np.square(one[own]).sum()
    off = np.abs(found - wanted)
    return {
        "error_l1": float(off.sum() / wanted.sum()),
        "error_l2": float(np.sqrt(np.square(off).sum() / np.square(wanted).sum())),
        "worst_l1": float((off.sum(1) / wanted.sum(1)).max()),
        "described_l1": float(np.abs(plain - wanted).sum() / wanted.sum()),
    }
