"""``lfcal reconstruct``: light-field frames to volumes."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lfcal.cli._completing import complete_solver
from lfcal.cli._options import (
    ExecutorOption,
    ForceOption,
    JsonOption,
    MatOrderOption,
    ResumeOption,
    SchedulerOption,
    WorkersOption,
)
from lfcal.cli._reconstruct_frames import Cleaner, FrameFile, cleaner, frames_of, placed_anchor
from lfcal.cli._runs import may_replace, run_choice, run_kept

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lfcal.cli._reconstruct_saving import Save, Saved
    from lfcal.cli._reconstruct_units import Settings
    from lfcal.reconstruct import FrameResult, Projector, Reconstruction, Resampling, SolverChoice
    from lfcal.work import RunChoice


MOST_MEMORY = 1e6
"""Of ``--memory`` (GB): more than any machine has."""


def register(app: typer.Typer) -> None:
    """Add ``reconstruct`` to the app."""
    app.command("reconstruct")(command)


def command(
    psf: Path = typer.Argument(help="H file (.h5), or one of another code (.mat, .npy)."),
    frame: Path | None = typer.Argument(None, help="Light-field frame; leave out with --batch."),
    *,
    out: Path | None = typer.Option(
        None,
        "--out",
        "-o",
        help="Volume to write: .tif, .ome.tif, .ome.zarr, .h5 or .npy; of a frame file with several pages all volumes "
        "in one file (TZYX). With --batch a folder, or such a file for all.",
    ),
    batch: Path | None = typer.Option(
        None, "--batch", help="Folder of frames, a stack, or a recorded session: a time series."
    ),
    suffix: str = typer.Option(
        ".tif", "--format", help="With --batch and a folder: .tif, .ome.tif, .ome.zarr, .h5 or .npy."
    ),
    solver: str = typer.Option(
        "sieve", "--solver", autocompletion=complete_solver, help="Solver; --solver list shows all."
    ),
    iterations: str = typer.Option(
        "15",
        "--iterations",
        "-n",
        help="Iterations; auto: until pixels left out of the fit are foretold no better; auto:discrepancy: until the "
        "frame is met to within the noise that --gain and --read-noise tell.",
    ),
    goal: str = typer.Option(
        "view",
        "--goal",
        help="With --iterations auto: view, a volume to look at; measure, sums over regions, with more iterations.",
    ),
    method: str = typer.Option("auto", "--method", help="Projection: auto, polyphase, direct, sparse, reduced or fft."),
    threshold: float = typer.Option(0.0, "--threshold", help="Take entries of H below this share of the peak as 0."),
    within: float = typer.Option(
        0.0,
        "--within",
        help="Share of the light that projections may miss: 0.005 is several times quicker; 0 is exact.",
    ),
    device: str = typer.Option(
        "auto",
        "--device",
        help="Where to project: cpu; cuda, or cuda:1, with PyTorch or CuPy; auto: an accelerator where there is one.",
    ),
    dark: Path | None = typer.Option(None, "--dark", help="Dark frame, or a folder of them to average."),
    white: Path | None = typer.Option(None, "--white", help="White frame, or a folder of them to average."),
    resample: bool = typer.Option(
        False,
        "--resample",
        help="Resample frames to H's period by --lattice, else the lattice in --white, else the one H's camera states; "
        "by default where the lattice drifts by more than 0.5 px over the frame.",
    ),
    as_is: bool = typer.Option(False, "--as-is", help="Do not resample frames, however far the lattice drifts."),
    lattice: Path | None = typer.Option(None, "--lattice", help="Resample by this lattice.json of `lfcal white`."),
    anchor: str = typer.Option("", "--anchor", help="Pixel ROW,COLUMN of H's position (0, 0); H's own by default."),
    background: float = typer.Option(0.0, "--background", help="Counts of a pixel without any source."),
    read_noise: float = typer.Option(0.0, "--read-noise", help="Rms read noise (counts)."),
    gain: float | None = typer.Option(
        None,
        "--gain",
        help="Counts per photo-electron: for chi2 per pixel (default: the noise stored in H), and for --iterations "
        "auto:discrepancy (default: 1).",
    ),
    saturation: float | None = typer.Option(
        None, "--saturation", help="Leave out pixels at or above this value (counts)."
    ),
    strength: float | None = typer.Option(None, "--strength", help="Weight of the penalty (rl-tv, rl-tikhonov)."),
    subsets: int | None = typer.Option(
        None, "--subsets", help="Subsets of osem; view blocks per axis of phase-space and sieve."
    ),
    tolerance: float = typer.Option(0.0, "--tolerance", min=0, help="Stop when the relative change falls below."),
    margin: str = typer.Option(
        "auto", "--margin", help="Pixels that the volume goes on beyond the frame, for light from beside it; 0: none."
    ),
    region: list[str] | None = typer.Option(
        None,
        "--region",
        help="H of another region of the field, may be repeated: a file, a region of the H file by name, or all of its "
        "regions (all). Each voxel is seen through H of the regions around it.",
    ),
    warm: bool = typer.Option(False, "--warm", help="With --batch: start each frame from the last volume."),
    voxel: str = typer.Option(
        "",
        "--voxel",
        help="Write all planes with voxels of one size: a number of µm, or auto, the smallest of them. Behind a main "
        "lens each plane has its own; by default they are written pixel by pixel.",
    ),
    mat_order: MatOrderOption = "",
    double: bool = typer.Option(False, "--double", help="Compute in double precision."),
    memory: float | None = typer.Option(
        None, "--memory", help="Most memory of the reconstruction (GB); most of what is free by default."
    ),
    workers: WorkersOption = None,
    executor: ExecutorOption = "",
    scheduler: SchedulerOption = "",
    resume: ResumeOption = False,
    forecast: bool = typer.Option(False, "--forecast", help="Say what it will cost, and stop."),
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Reconstruct the volume behind a light-field frame, or those behind a time series, with H.

    Exit code 0: each frame has its volume; 1: a frame of several is damaged or tells nothing, and has none.

    Example: `lfcal reconstruct H.h5 frame.tif -o volume.tif --solver rl-tv --iterations 30`
    """
    from lfcal.base import InputError, check_number
    from lfcal.cli._reconstruct_forecast import show_forecast, total_seconds
    from lfcal.cli._reconstruct_grid import anchor_of, check_as_is, grid_of, view_for, wide
    from lfcal.cli._reconstruct_numbers import iterations_of, margin_of, variance_of
    from lfcal.cli._reconstruct_regions import files_of_regions, open_regions, projector_of
    from lfcal.cli._reconstruct_saving import saving, targets_of
    from lfcal.cli._reconstruct_units import Settings
    from lfcal.psf import voxel_um
    from lfcal.reconstruct import SolverChoice, room_for_projections
    from lfcal.tasks import check_mat_files, check_outputs, report_missing, report_regions

    if solver == "list":
        _list_solvers()
        return
    wanted = check_as_is(lattice, resample=resample, as_is=as_is)
    if memory is not None:
        check_number("--memory (GB)", memory, above=0, at_most=MOST_MEMORY)
    count, auto, stop = iterations_of(iterations)
    choice = SolverChoice(
        solver,
        count,
        background,
        read_noise,
        saturation,
        strength,
        subsets,
        tolerance,
        auto,
        stop=stop,
        gain=gain,
        goal=goal,
    )
    if batch is None and suffix != ".tif":
        raise InputError.expected("--format", "--batch with a folder", "one frame", "name it in --out")
    source = _source(frame, batch, wanted=out is not None or forecast)
    task = _Task(frames_of(source), choice, warm, json)
    targets = {} if forecast or out is None else targets_of(task.frames, out, suffix if batch else None)
    again = force if out is None else may_replace(out, resume=resume, force=force)
    regions = tuple(region or ())
    if regions and (resample or lattice):
        raise InputError.expected(
            "--resample" if resample else "--lattice", "H of one region", "--region", "leave one of them out"
        )
    others = files_of_regions(psf, regions)
    check_mat_files(mat_order, psf, *others)
    read = (psf, *others, source, dark, white, lattice)
    check_outputs(dict.fromkeys(targets.values()), *read, force=again)
    with ExitStack() as stack:
        matrices = open_regions(psf, regions, stack, mat_order=mat_order)
        H = matrices[0]
        if not regions:
            report_regions(psf, H, "used; --region all uses all")
        for one in matrices:
            report_missing(one)
        anchor = anchor or placed_anchor(source, H, resample=resample or lattice is not None)
        placed = bool(anchor or regions)
        view = view_for(H, task.shape, white, lattice, resample=wanted, placed=placed)
        at = anchor_of(anchor, view, H)
        shape = task.shape if view is None else view.shape
        usual = margin if margin != "auto" or "weights" in choice.solver.honours else "0"
        choice = replace(choice, margin=margin_of(usual, H, shape), noise=variance_of(H))
        task = replace(task, choice=choice)
        wider, moved = wide(shape, at, H, choice.margin)
        most = None if memory is None else int(memory * 1e9)
        room = partial(room_for_projections, (len(H), *wider), choice, 8 if double else 4, memory=most, warm=warm)
        P = projector_of(
            matrices,
            wider,
            moved,
            method,
            dtype="float64" if double else "float32",
            threshold=threshold,
            tolerance=within,
            memory_limit=room(),
            workers=workers,
            device=device,
        )
        if forecast or out is None:
            show_forecast(P, choice, len(task.frames), warm=warm, json=json)
            return
        shared = Settings(
            psf, dark, white, lattice, view is not None, anchor, method, double, threshold, within, regions, mat_order
        )
        seconds = total_seconds(P, choice, len(task.frames))
        run = run_choice(
            out, executor, scheduler, workers, resume=resume, force=force, seconds=seconds, units="frame by frame"
        )
        grid = grid_of(voxel, H, shape, at)
        volume = (len(H), *(shape if grid is None else grid.shape))
        sides = voxel_um(H) if grid is None else (grid.voxel_um, grid.voxel_um)
        named = {"regions": [one.region or Path(one.path).name for one in matrices]} if regions else {}
        times = [frame.time_s for frame in task.frames]
        saved = partial(
            saving, P, sides, targets, {"psf": psf.name, **task.details(P), **named}, volume, grid=grid, times_s=times
        )
        if run is None:
            with saved() as save:
                results = _solve(task, P, cleaner(dark, white, view), view, save)
        else:
            results = _solve_in_units(task, P, shared, out, run, saved=saved, where=(room, device))
    _show_results(P, volume, results, targets, json)
    if any(result.failed for result in results):
        raise typer.Exit(1)


