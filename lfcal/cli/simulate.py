"""``lfcal simulate``: H of a described camera, or the frames of a simulated session."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lfcal.base import InputError, check_number
from lfcal.cli._completing import complete_camera
from lfcal.cli._console import print_json, print_table, report, run_work
from lfcal.cli._options import (
    CutoutOption,
    DepthsOption,
    ExecutorOption,
    ForceOption,
    JsonOption,
    ResumeOption,
    SchedulerOption,
    StoreToleranceOption,
    VirtualDepthsOption,
    WorkersOption,
)
from lfcal.cli._regions import make_regions
from lfcal.cli._runs import may_replace, run_choice, run_kept
from lfcal.records import read_as, read_cutout, read_depths, read_virtual_depths
from lfcal.tasks import check_output, planned_scan, ready_regions

if TYPE_CHECKING:
    from lfcal.base import Work
    from lfcal.camera import ScanPlan
    from lfcal.psf import PSFMatrix
    from lfcal.simulate import EffectSelection
    from lfcal.work import RunChoice

__all__ = ["register"]

LEAST_LIGHT = 0.9
"""Share of a plane's light below which the cutout is reported as too small."""

MOST_DRIFT = 0.5
"""Drift of the lattice against H's period over the sensor (px) above which it is reported."""


def register(app: typer.Typer) -> None:
    """Add ``simulate`` to the app."""
    app.command("simulate")(command)


