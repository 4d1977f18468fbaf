"""``python -m benchmarks target``: true errors of H from a few frames of many points and from a single point."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import typer

from lfcal.cli._console import print_json, print_table, run_work
from lfcal.cli._options import JsonOption, WorkersOption

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from benchmarks._target_scene import TargetScene
    from lfcal.camera import ScanPlan
    from lfcal.fit.field import FieldFit
    from lfcal.fit.measured import Measured
    from lfcal.frames.source import FrameSource

__all__ = ["Way", "compared", "register"]

UNKNOWNS = ("geometry", "focal_lengths", "iris", "wavefront", "cats_eye")


@dataclass(frozen=True)
class Way:
    """Settings of the fit: number of points, groups of unknowns, threads, and whether progress is hidden."""

    points: int = 54
    unknowns: str | tuple[str, ...] = UNKNOWNS
    workers: int | None = None
    quiet: bool = True


def register(bench: typer.Typer) -> None:
    """Add ``target`` to the benchmarks."""
    bench.command("target")(command)


def command(
    *,
    frames: int = typer.Option(30, min=1, help="Number of frames of the target for H of the centre."),
    few: int = typer.Option(3, min=1, help="Number of frames of the fit that is judged in every part of the field."),
    points: int = typer.Option(54, min=9, help="Number of points per fit, spread over the field."),
    unknowns: str = typer.Option(",".join(UNKNOWNS), help="Groups of unknowns: A,B,C, or auto."),
    seed: int = typer.Option(0, min=0, help="Seed of camera, brightness and noise."),
    as_described: bool = typer.Option(
        False, help="Use a camera that differs from its description only in its cat's eye."
    ),
    workers: WorkersOption = None,
    json: JsonOption = False,
) -> None:
    """Simulate a target in front of a camera that differs from its description, fit it, and judge H everywhere.

    The target has 12 x 12 holes of 20 µm with different brightness. It is rotated by 1 degree and tilted by 2 degrees.
    The frames contain cat's eye, distortion and all noise. The results are compared with a scan of a single point at
    the same exposure, and with a fit of the same frames modulo the period of the array.

    Example: `python -m benchmarks target`
    """
    found = compared(
        max(frames, few),
        few,
        Way(points, unknowns if unknowns == "auto" else tuple(unknowns.split(",")), workers, json),
        seed=seed,
        wrong=not as_described,
    )
    if json:
        print_json(found)
        return
    rows = [[one["what"], one["of"], one["error"], one["chi2"], one["seconds"]] for one in _rows(found)]
    head = ["method", "frames", "error of H (L1)", "chi²", "seconds"]
    print_table(head, rows, title=f"bench camera, 720 x 720 px, target of {found['holes']} holes")
    parts = [[name, _percent(one)] for name, one in found["few"]["parts"].items()]
    print_table(["part of the field", "error of H (L1)"], parts, title=f"fit of {few} frames")
    typer.echo(f"modulo the period: {found['modulo']['says']}")
    typer.echo(f"error of H before the fit (camera as described): {_percent(found['described'])}")


def compared(frames: int, few: int, way: Way | None = None, *, seed: int = 0, wrong: bool = True) -> dict[str, Any]:
    """Return errors (relative L1) and times (s) of all methods, as plain numbers."""
    from benchmarks._target_scene import target_scene

    way = way or Way()
    scene = target_scene(frames, seed, wrong=wrong)
    camera = scene.camera()
    start = time.perf_counter()
    taken = run_work(scene.iter_frames(camera, way.workers), quiet=way.quiet)
    simulated = time.perf_counter() - start
    few_of = _fitted(scene, taken[:few], way)
    centre = scene.plan.scan
    found: dict[str, Any] = {
        "holes": len(scene.plan.target.holes),
        "frames": frames,
        "few_frames": few,
        "positions": centre.period[0] * centre.period[1],
        "simulated_seconds": simulated,
        "single_error": single_error(scene, camera.single.electrons_per_unit(0)),
        "described": described_error(scene),
        "few": few_of | {"parts": _parts(scene, few_of["fit"])},
        "modulo": _modulo(scene, few_of["fit"], few_of["view"], few_of["points"], way),
    }
    found["few"]["worst"] = max(found["few"]["parts"].values())
    found["few"]["centre"] = fit_error(scene, few_of["fit"], centre)
    if frames > few:
        many = _fitted(scene, taken, way)
        found["many"] = many | {"centre": fit_error(scene, many["fit"], centre)}
    for name in ("few", "many"):
        for key in ("fit", "view", "points") if name in found else ():
            del found[name][key]
    return found


def _fitted(scene: TargetScene, frames: NDArray[np.uint16], way: Way) -> dict[str, Any]:
    """Return the fit of frames as a user runs it, with its chi² and time (s)."""
    from lfcal.campaign.point_fit import iter_fit_points
    from lfcal.campaign.points import iter_points_of
    from lfcal.fit.setup import starting_effects, with_given

    start, used = time.perf_counter(), time.process_time()
    view = scene.view(frames)
    plan = scene.plan_of(len(frames))
    points = run_work(iter_points_of(view, plan), quiet=way.quiet)
    begins = with_given(starting_effects(plan.scan), {"vignetting": "on"}, ())
    work = iter_fit_points(view, points, way.unknowns, effects=begins, most=way.points, workers=way.workers)
    fit = run_work(work, quiet=way.quiet)
    return {
        "fit": fit,
        "view": view,
        "points": points,
        "chi2": fit.first.chi2,
        "complete": fit.first.complete,
        "stated": str(fit.first.held_out_error),
        "groups": list(fit.first.groups),
        "parameters": {n: (p.value, p.sigma) for n, p in fit.first.parameters.items()},
        "seconds": time.perf_counter() - start,
        "cpu_seconds": time.process_time() - used,
    }


def _modulo(scene: TargetScene, found: FieldFit, view: FrameSource, points: Any, way: Way) -> dict[str, Any]:
    """Return the result of a fit of the same points modulo the period, which should be refused.

    ``camera_chi2`` is chi² of the camera that was fitted to the points at their true positions.
    """
    from lfcal.base.errors import InputError
    from lfcal.campaign.points import measured_modulo
    from lfcal.fit import iter_fit_camera
    from lfcal.fit.setup import starting_effects, with_given

    start = time.perf_counter()
    measured = measured_modulo(view, points, most=way.points)
    known = {"camera_chi2": _chi2_of(found, measured)}
    begins = with_given(starting_effects(scene.plan.scan), {"vignetting": "on"}, ())
    core = ("geometry", "focal_lengths", "iris")
    try:
        fit = run_work(iter_fit_camera(measured, unknowns=core, effects=begins, workers=way.workers), quiet=way.quiet)
    except InputError as error:
        return known | {"refused": True, "chi2": None, "says": str(error), "seconds": time.perf_counter() - start}
    return known | {
        "refused": not fit.complete,
        "chi2": fit.chi2,
        "says": fit.verdict,
        "seconds": time.perf_counter() - start,
    }


def _chi2_of(found: FieldFit, measured: Measured) -> float:
    """Return chi² of the fitted camera for patterns, with the best gain and background."""
    import numpy as np

    from lfcal.fit.fit import problem_of
    from lfcal.fit.model import Fineness
    from lfcal.fit.model_error import chi_square
    from lfcal.fit.normal import Local

    problem = problem_of(measured, found.setup_at(measured.plan), ("iris",), 1)
    still, start = np.zeros((len(measured), 2)), np.zeros(len(problem.vector))
    return chi_square(problem.point(start, Local(still), Fineness.fine), problem.fitted, 0).lit


def error_of(found: NDArray[np.float64], true: NDArray[np.float64]) -> float:
    """Return the relative error (L1) of patterns after fitting their common gain, because H is normalised."""
    gain = float((found * true).sum() / (found * found).sum())
    import numpy as np

    return float(np.abs(gain * found - true).sum() / np.abs(true).sum())


def fit_error(scene: TargetScene, fit: FieldFit, plan: ScanPlan) -> float:
    """Return the error of the fit's H in a region."""
    from benchmarks._target_scene import predicted

    at, true = scene.true_patterns(plan)
    own = fit.fit_at(plan)
    return error_of(predicted(own.ideal_places, own.planned, at), true)


