"""Assemble H from frames of a scan, of several regions of the field, or of a target."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from lfcal.base import Progress, Work, note
from lfcal.records import (
    AssemblySettings,
    CorrectionRecipe,
    described_by,
    from_dict,
    opt,
    panel,
    read_orientation,
    record,
    required,
    rows,
)
from lfcal.tasks._channels import ChannelPart, coloured, open_colour, parts_of
from lfcal.tasks._scan_frames import ScanFrames, note_size, orientations, origin_field
from lfcal.tasks.cameras import note_assumed
from lfcal.tasks.outputs import check_output, check_outputs
from lfcal.tasks.task import RunSettings, Task, TaskResult, TaskSet, may_replace

if TYPE_CHECKING:
    from lfcal.camera import ScanPlan
    from lfcal.campaign import Points
    from lfcal.fit import Filler
    from lfcal.frames import CorrectedSource, Frames, FrameSource, Position
    from lfcal.psf import AssembledPlanes, AssemblyReport, Reopening
    from lfcal.targets import TargetPlan
    from lfcal.work import RunChoice

__all__ = [
    "ASSEMBLE",
    "Assemble",
    "AssembleRegions",
    "AssembleTarget",
    "Assembled",
    "AssemblyRun",
    "assemble",
    "open_planes",
]

RATE = 100e6
"""Estimated number of bytes of frames read, corrected and cropped per second of processor time."""


@dataclass(frozen=True, kw_only=True)
class Assembled(TaskResult):
    """One assembled H.

    ``name`` is the name of the region, or else of the colour; it is empty for a single H. ``report`` contains the
    matrix and the results of its assembly, which took ``seconds`` (s). ``out`` is the file of H; each colour has a
    separate file. All regions of a colour share one file, and their matrices are closed. For a target, ``target``,
    ``points`` and ``facts`` are its plan, the points found and facts about the frames. The number of points that match
    no position is ``unused``.
    """

    name: str = ""
    out: Path
    report: AssemblyReport
    seconds: float
    points: Points | None = None
    target: TargetPlan | None = None
    unused: int = 0
    facts: Mapping[str, Any] | None = None

    def close(self) -> None:
        """Close the file of the matrix."""
        self.report.matrix.close()

    def _values(self) -> dict[str, Any]:
        """Return the values of the summary; a value that was not measured is None or "unknown"."""
        from lfcal.judge import judgement_of

        report, matrix = self.report, self.report.matrix
        return {
            "name": self.name,
            "out": self.out,
            "shape": matrix.shape,
            "frames": report.frames,
            "missing": report.missing,
            "filled": report.filled,
            "repeated": report.repeated,
            "orientation": matrix.provenance.get("orientation", {"applied": report.orientation}),
            "left_out": [found._asdict() for found in report.left_out],
            "half_cell": matrix.provenance.get("half_cell"),
            "saturated_positions": report.saturated,
            "unknown_saturation": report.unknown_saturation,
            "spread": report.spread,
            "padded": report.padded,
            "residual_px": report.residual_px,
            "assumed": [] if matrix.camera is None else matrix.camera.marks.paths("assumed"),
            "file_bytes": self.out.stat().st_size if self.out.exists() else None,
            "seconds": self.seconds,
            **judgement_of(report).to_dict(),
            **({} if self.facts is None else {"target": self.facts}),
        }


@dataclass(frozen=True)
class AssemblyRun:
    """Settings for the assembly of one H.

    ``choice`` states how H is assembled in units. None: without units. ``reopening`` states how other processes open
    the frames; it is needed only with units. ``workers`` is the number of threads. None: ``LFCAL_WORKERS``, or else one
    for each processor.
    """

    choice: RunChoice | None = None
    reopening: Reopening | None = None
    workers: int | None = None


@record
class _Assemble(Task):
    """Fields of all kinds of assembly."""

    name: ClassVar[str] = "assemble"

    frames: Path = required(
        "Folder of frames, manifest (.csv, .json), file with several frames, recorded session, or scan plan "
        "(.json). For a scan plan, the simulated camera records the frames.",
        argument=True,
        file="in",
    )
    out: Path = required("H file to write (.h5).", label="H file", short="-o", file="out")
    skip_damaged: bool = opt(
        False,
        "Leave out frames that cannot be read, and list them. This takes longer, because every frame is read twice.",
        label="Leave out damaged frames",
        more=True,
    )


@record
class AssembleTarget(_Assemble):
    """Find the points in a target's frames, and assemble H from those at the positions of the scan."""

    input_words: ClassVar[str] = "frames of a target"

    plan: Path | None = opt(None, "Plan of the target (.json).", short="-p", file="in", empty="stored with the frames")
    corrections: CorrectionRecipe = panel(CorrectionRecipe(), "Corrections")
    settings: AssemblySettings = panel(AssemblySettings(), "Cutout and storage")

    def work(self, run: RunSettings | None = None) -> Work[tuple[Assembled, ...]]:
        """Find the points in the frames, and assemble H from them."""
        from lfcal.campaign import iter_assemble_points
        from lfcal.tasks.target_frames import opened_target, wanted_target

        start, plan = time.perf_counter(), wanted_target(self.frames, self.plan)
        assert plan is not None
        with opened_target(self.frames, plan, self.corrections, skip_damaged=self.skip_damaged) as view:
            made = yield from iter_assemble_points(view, plan, self.out, self.settings)
        one = Assembled(
            out=self.out,
            report=made.report,
            seconds=time.perf_counter() - start,
            points=made.points,
            target=plan,
            unused=made.unused,
            facts=made.facts,
        )
        return (one,)