@dataclass(frozen=True)
class _Task:
    """Frames by name, and how the volumes behind them are sought.

    Raises
    ------
    InputError
        If a warm start is asked of a solver that knows none.
    """

    frames: list[FrameFile]
    choice: SolverChoice
    warm: bool
    quiet: bool

    def __post_init__(self) -> None:
        from lfcal.reconstruct import check_warm

        if self.warm:
            check_warm(self.choice)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the first frame, as recorded."""
        rows, columns = self.frames[0].read().shape
        return rows, columns

    def details(self, P: Projector) -> dict[str, Any]:
        """Return what is written into the volume about how it was made."""
        anchor = tuple(at - self.choice.margin for at in P.grid.anchor)
        known = {"solver": asdict(self.choice), "method": P.method, "within": P.tolerance, "anchor": anchor}
        return known if P.device is None else {**known, "device": P.device.name}


def _solve(task: _Task, P: Projector, clean: Cleaner, view: Resampling | None, save: Save) -> tuple[FrameResult, ...]:
    """Reconstruct and save frame by frame; one volume is in memory at a time."""
    from lfcal.cli._console import report, run_work
    from lfcal.reconstruct import iter_series, run_memory

    weights = None if view is None else view.inside(task.shape)
    frames = [(frame.name, partial(_cleaned, frame, clean)) for frame in task.frames]

    def take(name: str, result: Reconstruction) -> None:
        known = {"notes": result.notes, "residual": result.history[-1].residual, "stopped": result.stopped}
        if math.isfinite(result.chi2):
            known["chi2"] = result.chi2
        save(name, result.volume, known)

    def leave(name: str) -> None:
        save(name, None, {})

    work = iter_series(P, frames, len(frames), task.choice, take, weights=weights, warm=task.warm, missing=leave)
    # the forecast goes to standard error, before the wait that it is about.
    if not task.quiet:
        report(f"{P.forecast()}; memory {run_memory(P, task.choice, warm=task.warm)}")
    if not task.choice.solver.in_parts:
        run_work(P.iter_prepare(), quiet=task.quiet)
    return run_work(work, quiet=task.quiet)


def _solve_in_units(
    task: _Task,
    P: Projector,
    shared: Settings,
    out: Path,
    run: RunChoice,
    *,
    saved: Saved,
    where: tuple[Callable[..., int], str],
) -> tuple[FrameResult, ...]:
    """Reconstruct frame by frame, each volume in a file that stays until all are there and ``saved``.

    ``where``: what gives the memory of projections where processes ``share`` it, and the device that was asked for.
    """
    from lfcal.base import InputError, worker_count
    from lfcal.cli._reconstruct_units import device_hints, frame_units, iter_collect
    from lfcal.reconstruct import check_any
    from lfcal.work import iter_made

    if task.warm and run.executor != "threads":
        raise InputError.expected("--warm", "--executor threads", run.executor, "each frame needs the one before it")
    # each process has an H of its own
    share = 1 if run.executor == "threads" else worker_count(run.workers)
    room, asked = where
    hints = {"memory": room(share=share), **device_hints(P.device, asked, share)}
    units = frame_units(task.frames, shared, task.choice, out, hints, P.recipe, warm=task.warm)
    results: list[FrameResult] = []
    names = [frame.name for frame in task.frames]
    made = iter_made(
        units,
        out,
        run,
        partial(iter_collect, names=names, saved=saved, results=results),
        title=f"volumes of {out.name}",
        joined=False,
    )
    run_kept(made, out, quiet=task.quiet)
    check_any(results)
    return tuple(results)


def _list_solvers() -> None:
    """Print every solver, and why those of other distributions could not be had."""
    from lfcal.cli._console import print_table, report
    from lfcal.reconstruct import SOLVERS

    for reason in SOLVERS.failures().values():
        report(f"left out: {reason}")
    print_table(["solver", "what it does"], [[solver.name, solver.title] for solver in SOLVERS])


def _show_results(
    P: Projector, shape: tuple[int, ...], results: tuple[FrameResult, ...], targets: dict[str, Path], json: bool
) -> None:
    from lfcal.cli._console import print_json

    if json:
        whole = len(set(targets.values())) < len(results)  # one file holds all, and a place for each
        files = [{**asdict(r), "file": None if r.failed and not whole else targets[r.name]} for r in results]
        print_json({"method": P.method, "forecast": str(P.forecast()), "volumes": files})
        return
    for result in results:
        _show(result, targets[result.name], shape)


def _source(frame: Path | None, batch: Path | None, *, wanted: bool) -> Path:
    """Return where the frames lie; raise unless there is one such place, and something is ``wanted`` of them."""
    from lfcal.base import InputError, StorageError

    source = batch or frame
    if source is None or (frame is not None and batch is not None):
        raise InputError.expected("frames", "a frame or --batch FOLDER", "none or both", "give one of them")
    if not wanted:
        raise InputError.expected("--out", "where to write", "nothing", "name a file, or a folder with --batch")
    if not source.exists():
        raise StorageError(f"{source}: no such file or folder; check the path")
    return source


def _cleaned(frame: FrameFile, clean: Cleaner) -> NDArray[Any]:
    return clean(frame.read())


def _show(result: Any, target: Path, shape: tuple[int, ...]) -> None:
    from lfcal.base import format_seconds
    from lfcal.cli._console import report

    if result.failed:
        report(f"{result.name}: no volume; {result.failed}")
        return
    for note in result.notes:
        report(f"note: {result.name}: {note}")
    took = format_seconds(result.seconds)
    fit = f"residual {result.residual:.4f}" + (f", chi2 per pixel {result.chi2:.3g}" if result.chi2 >= 0 else "")
    typer.echo(f"{target}: volume {shape}, {result.iterations} iterations in {took}, {fit}")
    if result.stopped:
        typer.echo(f"stopped: {result.stopped}")