def described_error(scene: TargetScene) -> float:
    """Return the error of H of the described camera in the centre of the field."""
    from benchmarks._target_scene import predicted
    from lfcal.fit.setup import Setup, described_effects

    plan = scene.plan.scan
    at, true = scene.true_patterns(plan)
    return error_of(predicted(Setup(plan.camera, described_effects(plan.camera), (0.0,)), plan, at), true)


def single_error(scene: TargetScene, electrons_per_unit: float) -> float:
    """Return the error of H of a scan with a single point at the same exposure: the sensor's noise alone."""
    import numpy as np

    plan = scene.plan.scan
    _, true = scene.true_patterns(plan)
    rng = np.random.default_rng(scene.seed)
    light = np.maximum(true, 0) * electrons_per_unit
    read = plan.camera.sensor.read_noise_e
    recorded = rng.poisson(light) + read * rng.standard_normal(light.shape)
    return error_of(recorded, light)


def _parts(scene: TargetScene, fit: FieldFit) -> dict[str, float]:
    """Return the error of the fit's H in the middle of every part of the field."""
    from dataclasses import replace

    found = {}
    for name, own in fit.fits.items():
        part, scan = own.planned, scene.plan.scan
        # one period in the middle of the part
        anchor = tuple(
            float(round(a + (n - p) / 2)) for a, n, p in zip(part.anchor, part.period, scan.period, strict=True)
        )
        found[name] = fit_error(scene, fit, replace(scan, anchor=(anchor[0], anchor[1])))
    return found


def _percent(value: float) -> str:
    return f"{100 * value:.2f} %"


def _rows(found: dict[str, Any]) -> list[dict[str, str]]:
    few, many, modulo = found["few"], found.get("many"), found["modulo"]
    rows = [_row(f"a single point, {found['positions']} positions", found["positions"], found["single_error"])]
    if many is not None:
        rows.append(_row("target, centre", found["frames"], many["centre"], many))
    rows.append(_row("target, centre", found["few_frames"], few["centre"], few))
    rows.append(_row("target, worst part of the field", found["few_frames"], few["worst"], few))
    rows.append(_row("the same modulo the period", found["few_frames"], None, modulo))
    return rows


def _row(what: str, frames: int, error: float | None, more: dict[str, Any] | None = None) -> dict[str, str]:
    chi2 = "" if more is None else f"{more.get('camera_chi2') or more['chi2']:.2f}"
    if more is not None and more.get("refused"):
        chi2 += ", refused"
    seconds = "" if more is None else f"{more['seconds']:.0f}"
    off = "" if error is None else _percent(error)
    return {"what": what, "of": str(frames), "error": off, "chi2": chi2, "seconds": seconds}