def command(
    camera: str = typer.Argument(
        ..., autocompletion=complete_camera, help="Preset, camera JSON, Raytrix XML, or the JSON of a scan plan."
    ),
    depths: DepthsOption = "",
    virtual_depths: VirtualDepthsOption = "",
    cutout: CutoutOption = "",
    *,
    effects: list[str] = typer.Option(
        [],
        "--effect",
        "--effects",
        help="NAME=on, off, auto or a magnitude (coma=0.3@40deg, lenslet_gap=5um), or a JSON file; may be repeated.",
    ),
    tolerance: float = typer.Option(0.03, help="Relative L1 error allowed for what is left out."),
    level: str = typer.Option("auto", help="auto, geometric, wave, grid, microscope or reference."),
    out: Path | None = typer.Option(None, "-o", "--out", help="H file to write."),
    frames: Path | None = typer.Option(None, help="Folder for the frames of a simulated session."),
    seed: int = typer.Option(0, help="Seed of noise and stage errors in frames."),
    peak: float = typer.Option(0.8, help="Share of the full well that the brightest pixel reaches in frames."),
    workers: WorkersOption = None,
    executor: ExecutorOption = "",
    scheduler: SchedulerOption = "",
    resume: ResumeOption = False,
    progressive: bool = typer.Option(
        False,
        "--progressive",
        help="In passes: H is whole after the first and better after each; Ctrl-C keeps it.",
    ),
    store_tolerance: StoreToleranceOption = None,
    plan_only: bool = typer.Option(False, "--plan-only", help="Only show which effects matter and what they cost."),
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Simulate the PSF matrix of a camera, with the effects that matter for it and no others.

    Example: `lfcal simulate bench --virtual-depths 3,4 -o H.h5`
    """
    from lfcal.psf import check_store_tolerance
    from lfcal.simulate import effects as known
    from lfcal.simulate import plan_effects, predict_seconds
    from lfcal.simulate.effects import parse_effects

    for reason in known.CATALOGUE.failures().values():
        report(f"left out: {reason}")
    check_number("brightest pixel (share of the full well)", peak, above=0, at_most=1000)
    if out is not None and not plan_only:
        check_output(out, camera, force=may_replace(out, resume=resume, force=force))
    several = ready_regions(camera)
    if several is not None:
        if depths or virtual_depths or cutout:
            raise InputError("planes and cutout: expected those of the plan, got others; leave the options out")
        planned = several.scan
    else:
        planned = planned_scan(
            camera,
            read_as("--depths", read_depths, depths),
            read_as("--virtual-depths", read_virtual_depths, virtual_depths),
            read_as("--cutout", read_cutout, cutout),
        )
    settings, given = parse_effects(effects)
    making = frames is not None

    def choose(error: float) -> EffectSelection:
        return plan_effects(planned, error, settings, effects=given, frames=making, peak=peak)

    found = choose(tolerance)
    if plan_only:
        if level != "auto":
            found = replace(found, level=level, seconds=predict_seconds(planned, found, level, tolerance=tolerance))
        for target in (out, frames):
            if target is not None:
                report(f"note: {target} is not written: --plan-only")
        if not json:
            _tell_period(planned)
        _show(found, planned, json)
        return
    if (out is None) == (frames is None):
        raise InputError("output: give -o H.h5 for the matrix or --frames DIR for a session, or --plan-only")
    if out is not None and (seed, peak) != (0, 0.8):
        option = "--seed" if seed else "--peak"
        raise InputError.expected(option, "frames to simulate (--frames)", "an H file (-o)", "leave it out")
    if progressive and out is None:
        raise InputError("--progressive: expected a matrix, got frames; frames are made once, leave it out")
    if store_tolerance is not None:
        if progressive or out is None:
            other = "--progressive" if progressive else "--frames"
            raise InputError(f"{other}: expected no --store-tolerance, got one; leave one of them out")
        check_store_tolerance(store_tolerance)
    in_units = executor or scheduler or resume
    if in_units and (progressive or out is None):
        other = "--progressive" if progressive else "--frames"
        raise InputError(f"{other}: expected no --executor, --scheduler or --resume, got one; leave one of them out")
    if not json:
        _tell_period(planned)
    for row in found.rows:
        if row.setting == "on" and not row.on:  # what was asked for by name is not left out without a word
            report(f"note: {row.name}: {row.reason}")
    task = _Task(planned, found, level, tolerance, json, store_tolerance)
    if several is not None:
        one = {
            "--frames": frames is not None,
            "--progressive": progressive,
            "--executor": bool(in_units),
            "--store-tolerance": store_tolerance is not None,
        }
        assert out is not None or frames is not None

        def region(plan: ScanPlan, name: str, part: Path) -> dict[str, Any]:
            report(f"region {name}")
            own = plan_effects(plan, tolerance, settings, effects=given)
            return _write_h(replace(task, planned=plan, found=own), _Runner(part, "", "", workers, False, False), None)

        told = make_regions(several, out or Path(), region, one, workers=workers)
        made = {"path": out, "what": f"H of {len(several)} regions", **told}
    elif out is not None:
        runner = _Runner(out, executor, scheduler, workers, resume, force)
        made = _write_h(task, runner, choose if progressive else None)
    else:
        assert frames is not None
        made = _write_frames(task, frames, seed, peak)
    if json:
        print_json(made | {"assumed": planned.camera.marks.paths("assumed")})
    else:
        typer.echo(f"written: {made['path']} ({made['what']})")


@dataclass(frozen=True)
class _Task:
    """What is simulated, whatever becomes of it."""

    planned: ScanPlan
    found: EffectSelection
    level: str
    tolerance: float
    quiet: bool
    store_tolerance: float | None = None


def _show(found: EffectSelection, planned: ScanPlan, json: bool) -> None:
    from lfcal.base import format_seconds

    if json:
        print_json(
            {
                "level": found.level,
                "tolerance": found.tolerance,
                "seconds": found.seconds,
                "ideal_seconds": found.ideal_seconds,
                "effects": [
                    {
                        "name": r.name,
                        "on": r.on,
                        "setting": r.setting,
                        "size": r.estimate.size,
                        "unit": r.estimate.unit,
                        "error": r.estimate.error,
                        "formula": r.estimate.formula,
                        "z_um": r.z_um,
                        "seconds": r.seconds,
                        "reason": r.reason,
                    }
                    for r in found.rows
                ],
                "assumed": planned.camera.marks.paths("assumed"),
            }
        )
        return
    rows = [["on" if r.on else "off", r.effect.title, r.reason] for r in found.rows]
    title = f"effects for a tolerance of {100 * found.tolerance:g} %, level {found.level}"
    print_table(["", "effect", "why"], rows, title=title)
    typer.echo(
        f"whole H: about {format_seconds(found.seconds)} of processor time (ideal camera: "
        f"{format_seconds(found.ideal_seconds)})"
    )


@dataclass(frozen=True)
class _Runner:
    """Where H goes, and who computes it."""

    out: Path
    executor: str
    scheduler: str
    workers: int | None
    resume: bool
    force: bool

    def choice(self, seconds: float) -> RunChoice | None:
        return run_choice(
            self.out,
            self.executor,
            self.scheduler,
            self.workers,
            resume=self.resume,
            force=self.force,
            seconds=seconds,
        )


def _write_h(task: _Task, runner: _Runner, choose: Callable[[float], EffectSelection] | None) -> dict[str, Any]:
    from lfcal.base import format_bytes, format_seconds
    from lfcal.simulate import light_in_cutout, predict_seconds

    plan, out, workers = task.planned, runner.out, runner.workers
    predicted = predict_seconds(plan, task.found, task.level, tolerance=task.tolerance)
    run = None if choose is not None else runner.choice(predicted)
    # told before the work begins, while there is still time to choose a larger tolerance.
    if not task.quiet:
        most = _memory(task, run, workers)
        report(f"about {format_seconds(predicted)} of processor time ahead, at most {format_bytes(most)} of memory")
    whole: list[str] = []
    try:
        if run is not None:
            matrix = run_kept(_in_one_pass(task, out, workers, run), out, quiet=task.quiet)
        else:
            matrix = run_work(_simulation(task, out, workers, choose, whole), quiet=task.quiet)
    except BaseException:
        if whole:
            report(f"kept: {whole[-1]}")
        raise
    with matrix:
        shape = matrix.shape
        errors = [float(error) for error in matrix.facts.known()["error"]]
        light = light_in_cutout(matrix, plan, task.found)
    _tell_error(errors, task)
    _tell_light(light, task)
    return {
        "path": out,
        "what": f"H {shape}",
        "shape": shape,
        "level": task.found.level,
        "tolerance": task.tolerance,
        "error": errors,
        "light_in_cutout": light,
        "predicted_seconds": predicted,
        "effects": [e.name for e in task.found.effects],
    }


def _memory(task: _Task, run: RunChoice | None, workers: int | None) -> int:
    """Return the bytes that all planes under way take at most together."""
    from lfcal.base import worker_count
    from lfcal.simulate import predict_bytes
    from lfcal.work.executors import concurrent_memory, concurrent_units

    plan, count = task.planned, worker_count(workers)

    def plane(threads: int) -> int:
        tolerance = task.tolerance
        most = predict_bytes(plan, task.found, task.level, tolerance=tolerance, to_file=True, workers=threads)
        # in steps, and as it is read back
        more = 0 if task.store_tolerance is None else math.prod(plan.shape[1:]) * 6
        return most + more

    if run is None:
        return plane(count)
    one = plane(1)  # each has engines of its own
    if run.executor != "threads":
        return count * one
    beside = concurrent_units([one] * len(plan.depths_um), count, concurrent_memory())
    return beside * one if beside > 1 else plane(count)


def _simulation(
    task: _Task, out: Path, workers: int | None, choose: Callable[[float], EffectSelection] | None, whole: list[str]
) -> Work[Any]:
    """Return the work of writing H: in one go, or in passes, which note in ``whole`` what they have written."""
    from lfcal.simulate import iter_refine_psf

    if choose is None:
        return _in_one_pass(task, out, workers, None)
    plan = task.planned

    def tell(matrix: PSFMatrix) -> None:
        worst = 100 * max(float(error) for error in matrix.facts.known()["error"])
        whole.append(f"{out}, whole within {worst:.2g} %")
        if not task.quiet:
            report(f"{whole[-1]}; Ctrl-C keeps it")

    return iter_refine_psf(
        plan,
        choose,
        task.level,
        on_pass=tell,
        tolerance=task.tolerance,
        out=out,
        workers=workers,
        provenance={"plan": plan.to_dict()},
    )


def _in_one_pass(task: _Task, out: Path, workers: int | None, run: RunChoice | None) -> Work[Any]:
    """Return the work of writing H; with a ``run`` planes stay in files until all are there."""
    from lfcal.simulate import iter_simulate_psf

    plan = task.planned
    return iter_simulate_psf(
        plan,
        task.found,
        task.level,
        tolerance=task.tolerance,
        out=out,
        workers=workers,
        provenance={"plan": plan.to_dict()},
        store_tolerance=task.store_tolerance,
        run=run,
    )


def _tell_error(errors: Sequence[float], task: _Task) -> None:
    """Say what every plane reached: what is left out, as estimated, and the computation, as a few positions show."""
    limit = task.tolerance + (task.store_tolerance or 0)
    asked = f"{100 * limit:.3g} % asked for"
    over = [z for z, error in enumerate(errors) if error > limit]
    if not task.quiet:
        lowest, highest = 100 * min(errors), 100 * max(errors)
        reached = f"{highest:.2g} %" if highest < 1.1 * lowest else f"{lowest:.2g} to {highest:.2g} %"
        what = "of what is left out and of the computation" if task.store_tolerance is None else "with that of storage"
        report(f"error {what}: {reached} ({asked})")
    if over:
        worst = max(over, key=lambda z: errors[z])
        more = "nothing finer is computed" if task.level == "auto" else "--level auto takes what they need"
        report(
            f"warning: {len(over)} of {len(errors)} planes miss the {asked}; plane {worst} at "
            f"{task.planned.depths_um[worst]:g} µm reaches {100 * errors[worst]:.2g} %; {more}"
        )


def _tell_light(light: Sequence[float], task: _Task) -> None:
    """Report the share of the light that the cutout holds; warn of planes of which it holds too little."""
    low = [z for z, share in enumerate(light) if share < LEAST_LIGHT]
    if not task.quiet:
        least, most = 100 * min(light), 100 * max(light)
        report(f"light in the cutout: {least:.3g}" + ("" if most - least < 0.1 else f" to {most:.3g}") + " %")
    if low:
        worst = min(low, key=lambda z: light[z])
        nt, ns = task.planned.cutout
        report(
            f"warning: the cutout of {nt} x {ns} px holds less than {100 * LEAST_LIGHT:g} % of the light in "
            f"{len(low)} of {len(light)} planes; plane {worst} at {task.planned.depths_um[worst]:g} µm has "
            f"{100 * light[worst]:.3g} %; choose a larger --cutout"
        )


def _tell_period(plan: ScanPlan) -> None:
    """Report where the period of H does not keep step with the lattice over the sensor."""
    if plan.resample:
        return
    sides = zip(plan.period_residual_px, plan.camera.sensor.shape, plan.period, strict=True)
    drift = max(abs(residual) * side / period for residual, side, period in sides)
    # a plan of fewer positions than a period has no period to keep step with
    if drift > MOST_DRIFT and max(map(abs, plan.period_residual_px)) <= 0.5:
        (py, px), (ny, nx) = plan.camera.period_px, plan.period
        own = f"{py * plan.cells[0]:.5g} x {px * plan.cells[1]:.5g} px"
        report(
            f"note: H's period of {ny} x {nx} px does not fit the lattice's {own}: {drift:.3g} px of drift over the "
            "sensor; `lfcal plan --resample` removes it, and `lfcal reconstruct` resamples frames to H's period"
        )


def _write_frames(task: _Task, folder: Path, seed: int, peak: float) -> dict[str, Any]:
    from lfcal.simulate import SimulatedCamera, iter_write_session

    # frames of two sessions in one folder would be read as one.
    if folder.exists() and any(folder.iterdir()):
        raise InputError.expected(str(folder), "a new or empty folder", "one with files in it", "choose another")
    source = SimulatedCamera(task.planned, task.found, level=task.level, tolerance=task.tolerance, seed=seed, peak=peak)
    count = run_work(iter_write_session(source, folder), quiet=task.quiet)
    return {
        "path": folder,
        "what": f"{count} frames, dark and white frames, plan",
        "frames": count,
        "effects": [e.name for e in task.found.effects],
    }
