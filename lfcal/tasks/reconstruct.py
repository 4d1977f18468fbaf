"""Reconstruct volumes from one or more light-field frames, or forecast the cost."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from lfcal.base import InputError, StorageError, Work, note
from lfcal.records import (
    OWN_SOLVERS,
    BootstrapSettings,
    LightFieldSettings,
    ProjectionSettings,
    RlNesterovSolver,
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
from lfcal.tasks._watched_series import WatchedSeries
from lfcal.tasks.matrices import check_mat_files, mat_order_field, note_opened, report_missing, with_task
from lfcal.tasks.outputs import check_outputs
from lfcal.tasks.task import LONG, RunSettings, Task, TaskResult, TaskSet, may_replace

if TYPE_CHECKING:
    from lfcal.reconstruct import ErrorBars, FeatureFit, FrameResult, FrameRun

__all__ = [
    "RECONSTRUCT",
    "FittedFeatures",
    "Reconstruct",
    "ReconstructBars",
    "ReconstructFeatures",
    "ReconstructForecast",
    "ReconstructSeries",
    "Reconstructed",
    "ReconstructedBars",
    "ReconstructionForecast",
    "solver_settings",
]

AUTO = "auto"
"""Value of the field ``features`` with which beads are searched for in the volume."""

QUICK = 5
"""Number of replicates that is suggested if error bars take long to compute."""

FORMATS = (".tif", ".ome.tif", ".ome.zarr", ".h5", ".npy")


def _find(name: str) -> type[SolverFields]:
    """Return the record class of the solver ``name``, which may be from another package."""
    own = {SOLVER_KINDS.name_of(kind): kind for kind in OWN_SOLVERS}
    if name in own:
        return own[name]
    if name == "list":
        raise InputError.expected("--solver", "the name of a solver", "list", "choose a name that lfcal solvers lists")
    from lfcal.reconstruct import SOLVERS

    return solver_kind(name, SOLVERS.get(name).honours)


def _names() -> tuple[str, ...]:
    from lfcal.reconstruct import SOLVERS

    return SOLVERS.names()


SOLVER_KINDS = Variants(OWN_SOLVERS, "name", _find, _names)
"""Record classes of lfcal's solvers, and functions that find those of other packages."""