@record
class AssembleRegions(_Assemble):
    """Assemble H of every region of a session into one file."""

    input_words: ClassVar[str] = "a session of several regions"

    orientation: str = opt(
        "check",
        "How to turn the frames upright: as-is, rot90, rot180, rot270 (anticlockwise), mirror-x (left to "
        "right), mirror-y, transpose, anti-transpose. auto: find the orientation. check: as-is, but stop if "
        "that is clearly wrong.",
        choices=orientations,
        read=read_orientation,
    )
    shift: str = opt(
        "0",
        "Number of bits by which to shift left-aligned samples to the right. auto: detect it from the samples.",
        unit="bit",
        examples=("auto",),
    )
    channel: str = opt(
        "",
        "Colour channel to use: R, G1, G2 or B of a mosaic; R, G or B of a colour image. each: write one H file for "
        "each colour.",
        examples=("each", "R", "G", "B", "G1", "G2"),
        empty="frames are used unchanged",
    )
    half_cell: bool = opt(
        False,
        "In a half-cell scan, use the pattern half a period away for each unrecorded position.",
        label="Complete a half-cell scan",
        more=True,
    )
    corrections: CorrectionRecipe = panel(CorrectionRecipe(), "Corrections")
    settings: AssemblySettings = panel(AssemblySettings(), "Cutout and storage", without=("store_tolerance",))

    def files(self, way: str) -> tuple[Path, ...]:
        """Return the files that the task reads (``way="in"``) or writes (``way="out"``).

        If each colour has its own H file, the files to write are known only after the frames are opened. They are then
        not included.
        """
        return () if way == "out" and self.channel == "each" else super().files(way)

    def work(self, run: RunSettings | None = None) -> Work[tuple[Assembled, ...]]:
        """Assemble the H of each region, and write all of them to one file, or to one file for each colour."""
        from lfcal.campaign import read_regions, save_parts, temporary_parts

        run, settings = run or RunSettings(), self.settings
        names, found = read_regions(self.frames).names, {}
        self._check_colours(names[0], run)
        with temporary_parts(self.out, names) as parts:
            for name in names:
                made = yield from self._region(name, parts[name]).work(RunSettings(workers=run.workers, force=True))
                for one in made:
                    one.close()
                found[name] = made
            # the result of each region, of one colour after the other
            colours = list(zip(*found.values(), strict=True))
            outs = [coloured(self.out, ones[0].name) for ones in colours]
            for out, ones in zip(outs, colours, strict=True):
                files = dict(zip(names, (one.out for one in ones), strict=True))
                save_parts(files, out, dtype=settings.dtype, compression=settings.compression, workers=run.workers)
        return tuple(
            replace(one, name=name, out=out)
            for out, ones in zip(outs, colours, strict=True)
            for name, one in zip(names, ones, strict=True)
        )

    def _region(self, name: str, out: Path) -> Assemble:
        """Return the task that assembles H of one region."""
        known = {one.name: getattr(self, one.name) for one in fields(AssembleRegions)}
        return Assemble(**known | {"frames": self.frames / name, "out": out})

    def _check_colours(self, name: str, run: RunSettings) -> None:
        """Check the H files of all colours before the work begins."""
        if self.channel != "each":
            return
        with ExitStack() as stack:
            parts = self._region(name, self.out).parts(stack, quiet=True)[1]
            check_outputs([part.out for part in parts], *self.files("in"), force=run.force)


