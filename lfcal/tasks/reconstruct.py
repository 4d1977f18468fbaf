"""Light-field frames to volumes: one frame, a series, or a forecast of what they take."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from lfcal.base import InputError, StorageError, Work
from lfcal.records import (
    OWN_SOLVERS,
    SOLVER_ENDS,
    LightFieldSettings,
    ProjectionSettings,
    SieveSolver,
    SolverFields,
    Variants,
    VoxelGrid,
    one_of,
    opt,
    panel,
    record,
    required,
    solver_kind,
)
from lfcal.tasks._reconstruct_frames import (
    FrameFile,
    Save,
    Saved,
    cleaner,
    frames_of,
    is_series,
    placed_anchor,
    saving,
    targets_of,
)
from lfcal.tasks._reconstruct_optics import SharedOptics, files_of_regions, view_for, wide
from lfcal.tasks.matrices import MAT_ORDERS, check_mat_files, report_missing, with_task
from lfcal.tasks.notes import note
from lfcal.tasks.outputs import check_outputs
from lfcal.tasks.task import RunSettings, Task, TaskResult, TaskSet, may_replace

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lfcal.psf import PSFMatrix
    from lfcal.reconstruct import FrameResult, MetricGrid, Projector, Reconstruction, Resampling, SolverChoice
    from lfcal.work import RunChoice

__all__ = [
    "RECONSTRUCT",
    "Reconstruct",
    "ReconstructForecast",
    "ReconstructSeries",
    "Reconstructed",
    "ReconstructionForecast",
    "choice_of",
    "solver_settings",
]

FORMATS = (".tif", ".ome.tif", ".ome.zarr", ".h5", ".npy")

USUAL = 20
"""Iterations of a run that stops automatically, for a forecast; it may take half or twice as many."""


def _find(name: str) -> type[SolverFields]:
    """Return the record of a solver, of those of other distributions, too."""
    own = {SOLVER_KINDS.name_of(kind): kind for kind in OWN_SOLVERS}
    if name in own:
        return own[name]
    if name == "list":
        raise InputError.expected("--solver", "the name of a solver", "list", "lfcal solvers lists them")
    from lfcal.reconstruct import SOLVERS

    return solver_kind(name, SOLVERS.get(name).honours)


def _names() -> tuple[str, ...]:
    from lfcal.reconstruct import SOLVERS

    return SOLVERS.names()


SOLVER_KINDS = Variants(OWN_SOLVERS, "name", _find, _names)
"""The records of solvers."""


def solver_settings(name: str, **values: Any) -> SolverFields:
    """Return settings of a solver by its name, which may be one of another distribution.

    Parameters
    ----------
    name
        Of the solver.
    **values
        Fields of its record.

    Raises
    ------
    InputError
        If there is no such solver, or it does not use one of the values.

    Examples
    --------
    >>> from lfcal.tasks import solver_settings
    >>> print(solver_settings("rl-tv", strength=0.005).strength)
    0.005
    """
    kind = _find(name)
    known = [one.name for one in fields(kind) if one.name != "name"]
    for given in values:
        if given not in known:
            raise InputError.expected(f"solver {name}", f"settings {', '.join(known)}", given, "leave it out")
    return kind(**values)


def choice_of(settings: SolverFields, **found: Any) -> SolverChoice:
    """Return what the library is asked for; ``found`` are margin and noise of the frames."""
    from lfcal.reconstruct import SolverChoice
    from lfcal.reconstruct.solvers import MOST_ITERATIONS

    known = {one.name: getattr(settings, one.name) for one in fields(settings)}
    end = SOLVER_ENDS.get(str(settings.iterations))
    if end is not None:
        known |= {"iterations": MOST_ITERATIONS, "auto": True, "stop": end}
    return SolverChoice(**known, **found)


@dataclass(frozen=True, kw_only=True)
class Reconstructed(TaskResult):
    """Volumes that were reconstructed.

    Attributes
    ----------
    method, forecast
        Way to project, and what it was predicted to cost.
    shape
        ``(nz, Y, X)`` of a volume as it is written.
    results
        How each frame went.
    files
        File of each frame's volume, by the name of the frame.
    """

    method: str
    forecast: str
    shape: tuple[int, ...]
    results: tuple[FrameResult, ...]
    files: Mapping[str, Path]

    @property
    def failed(self) -> bool:
        """Whether a frame has no volume."""
        return any(result.failed for result in self.results)

    def to_dict(self) -> dict[str, Any]:
        """Return all of it as plain values."""
        whole = len(set(self.files.values())) < len(self.results)  # one file holds all, and a place for each
        files = [{**asdict(r), "file": None if r.failed and not whole else self.files[r.name]} for r in self.results]
        return {"method": self.method, "forecast": self.forecast, "volumes": files}


@dataclass(frozen=True, kw_only=True)
class ReconstructionForecast(TaskResult):
    """What a reconstruction will cost.

    Attributes
    ----------
    projector, choice
        Operator and solver.
    frames
        Number of frames.
    iterations
        Of each frame; of a run that stops automatically, the usual number.
    seconds
        Time of all frames, set-up included.
    memory
        Largest memory.
    """

    projector: Projector
    choice: SolverChoice
    frames: int
    iterations: int
    seconds: float
    memory: Any

    def to_dict(self) -> dict[str, Any]:
        """Return all of it as plain values."""
        found, device = self.projector.forecast(), self.projector.device
        use = found.device
        known = None if device is None or use is None else {"name": device.name, **asdict(use)}
        memory = {"memory": self.memory, "memory_bytes": self.memory.total, "seconds": self.seconds}
        return {"forecast": found.chosen, "options": found.options, "device": known, **memory}


@dataclass(frozen=True)
class _Prepared:
    """What is known once H and the first frame are open."""

    frames: list[FrameFile]
    matrices: list[PSFMatrix]
    view: Resampling | None
    optics: SharedOptics
    choice: SolverChoice
    room: Callable[..., int]
    projector: Projector

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the images, without margin."""
        rows, columns = self.projector.image_shape
        return rows - 2 * self.choice.margin, columns - 2 * self.choice.margin

    @property
    def iterations(self) -> int:
        """Those of a frame, as far as they are known beforehand."""
        return min(self.choice.iterations, USUAL) if self.choice.auto else self.choice.iterations

    @property
    def seconds(self) -> float:
        """Time of all frames, set-up included."""
        found = self.projector.forecast().chosen
        return found.prepare_s + len(self.frames) * self.iterations * found.pair_s