def solver_settings(name: str, **values: Any) -> SolverFields:
    """Return the settings of the solver ``name``, which may come from a plug-in.

    Parameters
    ----------
    name
        Name of the solver.
    **values
        Values of settings, by name; other settings have their defaults.

    Raises
    ------
    InputError
        If there is no such solver, or it does not have one of the settings.

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
            raise InputError.expected(
                f"solver {name}", f"only the settings {', '.join(known)}", given, "leave this setting out"
            )
    return kind(**values)


@dataclass(frozen=True, kw_only=True)
class Reconstructed(TaskResult):
    """Results of reconstructing frames, and the file of each volume by the name of its frame.

    ``method`` is the projection method, ``forecast`` its forecast as text, and ``shape`` the shape ``(nz, Y, X)`` of a
    volume.
    """

    method: str
    forecast: str
    shape: tuple[int, ...]
    results: tuple[FrameResult, ...]
    files: Mapping[str, Path]

    @property
    def failed(self) -> bool:
        """Whether the reconstruction of at least one frame failed."""
        return any(result.failed for result in self.results)

    def _values(self) -> dict[str, Any]:
        whole = len(set(self.files.values())) < len(self.results)  # one file holds all volumes, each at its index
        files = [{**asdict(r), "file": None if r.failed and not whole else self.files[r.name]} for r in self.results]
        return {"method": self.method, "forecast": self.forecast, "volumes": files}


@dataclass(frozen=True)
class ReconstructedBars(TaskResult):
    """Volume with error bars, and its files: the volume, its maps, and the table of regions.

    ``tested`` states whether the settings are those with which the intervals were tested: the default solver, number of
    iterations and contrast, and at least 10 replicates. ``fitted`` states whether the uncertainty of a fit of H is
    included.
    """

    bars: ErrorBars
    files: tuple[Path, ...]
    tested: bool
    fitted: bool

    def _values(self) -> dict[str, Any]:
        regions = [
            {**asdict(one), "interval_68": one.interval(0.6827), "interval_95": one.interval(0.95)}
            for one in self.bars.regions
        ]
        known = {"replicates": self.bars.replicates, "unknown": self.bars.unknown_share, "tested": self.tested}
        known["fitted"] = self.fitted
        return {"files": self.files, **known, "notes": self.bars.notes, "regions": regions}


@dataclass(frozen=True)
class FittedFeatures(TaskResult):
    """Beads and lines fitted to a frame, and the files: the rest of the volume, its maps, and the table of features."""

    fit: FeatureFit
    files: tuple[Path, ...]

    def _values(self) -> dict[str, Any]:
        features = [{**asdict(one), "fits": one.fits} for one in self.fit.features]
        return {"files": self.files, "notes": self.fit.notes, "features": features}


@dataclass(frozen=True)
class ReconstructionForecast(TaskResult):
    """Forecast of the time and memory of the reconstruction ``run``."""

    run: FrameRun

    def _values(self) -> dict[str, Any]:
        found, device, memory = self.run.projector.forecast(), self.run.projector.device, self.run.memory
        use = found.device
        known = None if device is None or use is None else {"name": device.name, **asdict(use)}
        cost = {"memory": memory, "memory_bytes": memory.total, "seconds": self.run.seconds}
        return {"forecast": found.chosen, "options": found.options, "device": known, **cost}


def _warm() -> bool:
    words = "Start each frame from the volume of the previous frame."
    return opt(False, words, label="Start from the previous volume")


@record
class _Reconstruct(Task):
    """Fields of all kinds of reconstructions."""

    name: ClassVar[str] = "reconstruct"

    psf: Path = required(
        "H file (.h5), or a file of another code (.mat, .npy, .lfc, .tif).", label="H", argument=True, file="in"
    )
    frames: Path = required(
        "Light-field frame. Several frames: a multi-page image file, a folder of frames, or a recorded session.",
        argument=True,
        file="in",
    )
    regions: tuple[str, ...] = opt(
        (),
        "H of another region of the field: a file, the name of a region in the H file, or all. May be "
        "repeated. Each voxel is projected with H of the surrounding regions.",
        flag="--region",
        empty="none",
        more=True,
    )
    mat_order: str = mat_order_field()
    solver: SolverFields = one_of(SieveSolver(), "Solver", SOLVER_KINDS)

    light_field: LightFieldSettings = panel(LightFieldSettings(), "Frames")
    grid: VoxelGrid = panel(VoxelGrid(), "Voxels")
    projection: ProjectionSettings = panel(ProjectionSettings(), "Projection")

    def __post_init__(self) -> None:
        """Check every field and the combinations that exclude each other."""
        super().__post_init__()
        if self.regions and self.light_field.asked:
            given = "--lattice" if self.light_field.lattice else "--resample"
            raise InputError.expected(given, "H of one region", "--region", "leave one of them out")

    def files(self, way: str) -> tuple[Path, ...]:
        """Return the files that the task reads (``way="in"``) or writes (``way="out"``).

        The files of other regions are included.
        """
        from lfcal.reconstruct import files_of_regions

        others = files_of_regions(self.psf, self.regions) if way == "in" else ()
        return (*super().files(way), *others)

    def _prepare(self, stack: ExitStack, workers: int | None, *, warm: bool = False) -> FrameRun:
        """Open H, read the first frame, and choose the method of projection."""
        from lfcal.frames import split_dataset
        from lfcal.psf import regions_of
        from lfcal.reconstruct import FrameRun, SharedOptics, SolverChoice, files_of_regions

        if not split_dataset(self.frames)[0].exists():
            raise StorageError(f"{self.frames}: no such file or folder; check the path")
        choice = SolverChoice.of(self.solver)  # raises for wrong settings before anything is read
        check_mat_files(self.mat_order, self.psf, *files_of_regions(self.psf, self.regions))
        optics = SharedOptics(self.psf, self.regions, self.mat_order, self.light_field, self.projection)
        matrices = optics.open(stack)
        for one in matrices:
            note_opened(one)
        if not self.regions and len(names := regions_of(self.psf)) > 1:
            named = matrices[0].region or "the first"
            note(
                f"of {len(names)} regions of the field, only {named} is used; choose all regions to use all "
                "(--region all)"
            )
        for one in matrices:
            report_missing(one)
        return FrameRun.of(self.frames, matrices, optics, choice, self.grid, warm=warm, workers=workers)


@record
class ReconstructForecast(_Reconstruct):
    """Predict the time and memory of a reconstruction."""

    input_words: ClassVar[str] = "a forecast"

    forecast: bool = opt(
        False, "Predict the time and memory of each projection method without reconstructing.", more=True
    )
    warm: bool = _warm()
    light_field: LightFieldSettings = panel(LightFieldSettings(), "Frames", without=("dark",))
    grid: VoxelGrid = panel(VoxelGrid(), "Voxels", without=("voxel",))

    def __post_init__(self) -> None:
        """Check every field."""
        super().__post_init__()
        object.__setattr__(self, "forecast", True)  # the flag that selects this kind on a command line

    def work(self, run: RunSettings | None = None) -> Work[tuple[ReconstructionForecast, ...]]:
        """Prepare the reconstruction, and predict its cost."""
        yield from ()
        with ExitStack() as stack:
            return (ReconstructionForecast(self._prepare(stack, run.workers if run else None, warm=self.warm)),)


@record
class _ReconstructTo(_Reconstruct):
    """Fields of all reconstructions that write a volume."""

    in_units: ClassVar[bool] = True

    out: Path = required(
        "Volume to write: .tif, .ome.tif, .ome.zarr, .h5 or .npy. For several frames: a folder, or one such "
        "file for all volumes.",
        label="Volume",
        short="-o",
        file="out",
    )

    def unit_outputs(self) -> tuple[Path, ...]:
        """Return the path of the output, next to which the volumes of a stopped run are stored."""
        return (self.out,)


@record
class Reconstruct(_ReconstructTo):
    """Reconstruct the volume behind a light-field frame, or those of a series, with H.

    Exit code 0: every frame has a volume. Exit code 1: of several frames, at least one is damaged or shows no light.

    Examples
    --------
    >>> import numpy as np
    >>> import tifffile
    >>> from lfcal.reconstruct import RlTvSolver
    >>> from lfcal.tasks import Reconstruct, ReconstructForecast, ReconstructSeries
    >>> tifffile.imwrite("frame.tif", np.random.default_rng(0).poisson(50, (48, 48)).astype(np.uint16))
    >>> solver = RlTvSolver(iterations=3, strength=0.005)
    >>> (made,) = Reconstruct(psf="H.h5", frames="frame.tif", out="made.tif", solver=solver).run()
    >>> print(made.shape, made.results[0].iterations)
    (2, 48, 48) 3
    >>> several = ReconstructSeries(psf="H.h5", frames="session/frames", out="volumes", format=".h5", warm=True)
    >>> forecast = ReconstructForecast(psf="H.h5", frames="session/frames")
    """

    input_words: ClassVar[str] = "one frame"

    def work(self, run: RunSettings | None = None) -> Work[tuple[Reconstructed, ...]]:
        """Reconstruct the volume of the frame, and write it."""
        return self._iter_volumes(run or RunSettings(), "", warm=False)

    def _iter_volumes(
        self, run: RunSettings, suffix: str, *, warm: bool, watched: WatchedSeries | None = None
    ) -> Work[tuple[Reconstructed, ...]]:
        from lfcal.frames import split_dataset
        from lfcal.reconstruct import frames_of, targets_of

        frames = frames_of(self.frames) if split_dataset(self.frames)[0].exists() else []
        targets = targets_of(frames, self.out, suffix or None)
        if suffix:
            outs = dict.fromkeys(targets.values())
            check_outputs(outs, *self.files("in"), force=may_replace(self.out, run))
        results: tuple[FrameResult, ...] = ()
        with ExitStack() as stack:
            for psf, own in [(None, frames)] if watched is None else watched.parts:
                task = self if psf is None else replace(self, psf=psf)
                found = replace(task._prepare(stack, run.workers, warm=warm), frames=own)
                out = self.out if psf is None else self._out_after_drift
                choice, details = run.choice(out, found.seconds, "frame by frame"), with_task(self, *found.matrices)
                how = {"of_frames": watched.of_frames if watched else None}
                files = {one.name: targets[one.name] for one in own}
                results += yield from found.iter_volumes(files, out, details, choice, **how)
            P, shape = found.projector, found.volume_shape
        return (
            Reconstructed(method=P.method, forecast=str(P.forecast()), shape=shape, results=results, files=targets),
        )

    @property
    def _out_after_drift(self) -> Path:
        """Path next to which the units of frames after a drift are stored."""
        return self.out.with_name(f"{self.out.name}.recalibrated")


@record
class ReconstructSeries(Reconstruct):
    """Reconstruct the volumes behind a series of frames."""

    input_words: ClassVar[str] = "a series of frames"

    format: str = opt(
        ".tif", "Format of the files in a folder of volumes.", label="File format", choices=FORMATS, more=True
    )
    warm: bool = _warm()
    watch: Path | None = opt(
        None,
        "Result of lfcal watch for these frames with this H: its folder, or watch.json. Drift and alarm of each "
        "frame are stored with the volume of the frame.",
        label="Check of H",
        file="in",
        empty="volumes do not state whether H was still valid",
        more=True,
    )
    recalibrated: bool = opt(
        False,
        "Use the recalibrated H of lfcal watch for the first frame with a drift and all later frames.",
        label="Use the recalibrated H",
        more=True,
    )

    def __post_init__(self) -> None:
        """Check every field and the combinations that exclude each other."""
        super().__post_init__()
        if not self.recalibrated:
            return
        if self.watch is None:
            raise InputError.expected("--recalibrated", "a result of lfcal watch", "none", "state its folder (--watch)")
        if self.regions:
            raise InputError.expected("--recalibrated", "H of one region", "--region", "leave one of them out")

    def _whole(self) -> bool:
        """Whether all volumes are written to one file."""
        from lfcal.reconstruct import SUFFIXES

        return self.out.suffix.lower() in SUFFIXES

    def files(self, way: str) -> tuple[Path, ...]:
        """Return the files that the task reads (``way="in"``) or writes (``way="out"``).

        Files in a folder of volumes are not included, because they depend on the frames.
        """
        return () if way == "out" and not self._whole() else super().files(way)

    def unit_outputs(self) -> tuple[Path, ...]:
        """Return the paths next to which the volumes of a stopped run are stored."""
        return (self.out, self._out_after_drift) if self.recalibrated else (self.out,)

    def _watched(self) -> WatchedSeries | None:
        """Return the result of ``lfcal watch`` for the frames, if one is given."""
        from lfcal.reconstruct import frames_of

        if self.watch is None:
            return None
        found = WatchedSeries.read(self.watch, self.psf, frames_of(self.frames), recalibrated=self.recalibrated)
        if self._whole() and len(found.parts) > 1:
            raise InputError.expected(
                "output for two H", "a folder", self.out.name, "choose a folder, because each H has its own metadata"
            )
        found.report()
        return found

    def work(self, run: RunSettings | None = None) -> Work[tuple[Reconstructed, ...]]:
        """Reconstruct the frames and write their volumes; without units, process one frame after the other."""
        if self.format != ".tif" and self._whole():
            raise InputError.expected(
                "output for separate volumes",
                "a folder",
                self.out.name,
                "choose a folder (--out), or leave the format out (--format)",
            )
        suffix = "" if self._whole() else self.format
        return self._iter_volumes(run or RunSettings(), suffix, warm=self.warm, watched=self._watched())


@record
class _ReconstructUncertain(_ReconstructTo):
    """Fields of reconstructions whose uncertainty includes errors of H."""

    fit: Path | None = opt(
        None,
        "Folder of the fit (lfcal fit) from which H was computed. The uncertainty of the fitted camera is included.",
        label="Fit of the camera",
        file="in",
        empty="H has no errors apart from its recorded noise",
    )
    solver: SolverFields = one_of(RlNesterovSolver(iterations=60), "Solver", SOLVER_KINDS)
    grid: VoxelGrid = panel(VoxelGrid(), "Voxels", without=("voxel",))

    def __post_init__(self) -> None:
        """Check every field and the combinations that exclude each other."""
        super().__post_init__()
        if self.fit and self.regions:
            raise InputError.expected("--fit", "H of one region", "--region", "leave one of them out")

    def _iter_changes(self, run: FrameRun, how: RunSettings) -> Work[Path | None]:
        """Write the changes of H along the principal axes of the uncertainty of the fit, and return the file.

        Without a fit, return None.
        """
        from lfcal.fit import iter_write_deviations
        from lfcal.work import RunChoice

        if self.fit is None:
            return None
        units = how.executor or how.scheduler or how.resume
        executor = how.executor or ("dask" if how.scheduler else "threads")
        choice = RunChoice(executor, how.workers, how.scheduler, "resume") if units else None
        return (yield from iter_write_deviations(self.fit, run.matrices[0], workers=how.workers, run=choice))


@record
class ReconstructBars(_ReconstructUncertain):
    """Reconstruct the volume behind a light-field frame with error bars of its voxels and of sums over regions.

    Examples
    --------
    >>> import numpy as np
    >>> import tifffile
    >>> from lfcal.reconstruct import BootstrapSettings, RlSolver
    >>> from lfcal.tasks import ReconstructBars
    >>> tifffile.imwrite("frame.tif", np.random.default_rng(0).poisson(50, (48, 48)).astype(np.uint16))
    >>> settings = {"solver": RlSolver(iterations=3, gain=1.0), "bootstrap": BootstrapSettings(replicates=3)}
    >>> (made,) = ReconstructBars(psf="H.h5", frames="frame.tif", out="volume.tif", **settings).run()
    >>> print([file.name for file in made.files])
    ['volume.tif', 'volume_sigma.tif', 'volume_kappa.tif', 'volume_resolution.tif']
    """

    input_words: ClassVar[str] = "a frame with error bars"

    bars: bool = opt(
        False,
        "Also estimate the uncertainty of every voxel, and which details are unknown, from reconstructions of "
        "random objects that resemble the volume.",
        label="Error bars",
    )
    labels: Path | None = opt(
        None,
        "Image or stack of labels, with positive integers inside the regions and the planes in the order of the "
        "volume file. The output lists the sum over each region with its uncertainty.",
        label="Regions",
        file="in",
        empty="no table of regions",
    )
    crop: bool = opt(
        False,
        "Estimate the uncertainty only up to one cutout away from the regions. This is faster if the regions cover a "
        "small part of the frame. The volume is still that of the whole frame.",
        label="Only around the regions",
    )
    bootstrap: BootstrapSettings = panel(BootstrapSettings(), "Replicates")

    def __post_init__(self) -> None:
        """Check every field."""
        super().__post_init__()
        if self.crop and (self.labels is None or self.regions):
            wanted, got = ("regions (--labels)", "none") if self.labels is None else ("H of one region", "--region")
            raise InputError.expected("--crop", wanted, got, "leave --crop out")
        object.__setattr__(self, "bars", True)  # the flag that selects this kind on a command line

    def files(self, way: str) -> tuple[Path, ...]:
        """Return the files that the task reads (``way="in"``) or writes (``way="out"``), including all maps."""
        from lfcal.reconstruct import bar_outputs

        if way == "out":
            return bar_outputs(self.out, regions=self.labels is not None)
        return super().files(way)

    def work(self, run: RunSettings | None = None) -> Work[tuple[ReconstructedBars, ...]]:
        """Reconstruct the frame and the replicates, and write the volume, its maps and the table of regions, if any."""
        from lfcal.reconstruct import BarForecast, iter_bars
        from lfcal.work import RunChoice

        how = run or RunSettings()
        with ExitStack() as stack:
            found = self._prepare(stack, how.workers)
            regions = self.labels is not None
            forecast = BarForecast.of(found, self.bootstrap, regions=regions, uncertain=self.fit is not None)
            note(str(forecast))
            if forecast.seconds > LONG and self.bootstrap.replicates > QUICK:
                note(f"{QUICK} replicates are quicker (--replicates {QUICK})")
            here = RunChoice("threads", how.workers, begun="discard")
            choice = how.choice(self.out, forecast.seconds, "one by one") or here
            details = with_task(self, *found.matrices)
            changes = yield from self._iter_changes(found, how)
            made = yield from iter_bars(
                found, self.out, self.bootstrap, self.labels, choice, details, changes=changes, crop=self.crop
            )
        default, own = type(self).__dataclass_fields__["solver"].default, self.solver
        tested = own.name == default.name and own.iterations == default.iterations
        tested &= self.bootstrap.contrast == BootstrapSettings().contrast and self.bootstrap.replicates >= 10
        return (ReconstructedBars(made, self.files("out"), tested, self.fit is not None),)


@record
class ReconstructFeatures(_ReconstructUncertain):
    r"""Fit beads and lines on a light-field frame, and reconstruct the rest of the volume, all with uncertainties.

    Examples
    --------
    >>> import numpy as np
    >>> import tifffile
    >>> from pathlib import Path
    >>> from lfcal.reconstruct import BootstrapSettings, RlNesterovSolver
    >>> from lfcal.tasks import ReconstructFeatures
    >>> tifffile.imwrite("frame.tif", np.random.default_rng(0).poisson(50, (48, 48)).astype(np.uint16))
    >>> _ = Path("beads.csv").write_text("row,column\n24,24\n")
    >>> settings = {"solver": RlNesterovSolver(iterations=5, gain=1.0), "bootstrap": BootstrapSettings(replicates=3)}
    >>> task = ReconstructFeatures(psf="H.h5", frames="frame.tif", out="rest.tif", features="beads.csv", **settings)
    >>> (made,) = task.run()
    >>> print([file.name for file in made.files], len(made.fit.features))
    ['rest.tif', 'rest_sigma.tif', 'rest_kappa.tif', 'rest_resolution.tif', 'rest_features.csv'] 1
    """

    input_words: ClassVar[str] = "a frame with beads or lines"
    in_units: ClassVar[bool] = False

    features: str = opt(
        AUTO,
        "Beads and lines to fit: a table with the columns row, column, and optionally depth_um, brightness, width, "
        "end_row and end_column (of lines); or auto, for the beads that are visible in the volume.",
        label="Beads and lines",
        file="in",
        is_path=lambda text: text != AUTO,
        examples=(AUTO,),
    )
    bootstrap: BootstrapSettings = panel(BootstrapSettings(), "Replicates")

    def files(self, way: str) -> tuple[Path, ...]:
        """Return the files that the task reads (``way="in"``) or writes (``way="out"``), including the table."""
        from lfcal.reconstruct import feature_outputs

        return feature_outputs(self.out) if way == "out" else super().files(way)

    def work(self, run: RunSettings | None = None) -> Work[tuple[FittedFeatures, ...]]:
        """Reconstruct the frame, fit the features, and reconstruct the rest."""
        from lfcal.reconstruct import iter_features, read_features

        how = run or RunSettings()
        with ExitStack() as stack:
            found = self._prepare(stack, how.workers)
            depths = found.projector.depths
            given = None if self.features == AUTO else read_features(Path(self.features), depths)
            details = with_task(self, *found.matrices)
            changes = yield from self._iter_changes(found, how)
            fit = yield from iter_features(found, self.out, given, self.bootstrap, details, changes=changes)
        return (FittedFeatures(fit, self.files("out")),)


def kind_of(given: Mapping[str, Any]) -> type[Task]:
    """Return the class of the task for the ``given`` values."""
    if given.get("forecast"):
        return ReconstructForecast
    if given.get("features"):
        return ReconstructFeatures
    if given.get("bars"):
        return ReconstructBars
    from lfcal.reconstruct import is_series

    return ReconstructSeries if is_series(Path(given["frames"])) else Reconstruct


RECONSTRUCT = TaskSet(
    "reconstruct",
    (Reconstruct, ReconstructSeries, ReconstructBars, ReconstructFeatures, ReconstructForecast),
    kind_of,
    "lfcal reconstruct H.h5 frame.tif -o volume.tif --solver rl-tv --iterations 30",
)