@record
class Assemble(AssembleRegions):
    """Correct and crop point-source frames with the shifting cutout, and assemble them into H.

    Examples
    --------
    >>> from lfcal.tasks import Assemble, AssembleRegions, AssembleTarget
    >>> from lfcal.frames import CorrectionRecipe
    >>> dark = CorrectionRecipe(dark="session/dark")
    >>> (made,) = Assemble(frames="session/frames", out="made.h5", corrections=dark).run()
    >>> with made.report.matrix as H:
    ...     print(made.report.frames, "frames:", H.shape)
    1254 frames: (2, 19, 33, 55, 55)
    >>> others = AssembleRegions(frames="regions", out="H.h5"), AssembleTarget(frames="target/frames", out="H.h5")
    """

    input_words: ClassVar[str] = "frames of one scan"
    in_units: ClassVar[bool] = True

    plan: Path | None = opt(
        None,
        "Scan plan (.json).",
        short="-p",
        file="in",
        empty="the plan of the session, or plan.json in the frame folder or the folder above",
    )
    manifest: Path | None = opt(
        None, "Manifest or list of the frames (.csv, .tsv, .txt, .json).", file="in", empty="stored with the frames"
    )
    pattern: str = opt(
        "", "Pattern that reads positions from file names, such as 'z{z}_y{y}_x{x}.png'.", label="File names"
    )
    order: str = opt(
        "",
        "Scan order, to take positions from the order of the file names: serpentine or raster.",
        choices=("serpentine", "raster"),
    )
    columns: str = opt(
        "",
        "Contents of the columns of a list, such as file=Name,y_um=PosY,x_um=PosX,exposure_ms=Exp.",
        empty="inferred from the names of the columns",
        more=True,
    )
    first: int | None = opt(
        None,
        "First number of the positions in names or lists: 0 or 1.",
        at_least=0,
        at_most=1,
        empty="inferred",
        more=True,
    )
    origin: str = origin_field("the whole sensor, or as the session states")
    nan: str = opt(
        "auto",
        "Treatment of NaN in floating-point frames. auto: mask pixels that are NaN in all frames, and refuse "
        "frames with other NaN. mask: mask all NaN. refuse: refuse frames with NaN.",
        label="NaN in frames",
        choices=("auto", "mask", "refuse"),
        more=True,
    )
    fill: Path | None = opt(
        None,
        "Folder of a fit of this scan (lfcal fit). Its model fills missing positions, which remain marked as not "
        "recorded.",
        label="Fill from a fit",
        file="in",
        empty="not filled",
        more=True,
    )
    leave_out: Path | None = opt(
        None,
        "List of positions to leave out (.json), written by lfcal inspect.",
        label="Positions to leave out",
        file="in",
        empty="all positions are used",
        more=True,
    )
    settings: AssemblySettings = panel(AssemblySettings(), "Cutout and storage")

    @property
    def source(self) -> ScanFrames:
        """Settings with which the frames are opened."""
        from lfcal.frames import parse_origin

        names = (
            "frames",
            "plan",
            "manifest",
            "pattern",
            "order",
            "columns",
            "first",
            "skip_damaged",
            "orientation",
            "nan",
        )
        return ScanFrames(**{name: getattr(self, name) for name in names}, origin=parse_origin(self.origin))

    def files(self, way: str) -> tuple[Path, ...]:
        """Return the files that the task reads (``way="in"``) or writes (``way="out"``).

        If ``frames`` is a manifest, its folder is included. If each colour has its own H file, the files to write are
        not known in advance, and are not included.
        """
        files, beside = super().files(way), self.source.beside
        if way == "out":
            return () if self.channel == "each" else files
        return (*files, beside) if beside else files

    def work(self, run: RunSettings | None = None) -> Work[tuple[Assembled, ...]]:
        """Open and correct the frames, and assemble one H, or one for each colour."""
        from lfcal.frames import chosen_shift, is_part_of_sensor

        run = run or RunSettings()
        with ExitStack() as stack:
            (frames, scan), parts = self.parts(stack)
            note_assumed(scan.camera, "plan", light=False)
            # a session states which part of the sensor it recorded; for other frames the user must state it
            placed = frames.metadata.plan is not None or bool(self.origin)
            if not (placed or is_part_of_sensor(frames.shape, scan.camera)):
                note_size(frames.shape, scan.camera, folder=str(self.frames), channel=self.channel)
            bits, said = chosen_shift(self.shift, frames)
            for one in (*frames.metadata.notes, *((said,) if said else ())):
                note(one)
            for part in parts if self.channel == "each" else ():
                check_output(part.out, *self.files("in"), force=may_replace(part.out, run))
            ahead = len(frames) * math.prod(frames.shape) * frames.dtype.itemsize / RATE
            choices = [run.choice(part.out, ahead) for part in parts]
            made = []
            for part, choice in zip(parts, choices, strict=True):
                recipe = replace(self.corrections, shift=bits, channel=part.channel)
                made.append((yield from self._iter_colour(part, scan, recipe, choice, run.workers)))
        return tuple(made)

    def parts(self, stack: ExitStack, *, quiet: bool = False) -> tuple[tuple[Frames, ScanPlan], list[ChannelPart]]:
        """Return the open frames with their plan, and a `ChannelPart` for each H file to make.

        ``stack`` closes the frames. With ``quiet``, no notes are reported.
        """
        source = self.source

        def reopened(colour: str) -> Frames:
            return stack.enter_context(source.open(colour)[0])

        frames, scan = open_colour(source.open, self.channel)
        stack.enter_context(frames)
        return (frames, scan), parts_of(self.channel, frames, scan, self.out, reopened, quiet=quiet)

    def _iter_colour(
        self, part: ChannelPart, scan: ScanPlan, recipe: CorrectionRecipe, choice: RunChoice | None, workers: int | None
    ) -> Work[Assembled]:
        """Assemble one H from open frames, without damaged frames and with corrections."""
        from lfcal.frames import SelectedSource, corrected_view
        from lfcal.psf import Reopening

        start = time.perf_counter()
        frames = yield from self.iter_used(part.source, workers)
        chosen = frames.chosen.tolist() if isinstance(frames, SelectedSource) else range(len(frames))
        left_out = sorted(set(range(len(part.source))) - set(chosen))
        reopening: Reopening | None = None
        if choice is not None:
            # the inputs of H, without the output path
            found = {"channel": part.name, "left_out": left_out, "recipe": asdict(recipe)}
            task = self.to_dict(absolute=True, outputs=False)
            values = {"task": task, "found": found, "stamp": self._stamp(part.source)}
            reopening = Reopening(f"{__name__}:{open_planes.__name__}", values)
        view = corrected_view(frames, recipe, scan)
        made = yield from self.iter_part(part, scan, recipe, view, AssemblyRun(choice, reopening, workers))
        name = part.name if self.channel == "each" else ""
        return replace(made, name=name, seconds=time.perf_counter() - start)

    def iter_used(self, frames: FrameSource, workers: int | None = None) -> Work[FrameSource]:
        """Return the ``frames`` to assemble: without damaged ones (`skip_damaged`) and positions in `leave_out`."""
        from lfcal.frames import iter_undamaged, without_positions

        if self.skip_damaged:
            frames = yield from iter_undamaged(frames, workers=workers)
        return without_positions(frames, self.positions_left_out) if self.leave_out else frames

    @property
    def positions_left_out(self) -> tuple[Position, ...]:
        """Positions (z, y, x) whose frames are left out; raises `FileFormatError` if the list of them is not valid."""
        from lfcal.acquire import RedoList

        return () if self.leave_out is None else RedoList.read(self.leave_out).positions

    def iter_part(
        self, part: ChannelPart, scan: ScanPlan, recipe: CorrectionRecipe, view: CorrectedSource, how: AssemblyRun
    ) -> Work[Assembled]:
        """Assemble one H from corrected frames that are already open, and return the result.

        Parameters
        ----------
        part
            The frames as read, the plan of this H, and the file to write.
        scan
            The plan of the scan with all pixels of the sensor; the plan in ``part`` may be that of one colour.
        recipe, view
            Corrections of the frames, and the corrected frames.
        how
            Executor, number of threads, and how other processes open the frames.
        """
        from lfcal.frames import check_turned_colours, oriented, with_partners
        from lfcal.psf import iter_assemble_plan, iter_upright

        start = time.perf_counter()
        notes = part.source.metadata.notes
        turn, lie = yield from iter_upright(view, part.plan, self.orientation)
        applied = str(lie["orientation"]["applied"])
        check_turned_colours(part.source, scan, recipe, applied)
        upright: FrameSource = oriented(view, turn, part.plan.camera.sensor.shape)
        upright = with_partners(upright, part.plan) if self.half_cell else upright
        fill = self._fill(part.plan, how.workers)
        known: dict[str, Any] = {"intake": list(notes)} if notes else {}
        known |= {} if fill is None else {"filled": fill.provenance}
        known |= {"positions_left_out": [list(one) for one in self.positions_left_out]} if self.leave_out else {}
        known |= {"task": self.to_dict(absolute=True, outputs=False)}
        reopening = how.reopening
        if reopening is not None:
            reopening = replace(reopening, values={**reopening.values, "turn": applied})
        report = yield from iter_assemble_plan(
            upright,
            part.plan,
            part.out,
            self.settings,
            provenance=known | lie,
            fill=fill,
            run=how.choice,
            reopening=reopening,
            workers=how.workers,
        )
        return Assembled(out=part.out, report=report, seconds=time.perf_counter() - start)

    def _stamp(self, frames: Frames) -> str:
        """Return a fingerprint that changes if an input file of H changes."""
        from lfcal.frames import files_of
        from lfcal.work import stamp_of

        used = self.corrections
        own = (used.dark, used.white, used.defect_list, used.mask, self.fill or "", self.leave_out or "")
        others = {os.path.abspath(path) for name in map(str, own) for path in files_of(name) if path.is_file()}
        return stamp_of([*self.source.files(frames), *sorted(others)])

    def _fill(self, plan: ScanPlan, workers: int | None) -> Filler | None:
        if self.fill is None:
            return None
        from lfcal.fit import Filler, read_fit

        return Filler(read_fit(self.fill), plan, workers)