@record
class _Reconstruct(Task):
    """What all kinds have."""

    name: ClassVar[str] = "reconstruct"

    psf: Path = required(
        "H file (.h5), or one of another code (.mat, .npy, .lfc).", label="H", argument=True, file="in"
    )
    frames: Path = required(
        "Light-field frame; or several: an image file of many pages, a folder of frames, or a recorded session.",
        argument=True,
        file="in",
    )
    regions: tuple[str, ...] = opt(
        (),
        "H of another region of the field: a file, a region of the H file by name, or all. May be repeated. Each voxel "
        "is seen through H of the regions around it.",
        flag="--region",
        empty="none",
        more=True,
    )
    mat_order: str = opt(
        "",
        "Axes of H in a .mat file that does not state them. rows-first: H(t,s,y,x,z). columns-first: H(s,t,x,y,z).",
        label="Axes in a .mat file",
        choices=MAT_ORDERS,
        empty="inferred from its variables",
        more=True,
    )
    solver: SolverFields = one_of(SieveSolver(), "Solver", SOLVER_KINDS)

    light_field: LightFieldSettings = panel(LightFieldSettings(), "Frames")
    grid: VoxelGrid = panel(VoxelGrid(), "Voxels")
    projection: ProjectionSettings = panel(ProjectionSettings(), "Projection")

    def __post_init__(self) -> None:
        """Check every field, and what excludes each other."""
        super().__post_init__()
        if self.regions and self.light_field.asked:
            given = "--lattice" if self.light_field.lattice else "--resample"
            raise InputError.expected(given, "H of one region", "--region", "leave one of them out")

    def files(self, way: str) -> tuple[Path, ...]:
        """Return its files, those of other regions among them."""
        others = files_of_regions(self.psf, self.regions) if way == "in" else ()
        return (*super().files(way), *others)

    def _prepare(self, stack: ExitStack, workers: int | None, *, warm: bool = False) -> _Prepared:
        """Open H, look at the first frame, and choose how to project."""
        from lfcal.psf import noise_of, regions_of
        from lfcal.reconstruct import room_for_projections, usual_margin

        if not self.frames.exists():
            raise StorageError(f"{self.frames}: no such file or folder; check the path")
        choice_of(self.solver)  # wrong settings are found before anything is read
        check_mat_files(self.mat_order, self.psf, *files_of_regions(self.psf, self.regions))
        frames, light_field = frames_of(self.frames), self.light_field
        optics = SharedOptics(self.psf, self.regions, self.mat_order, light_field, self.projection)
        matrices = optics.open(stack)
        H = matrices[0]
        if not self.regions and len(names := regions_of(self.psf)) > 1:
            named = H.region or "the first"
            note(f"of {len(names)} regions of the field {named} alone is used; --region all uses all")
        for one in matrices:
            report_missing(one)
        anchor = self.grid.anchor or placed_anchor(self.frames, H, light_field.asked)
        rows, columns = frames[0].read().shape
        placed = "--region" if self.regions else "--anchor" if self.grid.anchor else "the session" if anchor else ""
        view = view_for(H, (rows, columns), light_field, placed)
        optics = replace(optics, anchor=anchor, resample=view is not None)
        shape = (rows, columns) if view is None else view.shape
        found = noise_of(H.provenance)
        noise = None if found is None or found.slope == 0 else (found.floor, found.slope)
        choice = choice_of(self.solver, noise=noise)
        margin = self.grid.margin
        if isinstance(margin, str):
            possible = "weights" in choice.solver.honours
            margin = usual_margin(H.period, (H.shape[3], H.shape[4]), shape) if possible else 0
        choice = replace(choice, margin=margin)
        own = self.projection
        most = None if own.memory is None else int(own.memory * 1e9)
        sizes = (len(H), *wide(shape, margin))
        room = partial(room_for_projections, sizes, choice, 8 if own.double else 4, memory=most, warm=warm)
        how: dict[str, Any] = {"memory": room(), "workers": workers, "device": own.device}
        projector = optics.projector(matrices, (rows, columns), view, margin, **how)
        return _Prepared(frames, matrices, view, optics, choice, room, projector)


