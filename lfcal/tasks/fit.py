"""Fit a camera to measured patterns from H, from frames of one or more scans, or from frames of a target."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from lfcal.base import InputError, Work
from lfcal.records import CorrectionRecipe, opt, panel, record, required
from lfcal.tasks._patterns import (
    PatternReading,
    is_matrix,
    iter_patterns,
    names_of,
    noise_field,
    open_upright,
    orientation_field,
    positions_field,
)
from lfcal.tasks.cameras import is_camera_file, load_camera
from lfcal.tasks.target_frames import opened_target, wanted_target
from lfcal.tasks.task import RunSettings, Task, TaskResult, TaskSet

if TYPE_CHECKING:
    from lfcal.camera import ScanPlan
    from lfcal.campaign import Points
    from lfcal.fit import FieldFit, Fit, HybridSummary, Measured
    from lfcal.psf import PSFMatrix
    from lfcal.simulate.effects import Effect
    from lfcal.work import RunChoice

__all__ = ["FIT", "FitFrames", "FitMatrix", "FitOutcome", "FitTarget", "FittedPatterns"]

FOLDER = Path("fit")


@dataclass(frozen=True, kw_only=True)
class FitOutcome(TaskResult):
    """One fitted camera.

    ``fit`` is the fit to the patterns in ``source``, and ``files`` were written to the folder ``out``. ``field`` is the
    fit of several regions, or of the parts of the field of a target; it is None for a single region. If it is given,
    ``fit`` is that of the first region or part, and ``source`` is the first source. ``hybrids`` describes, by region,
    what the hybrid H adds to the model; the name of a single region is empty. Without a hybrid H, it is empty. For a
    target, ``points`` are the points found in its frames, and ``holes`` is the fitted size of its holes as text.
    """

    fit: Fit
    source: Path
    out: Path
    files: tuple[Path, ...]
    field: FieldFit | None = None
    hybrids: Mapping[str, HybridSummary]
    points: Points | None = None
    holes: str = ""

    def _values(self) -> dict[str, Any]:
        from lfcal.campaign import target_facts
        from lfcal.fit import field_dict, fit_dict

        files = {"files": list(self.files)}
        hybrids = {name: asdict(one) for name, one in self.hybrids.items()}
        if self.field is None:
            return fit_dict(self.fit) | {"source": self.source} | files | ({"hybrid": hybrids[""]} if hybrids else {})
        if self.points is None:
            return field_dict(self.field) | files | ({"hybrid": hybrids} if hybrids else {})
        parts = {name: {"chi2": one.here.chi_square.lit} for name, one in self.field.fits.items() if one.here}
        return (
            fit_dict(self.fit) | {"source": self.source} | files | {"target": target_facts(self.points), "parts": parts}
        )


class FittedPatterns(NamedTuple):
    """Patterns of one region, facts about their source, and the fit to them."""

    measured: Measured
    known: Mapping[str, Any]
    fit: Fit


def read_unknowns(text: str) -> str:
    """Return ``text``, which states ``auto`` or comma-separated groups of unknowns, without spaces and repetitions.

    Raises
    ------
    InputError
        If a group is unknown, or there is none.
    """
    from lfcal.fit import GROUPS

    if text == "auto":
        return text
    names = tuple(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))
    known = GROUPS.names()
    wrong = [name for name in names if name not in known]
    if wrong or not names:
        got, remedy = wrong[0] if wrong else repr(text), f"choose from {', '.join(known)}"
        raise InputError.expected("unknowns", "auto or groups of unknowns", got, remedy)
    return ",".join(names)


@record
class _Fit(Task):
    """Fields of all kinds of fits."""

    name: ClassVar[str] = "fit"

    sources: tuple[Path, ...] = required(
        "H file (of which only recorded positions are used), recorded session, folder of frames, or file of "
        "many frames. If several sources are given, each is one region of the field of the same camera.",
        argument=True,
        file="in",
    )
    out: Path = opt(FOLDER, "Folder for the results.", label="Folder", short="-o", file="out")
    camera: str = opt(
        "",
        "Preset or camera file to start from.",
        file="in",
        is_path=is_camera_file,
        empty="the camera of H or of the plan",
    )
    unknowns: str = opt(
        "auto",
        "Groups of unknowns to fit, separated by commas. auto: the groups that reduce the error of held-out patterns.",
        examples=("auto",),
        read=read_unknowns,
    )
    effects: tuple[str, ...] = opt(
        (),
        "Effect that differs from the camera description: NAME=on|off|VALUE, for example "
        "index_mismatch=1.38,depth:20um; or a JSON file of effects. May be repeated.",
        flag="--effect",
        file="in",
        is_path=lambda text: "=" not in text,
        empty="none",
        more=True,
    )
    positions: int | None = positions_field("Number of positions to fit, spread evenly. 0 uses all positions.")
    write_h: bool = opt(True, "Compute and write H of the fitted camera.", label="Compute H", flag="--no-h")

    @property
    def groups(self) -> str | tuple[str, ...]:
        """Requested unknowns: ``auto``, or the names of groups."""
        return self.unknowns if self.unknowns == "auto" else tuple(self.unknowns.split(","))

    @property
    def provenance(self) -> dict[str, Any]:
        """The entries of this task for the provenance of every file that it writes."""
        return {"task": self.to_dict(absolute=True, outputs=False)}

    def starting(self, plan: ScanPlan) -> tuple[Effect, ...] | None:
        """Return the effects at the start of the fit. None: the effects that the camera describes."""
        from lfcal.fit import starting_effects, with_given
        from lfcal.simulate.effects import parse_effects

        return with_given(starting_effects(plan), *parse_effects(self.effects)) if self.effects else None


@record
class FitTarget(_Fit):
    """Fit one camera to all points of a target, each at its actual position on the sensor."""

    input_words: ClassVar[str] = "frames of a target"

    plan: Path | None = opt(None, "Plan of the target (.json).", short="-p", file="in", empty="stored with the frames")
    regions: str = opt("", "Write H of ROWSxCOLUMNS regions, such as 3x3, to one file.", empty="one region")
    corrections: CorrectionRecipe = panel(CorrectionRecipe(), "Corrections")

    def files(self, way: str) -> tuple[Path, ...]:
        """Return the files that the task reads (``way="in"``) or writes (``way="out"``).

        The files to write are those in the folder of the fit.
        """
        from lfcal.campaign import point_outputs

        return tuple(point_outputs(self.out)) if way == "out" else super().files(way)

    def work(self, run: RunSettings | None = None) -> Work[tuple[FitOutcome, ...]]:
        """Find the points in the frames, fit the camera, and write the results."""
        from lfcal.camera import RegionPlan, parse_regions
        from lfcal.campaign import MOST, hole_words, iter_fit_points, iter_points_of, iter_write_points, target_facts

        (source,), workers = self.sources, run.workers if run else None
        plan = wanted_target(source, self.plan)
        assert plan is not None
        if self.camera:
            plan = replace(plan, scan=replace(plan.scan, camera=load_camera(self.camera)))
        spread = RegionPlan.spread(plan.scan, parse_regions(self.regions)) if self.regions else plan.scan
        begins = self.starting(plan.scan)
        most = MOST if self.positions is None else self.positions or None
        with opened_target(source, plan, self.corrections) as view:
            points = yield from iter_points_of(view, plan)
            fit = yield from iter_fit_points(view, points, self.groups, effects=begins, most=most, workers=workers)
        known = {"source": source.name, "target": target_facts(points), **self.provenance}
        files = yield from iter_write_points(fit, spread, self.out, known, with_h=self.write_h, workers=workers)
        holes = hole_words(fit.first, asked=self.unknowns != "auto")
        one = FitOutcome(
            fit=fit.first,
            source=source,
            out=self.out,
            files=tuple(files),
            field=fit,
            hybrids={},
            points=points,
            holes=holes,
        )
        return (one,)


@record
class FitMatrix(_Fit):
    """Fit a camera to the recorded patterns of H."""

    input_words: ClassVar[str] = "H"
    in_units: ClassVar[bool] = True

    plan: Path | None = opt(
        None,
        "Scan plan (.json) of the frames, or of an H without a camera.",
        short="-p",
        file="in",
        empty="stored with the frames",
    )
    noise: tuple[float, float] | None = noise_field()
    hybrid: bool = opt(
        False,
        "Write a hybrid H: the model plus the measured deviations from the model, with their uncertainty.",
        label="Hybrid H",
        more=True,
    )

    def __post_init__(self) -> None:
        """Check every field and the combinations that exclude each other."""
        super().__post_init__()
        if self.hybrid and not self.write_h:
            raise InputError.expected("--hybrid", "an H to write", "--no-h", "leave one of them out")

    def files(self, way: str) -> tuple[Path, ...]:
        """Return the files that the task reads (``way="in"``) or writes (``way="out"``).

        The files to write are those in the folder of the fit.
        """
        from lfcal.fit import field_outputs, fit_outputs

        if way == "in":
            return super().files(way)
        return tuple(fit_outputs(self.out) if len(self.sources) == 1 else field_outputs(self.out, self._names))

    def unit_outputs(self) -> tuple[Path, ...]:
        """Return the paths of the H files that are computed in units, or only of those that a stopped run has begun.

        A hybrid H is not computed in units.
        """
        from lfcal.work import parts_folder

        if self.hybrid or not self.write_h:
            return ()
        return tuple(place for place in self._places if parts_folder(place).exists()) or self._places

    @property
    def _places(self) -> tuple[Path, ...]:
        """Path of H, or of the H of each region."""
        from lfcal.fit import MODEL

        return (self.out / MODEL,) if len(self.sources) == 1 else tuple(self.out / one / MODEL for one in self._names)

    @property
    def _names(self) -> list[str]:
        return names_of(self.sources)

    def _reading(self) -> PatternReading:
        camera = load_camera(self.camera) if self.camera else None
        return PatternReading(camera, self.positions, self.noise, self.plan)

    def _choice(self, run: RunSettings) -> RunChoice | None:
        """Return the settings for computing all H of the fit in units; None if they are computed without units."""
        if self.hybrid or not self.write_h:
            given = next((name for name in ("executor", "scheduler", "resume") if getattr(run, name)), "")
            if given:
                got = "--hybrid" if self.hybrid else "--no-h"
                wanted = "an H of the model, which is computed in units"
                raise InputError.expected(f"--{given}", wanted, got, f"leave --{given} or {got} out")
            return None
        return next((one for one in [run.choice(place) for place in self._places] if one is not None), None)

    def _check_folder(self) -> None:
        """Raise `InputError` if files of another fit would remain in the folder of this fit."""
        from lfcal.fit import MODEL, NUMBERS

        matrix = self.out / MODEL
        if len(self.sources) == 1:
            if not self.write_h and matrix.exists():
                remedy = "choose another folder"
                raise InputError.expected(
                    str(matrix), "no file of H, because none is written now (--no-h)", "H of an earlier fit", remedy
                )
            return
        others = [matrix, self.out / NUMBERS]
        others += [] if self.write_h else self._places
        if there := next((path for path in others if path.exists()), None):
            raise InputError.expected(
                str(self.out), "a folder without another fit", f"a folder with {there.name}", "choose another folder"
            )

    def work(self, run: RunSettings | None = None) -> Work[tuple[FitOutcome, ...]]:
        """Read the patterns, fit the camera, and write the results."""
        run = run or RunSettings()
        self._check_folder()
        choice = self._choice(run)
        if len(self.sources) > 1:
            return ((yield from self._iter_field(run.workers, choice)),)
        found = yield from self.iter_fit(run.workers)
        return ((yield from self.iter_write(found, run.workers, choice)),)

    def iter_fit(self, workers: int | None = None) -> Work[FittedPatterns]:
        """Fit the camera to the patterns of a single source, and return the fit without writing anything.

        Raises
        ------
        NoLatticeError
            If a hybrid H is requested for a camera without a lattice.
        """
        from lfcal.camera import NoLatticeError
        from lfcal.fit import iter_fit_camera

        measured, known = yield from iter_patterns(self.sources[0], self._reading())
        if self.hybrid and not measured.plan.camera.has_lattice:
            raise NoLatticeError.of("hybrid H")
        begins = self.starting(measured.plan)
        fit = yield from iter_fit_camera(measured, unknowns=self.groups, effects=begins, workers=workers)
        return FittedPatterns(measured, known, fit)

    def iter_write(
        self, found: FittedPatterns, workers: int | None = None, choice: RunChoice | None = None
    ) -> Work[FitOutcome]:
        """Write ``found``, the result of `iter_fit`, to the folder ``out``; with ``choice``, H is computed in units."""
        from lfcal.fit import iter_write_fit

        self._check_folder()
        (source,), (measured, known, fit) = self.sources, found
        how: dict[str, Any] = {"noise": self.noise, "with_h": self.write_h, "workers": workers, "run": choice}
        with ExitStack() as stack:
            patterns = self._recorded(source, measured, stack) if self.hybrid else None
            work = iter_write_fit(fit, measured, self.out, {**known, **self.provenance}, patterns=patterns, **how)
            files, summary = yield from work
        hybrids = {} if summary is None else {"": summary}
        return FitOutcome(fit=fit, source=source, out=self.out, files=tuple(files), hybrids=hybrids)

    def _iter_field(self, workers: int | None, choice: RunChoice | None) -> Work[FitOutcome]:
        """Fit one camera to the patterns of several regions."""
        from lfcal.fit import iter_fit_field, iter_write_field

        how, patterns, known = self._reading(), {}, {}
        for name, source in zip(self._names, self.sources, strict=True):
            patterns[name], own = yield from iter_patterns(source, how)
            known[name] = {**own, **self.provenance}
        begins = self.starting(next(iter(patterns.values())).plan)
        fit = yield from iter_fit_field(patterns, how.camera, self.groups, effects=begins, workers=workers)
        more: dict[str, Any] = {"noise": self.noise, "with_h": self.write_h, "workers": workers, "run": choice}
        with ExitStack() as stack:
            pairs = zip(patterns.items(), self.sources, strict=True) if self.hybrid else ()
            recorded = {name: self._recorded(source, own, stack) for (name, own), source in pairs}
            work = iter_write_field(fit, patterns, self.out, known, hybrids=recorded or None, **more)
            files, hybrids = yield from work
        first, source = fit.first, self.sources[0]
        return FitOutcome(fit=first, source=source, out=self.out, files=tuple(files), field=fit, hybrids=hybrids)

    def _recorded(self, source: Path, measured: Measured, stack: ExitStack) -> PSFMatrix | Measured:
        """Return the patterns for a hybrid H; from an H, all recorded patterns instead of only the fitted ones."""
        if not is_matrix(source):
            return measured
        return self._reading().described(stack.enter_context(open_upright(source, quiet=True)), source)


@record
class FitFrames(FitMatrix):
    """Find the camera that explains measured patterns, and compute its H without noise.

    The fit estimates gap, focal lengths, iris and aberrations. It writes camera.json, effects.json, H.h5, fit.json
    and report/ into a folder. Several sources are regions of the field of one camera. The fit then also finds how the
    wavefront changes over the field, and each region has a separate folder. Points of a target are fitted at their
    actual positions on the sensor.

    Examples
    --------
    >>> from lfcal.tasks import FitFrames, FitMatrix, FitTarget
    >>> from lfcal.frames import CorrectionRecipe
    >>> task = FitFrames(sources=("centre", "edge"), out="fit", corrections=CorrectionRecipe(dark="dark"))
    >>> print(task.files("out")[0], task.corrections.dark)
    fit/camera.json dark
    >>> others = FitMatrix(sources="H.h5", noise="64,1"), FitTarget(sources="frames", plan="target.json")
    """

    input_words: ClassVar[str] = "frames"

    orientation: str = orientation_field()
    corrections: CorrectionRecipe = panel(CorrectionRecipe(), "Corrections")

    def _reading(self) -> PatternReading:
        return replace(super()._reading(), recipe=self.corrections, orientation=self.orientation)


def kind_of(given: Mapping[str, Any]) -> type[Task]:
    """Return the class of the task that fits the ``given`` sources."""
    sources = [Path(one) for one in given["sources"]]
    if len(sources) == 1 and wanted_target(sources[0], given.get("plan")) is not None:
        return FitTarget
    return FitMatrix if all(map(is_matrix, sources)) else FitFrames


FIT = TaskSet("fit", (FitFrames, FitMatrix, FitTarget), kind_of, "lfcal fit H.h5 -o fit/")