def open_planes(values: Mapping[str, Any], workers: int) -> AssembledPlanes:
    """Open the frames in a worker process, and return the planes of H to assemble.

    ``values`` contains the task and facts about its frames, and ``workers`` is the number of threads. Each process
    searches for defective pixels again.
    """
    import numpy as np

    from lfcal.frames import SelectedSource, corrected_view, named_orientation, oriented, with_partners
    from lfcal.psf import planes_of_frames

    # the output path is not an input of H
    said = {key: value for key, value in values["task"].items() if key != "task"} | {"out": "."}
    task, found = from_dict(Assemble, said), values["found"]
    raw, scan = open_colour(task.source.open, found["channel"])
    try:
        part = parts_of(found["channel"], raw, scan, Path(), _no_other, quiet=True)[0]
        frames: FrameSource = part.source
        if found["left_out"]:
            frames = SelectedSource(frames, np.setdiff1d(np.arange(len(frames)), found["left_out"]), ())
        view: FrameSource = corrected_view(frames, CorrectionRecipe(**found["recipe"]), scan)
        view = oriented(view, named_orientation(values["turn"]), part.plan.camera.sensor.shape)
        view = with_partners(view, part.plan) if task.half_cell else view
        return planes_of_frames(view, part.plan, values, task._fill(part.plan, workers), raw.close)
    except BaseException:
        raw.close()
        raise