@record
class ReconstructForecast(_Reconstruct):
    """Predict time and memory of a reconstruction.

    Examples
    --------
    >>> from lfcal.tasks import ReconstructForecast
    >>> task = ReconstructForecast(psf="H.h5", frames="session/frames")
    >>> print(task.forecast)
    True
    """

    input_words: ClassVar[str] = "a forecast"

    forecast: bool = opt(False, "Only predict time and memory of each way to project.", more=True)
    warm: bool = opt(
        False, "Start each frame from the volume of the one before it.", label="Start from the last volume"
    )
    light_field: LightFieldSettings = panel(LightFieldSettings(), "Frames", without=("dark",))
    grid: VoxelGrid = panel(VoxelGrid(), "Voxels", without=("voxel",))

    def __post_init__(self) -> None:
        """Check every field."""
        super().__post_init__()
        object.__setattr__(self, "forecast", True)  # what makes a command line one of this kind

    def work(self, run: RunSettings | None = None) -> Work[tuple[ReconstructionForecast, ...]]:
        """Prepare the reconstruction, and predict what it takes."""
        from lfcal.reconstruct import run_memory

        yield from ()
        with ExitStack() as stack:
            found = self._prepare(stack, run.workers if run else None, warm=self.warm)
            one = ReconstructionForecast(
                projector=found.projector,
                choice=found.choice,
                frames=len(found.frames),
                iterations=found.iterations,
                seconds=found.seconds,
                memory=run_memory(found.projector, found.choice, warm=self.warm),
            )
        return (one,)


@record
class Reconstruct(_Reconstruct):
    """Reconstruct the volume behind a light-field frame, or those of a series, with H.

    Exit code 0: each frame has its volume; 1: a frame of several is damaged or shows no light, and has none.

    Examples
    --------
    >>> import numpy as np
    >>> import tifffile
    >>> from lfcal.reconstruct import RlTvSolver
    >>> from lfcal.tasks import Reconstruct
    >>> tifffile.imwrite("frame.tif", np.random.default_rng(0).poisson(50, (48, 48)).astype(np.uint16))
    >>> solver = RlTvSolver(iterations=3, strength=0.005)
    >>> (made,) = Reconstruct(psf="H.h5", frames="frame.tif", out="made.tif", solver=solver).run()
    >>> print(made.shape, made.results[0].iterations)
    (2, 48, 48) 3
    """

    input_words: ClassVar[str] = "one frame"
    in_units: ClassVar[bool] = True

    out: Path = required(
        "Volume to write: .tif, .ome.tif, .ome.zarr, .h5 or .npy. Of several frames a folder, or such a file for all.",
        label="Volume",
        short="-o",
        file="out",
    )

    def unit_outputs(self) -> tuple[Path, ...]:
        """Return the output next to which volumes of a stopped run are kept."""
        return (self.out,)

    def work(self, run: RunSettings | None = None) -> Work[tuple[Reconstructed, ...]]:
        """Reconstruct frame by frame; one volume is in memory at a time."""
        return self._iter_volumes(run or RunSettings(), "", warm=False)

    def _iter_volumes(self, run: RunSettings, suffix: str, *, warm: bool) -> Work[tuple[Reconstructed, ...]]:
        from lfcal.psf import voxel_um
        from lfcal.reconstruct import check_warm

        if warm:
            check_warm(choice_of(self.solver))
        frames = frames_of(self.frames) if self.frames.exists() else []
        targets = targets_of(frames, self.out, suffix or None)
        if suffix:
            outs = dict.fromkeys(targets.values())
            check_outputs(outs, *self.files("in"), force=may_replace(self.out, run))
        with ExitStack() as stack:
            found = self._prepare(stack, run.workers, warm=warm)
            P, H = found.projector, found.matrices[0]
            choice = run.choice(self.out, found.seconds, "frame by frame")
            grid = self._grid(found, H)
            shape = (len(H), *(found.shape if grid is None else grid.shape))
            sides = voxel_um(H) if grid is None else (grid.voxel_um, grid.voxel_um)
            details, times = self._details(found), [frame.time_s for frame in found.frames]
            saved = partial(saving, P, sides, targets, details, shape, grid=grid, times_s=times)
            if choice is None:
                with saved() as save:
                    results = yield from _iter_solve(found, self.light_field, save, warm=warm)
            else:
                results = yield from _iter_solve_in_units(found, self.out, choice, saved, warm=warm)
        one = Reconstructed(method=P.method, forecast=str(P.forecast()), shape=shape, results=results, files=targets)
        return (one,)

    def _grid(self, found: _Prepared, H: PSFMatrix) -> MetricGrid | None:
        """Return the grid of voxels of one size, where it is asked for."""
        from lfcal.reconstruct import MetricGrid

        voxel = self.grid.voxel
        if voxel is None:
            return None
        anchor = found.optics.image_anchor(found.view, H)
        return MetricGrid.for_matrix(H, found.shape, anchor, None if isinstance(voxel, str) else voxel)

    def _details(self, found: _Prepared) -> dict[str, Any]:
        """Return what is written into a volume about how it was made."""
        P, choice = found.projector, found.choice
        anchor = tuple(at - choice.margin for at in P.grid.anchor)
        known: dict[str, Any] = {"psf": self.psf.name, "solver": asdict(choice), "method": P.method}
        known |= {"within": P.tolerance, "anchor": anchor}
        if P.device is not None:
            known["device"] = P.device.name
        if self.regions:
            known["regions"] = [one.region or Path(one.path).name for one in found.matrices]
        return known | with_task(self, *found.matrices)