def _no_other(colour: str) -> Frames:
    raise AssertionError(f"frames of {colour} are not open: this process assembles one channel only")


def kind_of(given: Mapping[str, Any]) -> type[Task]:
    """Return the class of the task that assembles the ``given`` frames."""
    from lfcal.campaign import is_regions
    from lfcal.tasks.target_frames import wanted_target

    frames = Path(given["frames"])
    if is_regions(frames):
        return AssembleRegions
    return Assemble if wanted_target(frames, given.get("plan")) is None else AssembleTarget


ASSEMBLE = TaskSet(
    "assemble",
    (Assemble, AssembleRegions, AssembleTarget),
    kind_of,
    "lfcal assemble session/frames --dark session/dark --white session/white -o H.h5",
)


@described_by(Assemble)
def assemble(
    frames: str | Path,
    out: str | Path,
    *,
    plan: str | Path | None = None,
    manifest: str | Path | None = None,
    pattern: str = "",
    order: str = "",
    columns: str = "",
    first: int | None = None,
    origin: str = "",
    nan: str = "auto",
    skip_damaged: bool = False,
    orientation: str = "check",
    shift: str = "0",
    channel: str = "",
    half_cell: bool = False,
    fill: str | Path | None = None,
    leave_out: str | Path | None = None,
    dark: str | Path = "",
    black_level: float | None = None,
    white: str | Path = "",
    white_mode: str = "field",
    white_floor: float = 0.05,
    defects: bool = False,
    defect_list: str | Path = "",
    mask: str | Path = "",
    background: str = "none",
    exposure: str = "auto",
    saturation: float | None = None,
    cutout: tuple[int, int] | str | None = None,
    lost: float | str = 0.005,
    interpolation: str = "",
    pad: bool = False,
    strict: bool = False,
    keep_pedestal: bool = False,
    dtype: str = "rounded",
    compression: str = "gzip",
    store_tolerance: float | str | None = None,
    run: RunSettings | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> tuple[Assembled, ...]:
    """Assemble H from point-source frames in files, as ``lfcal assemble`` does.

    The frames show a scan, a session of several regions of the field, or a target. A setting that does not apply to
    them raises an error. `lfcal.psf.assemble` takes frames as arrays.

    Parameters
    ----------
    run
        Number of threads or processes, and whether to continue an earlier run or to replace existing files.
    on_progress
        Function that is called with each `Progress` record.

    Returns
    -------
    tuple of Assembled
        One result for each region and, with ``channel="each"``, for each colour; otherwise a single one.
        ``report.matrix`` of each is its H, which is already closed if the frames show several regions.

    Raises
    ------
    InputError
        If a value is not allowed, or does not apply to these frames.

    Examples
    --------
    >>> import lfcal
    >>> (made,) = lfcal.assemble("session/frames", "made.h5", dark="session/dark", cutout=(41, 41))
    >>> with made.report.matrix as H:
    ...     print(made.report.frames, "frames:", H.shape)
    1254 frames: (2, 19, 33, 41, 41)
    """
    given = dict(locals())
    del given["run"], given["on_progress"]
    known = {row.name: row for row in rows(Assemble)}
    values = {name: known[name].value(value, name) for name, value in given.items()}
    made: tuple[Assembled, ...] = ASSEMBLE.make(
        {name: value for name, value in values.items() if value != known[name].default}, str
    ).run(run, on_progress=on_progress)
    return made