@record
class ReconstructSeries(Reconstruct):
    """Reconstruct the volumes behind a series of frames.

    Examples
    --------
    >>> from lfcal.tasks import ReconstructSeries
    >>> task = ReconstructSeries(psf="H.h5", frames="session/frames", out="volumes", format=".h5", warm=True)
    >>> print(task.solver.name, task.format)
    sieve .h5
    """

    input_words: ClassVar[str] = "a series of frames"

    format: str = opt(
        ".tif", "Of the files in a folder of volumes.", label="Format of the files", choices=FORMATS, more=True
    )
    warm: bool = opt(
        False, "Start each frame from the volume of the one before it.", label="Start from the last volume"
    )

    def _whole(self) -> bool:
        """Whether one file holds all volumes."""
        from lfcal.reconstruct import SUFFIXES

        return self.out.suffix.lower() in SUFFIXES

    def files(self, way: str) -> tuple[Path, ...]:
        """Return its files; those in a folder of volumes are known when the frames are."""
        return () if way == "out" and not self._whole() else super().files(way)

    def work(self, run: RunSettings | None = None) -> Work[tuple[Reconstructed, ...]]:
        """Reconstruct frame by frame; one volume is in memory at a time."""
        if self.format != ".tif" and self._whole():
            raise InputError.expected("--format", "a folder in --out", self.out.name, "leave it out")
        return self._iter_volumes(run or RunSettings(), "" if self._whole() else self.format, warm=self.warm)


def _iter_solve(
    found: _Prepared, light_field: LightFieldSettings, save: Save, *, warm: bool
) -> Work[tuple[FrameResult, ...]]:
    """Reconstruct and save frame by frame."""
    from lfcal.reconstruct import iter_series, run_memory

    P, choice, view = found.projector, found.choice, found.view
    rows, columns = found.frames[0].read().shape
    weights = None if view is None else view.inside((rows, columns))
    clean = cleaner(light_field.dark, light_field.white, view)
    frames = [(frame.name, partial(_cleaned, frame, clean)) for frame in found.frames]

    def take(name: str, result: Reconstruction) -> None:
        known = {"notes": result.notes, "residual": result.history[-1].residual, "stopped": result.stopped}
        if math.isfinite(result.chi2):
            known["chi2"] = result.chi2
        save(name, result.volume, known)

    def leave(name: str) -> None:
        save(name, None, {})

    note(f"{P.forecast()}; memory {run_memory(P, choice, warm=warm)}")
    if not choice.solver.in_parts:
        yield from P.iter_prepare()
    return (yield from iter_series(P, frames, len(frames), choice, take, weights=weights, warm=warm, missing=leave))


def _cleaned(frame: FrameFile, clean: Callable[[NDArray[Any]], NDArray[Any]]) -> NDArray[Any]:
    return clean(frame.read())


def _iter_solve_in_units(
    found: _Prepared, out: Path, run: RunChoice, saved: Saved, *, warm: bool
) -> Work[tuple[FrameResult, ...]]:
    """Reconstruct frame by frame, each volume in a file that stays until all are there and ``saved``."""
    from lfcal.base import worker_count
    from lfcal.reconstruct import check_any
    from lfcal.tasks._reconstruct_units import device_hints, frame_units, iter_collect
    from lfcal.work import iter_made

    if warm and run.executor != "threads":
        raise InputError.expected("--warm", "--executor threads", run.executor, "each frame needs the one before it")
    # each process has its own H
    share = 1 if run.executor == "threads" else worker_count(run.workers)
    P, asked = found.projector, found.optics.projection.device
    hints = {"memory": found.room(share=share), **device_hints(P.device, asked, share)}
    units = frame_units(found.frames, found.optics, found.choice, out, hints, P.recipe, warm=warm)
    results: list[FrameResult] = []
    names = [frame.name for frame in found.frames]
    collect = partial(iter_collect, names=names, saved=saved, results=results)
    yield from iter_made(units, out, run, collect, title=f"volumes of {out.name}", joined=False)
    check_any(results)
    return tuple(results)


def kind_of(given: Mapping[str, Any]) -> type[Task]:
    """Return which kind of reconstruction is asked for."""
    if given.get("forecast"):
        return ReconstructForecast
    return ReconstructSeries if is_series(Path(given["frames"])) else Reconstruct


RECONSTRUCT = TaskSet(
    "reconstruct",
    (Reconstruct, ReconstructSeries, ReconstructForecast),
    kind_of,
    "lfcal reconstruct H.h5 frame.tif -o volume.tif --solver rl-tv --iterations 30",
)
