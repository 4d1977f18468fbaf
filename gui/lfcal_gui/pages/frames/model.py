"""Frames of a project: import, correction, display and assembly into H. No Qt."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Work, drain, read_text
from lfcal.camera import ScanPlan
from lfcal.frames import FrameSource, Position, named_orientation, parse_origin, split_dataset
from lfcal.psf import CHECK, Cutout, FoundOrientation, Window
from lfcal.records import from_flat
from lfcal.tasks import Assemble, AssemblyRun
from lfcal_gui.models import FrameNumbers, PageSettings, frame_numbers, going_on, options_in, stamp_of_files
from lfcal_gui.pages.frames.import_choice import ImportChoice, list_of
from lfcal_gui.pages.frames.orientation import advice, turned

if TYPE_CHECKING:
    from lfcal.frames import CorrectedSource, CorrectionChain, CorrectionRecipe, Frames
    from lfcal.psf import AssemblyReport

CORRECTIONS = (
    (
        "use_dark",
        "Dark frame",
        "Subtract the signal without light: the mean dark frame or, if there is none, the black level",
    ),
    ("use_white", "White frame", "Divide by the relative brightness of the white frame"),
    ("use_defects", "Defect pixels", "Find defective pixels in all frames, and interpolate them"),
    ("use_background", "Background", "Subtract the median of each frame's border"),
)
"""Setting, title and tooltip of each correction."""

MEAN_DARK = "the mean dark frame"

HELD = frozenset(
    {
        *("frames", "out", "plan", "manifest", "pattern", "order", "columns", "first", "origin", "skip_damaged"),
        *("orientation", "shift", "channel", "dark", "white", "defects", "background"),
    }
)
"""Fields of `lfcal.tasks.Assemble` that have their own widgets; the form shows all others."""


@dataclass(frozen=True)
class FrameSettings(PageSettings):
    """Settings for reading, correcting and cutting the frames of a project.

    Attributes
    ----------
    manifest, pattern, order, columns, first
        How positions are found in a folder: by a list, a name pattern or a scan order. Then the roles
        of the list's columns, and the first index (``"0"``, ``"1"``; empty: found automatically).
    shift, channel
        Bits by which left-aligned samples are shifted down; one colour of a mosaic or colour image.
    dark, white
        Folders of dark and white frames; empty if none.
    use_dark, use_white, use_defects, use_background
        Which corrections are applied; see `CORRECTIONS`.
    skip_damaged
        Whether damaged frames are left out. Every frame is then read once when the folder is opened.
    interpolation
        Interpolation of cutouts between pixels; empty: as the plan requires.
    orientation
        Orientation that makes the frames upright, one of `lfcal.frames.ORIENTATIONS`, used without a check.
        ``"check"``: frames are used unchanged, unless the check finds that they are turned.
    origin
        Row and column on the sensor of the frames' first pixel, ``"120,64"``; empty: full frames.
    options
        Pairs of name and value of all other fields of `lfcal.tasks.Assemble` that are not at their defaults.
    """

    page: ClassVar[str] = "frames"

    manifest: str = ""
    pattern: str = ""
    order: str = ""
    columns: str = ""
    first: str = ""
    shift: int = 0
    channel: str = ""
    dark: str = ""
    white: str = ""
    use_dark: bool = True
    use_white: bool = True
    use_defects: bool = False
    use_background: bool = False
    skip_damaged: bool = False
    interpolation: str = ""
    orientation: str = CHECK
    origin: str = ""
    options: tuple[tuple[str, Any], ...] = ()

    @property
    def option_values(self) -> dict[str, Any]:
        """Values of ``options`` by name, with the types of the fields of the task."""
        return options_in(Assemble, dict(self.options))

    def usable(self) -> None:
        """Raise `InputError` if orientation or origin are invalid, or if values of the task do not match."""
        parse_origin(self.origin)
        task_of(self, "frames", "H.h5")
        if self.orientation != CHECK:
            named_orientation(self.orientation)


def task_of(settings: FrameSettings, frames: str, out: str, plan: str = "") -> Assemble:
    """Return the task that assembles H from ``frames`` with the plan in ``plan``; raise `InputError` if invalid."""
    own: dict[str, Any] = {
        "frames": Path(frames),
        "out": Path(out),
        "plan": Path(plan) if plan else None,
        "manifest": Path(settings.manifest) if settings.manifest else None,
        "pattern": settings.pattern,
        "order": settings.order,
        "columns": settings.columns,
        "first": int(settings.first) if settings.first else None,
        "origin": settings.origin,
        "skip_damaged": settings.skip_damaged,
        "orientation": settings.orientation,
        "shift": str(settings.shift),
        "channel": settings.channel,
        "dark": settings.dark if settings.use_dark else "none",
        "white": settings.white if settings.use_white else "",
        "defects": settings.use_defects,
        "background": "border" if settings.use_background else "none",
        "interpolation": settings.interpolation,
    }
    return from_flat(Assemble, own | settings.option_values)


def positions_words(frames: str, settings: FrameSettings) -> str:
    """Return the source of the frames' positions in words, if no other list is named."""
    if (Path(frames) / "session.json").is_file():
        return "records of the session"
    if settings.pattern:
        return "none: positions from file names"
    if settings.order:
        return f"none: frames in {settings.order} order"
    listed = list_of(ImportChoice(frames))
    return "none: positions from the files" if listed is None else f"{listed.name}, found"


@dataclass(frozen=True, eq=False)
class Delivered:
    """Input of the assembly of H: the frames as stored in their files, and how to correct and turn them.

    Attributes
    ----------
    frames, corrected
        The frames, before and after the ``recipe``.
    scan
        Plan of the full scan; a single colour has only part of its pixels.
    orientation
        As in `FrameSettings`.
    """

    frames: FrameSource
    corrected: CorrectedSource
    recipe: CorrectionRecipe
    scan: ScanPlan
    orientation: str


@dataclass(frozen=True, eq=False)
class Opened:
    """The open frames of a project, uncorrected and corrected, with the number of the frame for each position.

    Attributes
    ----------
    source, view
        The frames, and the corrected, upright view of them that is shown.
    delivered
        Input of the assembly of H.
    frames
        Index of the frame of each position ``(nz, ny, nx)``; -1 if there is none.
    plan
        Plan of the recording; a recorded session includes its own.
    interpolation
        Interpolation of cutouts between pixels; empty: as the plan requires.
    folder, chosen
        Opened folder, and its settings.
    dark
        Description of the subtracted dark signal; empty if none.
    positions
        Source of the positions if no list is named, in words.
    """

    source: FrameSource
    view: FrameSource
    delivered: Delivered
    frames: NDArray[np.int64]
    plan: ScanPlan
    interpolation: str = ""
    folder: str = ""
    chosen: FrameSettings = FrameSettings()
    dark: str = ""
    positions: str = ""

    def close(self) -> None:
        """Close the frames and all views of them."""
        self.delivered.corrected.close()

    def recorded(self, position: Position) -> Position:
        """Return ``position`` if it has a frame, else the nearest position with one, preferably in the same plane."""
        wanted = self.place(position)
        places = np.argwhere(self.frames >= 0)
        if self.frames[wanted] >= 0 or not len(places):
            return wanted
        away = np.abs(places - np.array(wanted))
        z, y, x = places[np.lexsort((away[:, 1] + away[:, 2], away[:, 0]))[0]].tolist()
        return Position(z, y, x)

    @property
    def missing(self) -> int:
        """Number of positions that have no frame."""
        return int(np.count_nonzero(self.frames < 0))

    @property
    def left_out(self) -> tuple[str, ...]:
        """Frames that cannot be read, one line each with the reason."""
        return tuple(one.reason for one in self.source.metadata.left_out)

    def place(self, position: Position) -> Position:
        """Return the position of the plan nearest to ``position``."""
        z, y, x = (min(max(v, 0), n - 1) for v, n in zip(position, self.frames.shape, strict=True))
        return Position(z, y, x)

    def step(self, position: Position, dy: int, dx: int) -> Position:
        """Return the position ``(dy, dx)`` further, continuing line by line within its plane."""
        _, ny, nx = self.frames.shape
        x = position.x + dx
        y = position.y + dy + (x // nx if dx else 0)
        return Position(position.z, y % ny, x % nx)


def open_source(folder: str, settings: FrameSettings, plan: ScanPlan | None) -> Frames:
    """Open uncorrected frames with these settings; errors of opening are raised unchanged."""
    from lfcal.frames import open_component, open_frames

    opening = partial(
        open_frames,
        folder,
        manifest=settings.manifest or None,
        pattern=settings.pattern or None,
        order=settings.order or None,
        columns=settings.columns,
        first=int(settings.first) if settings.first else None,
        plan=plan,
        orientation=settings.orientation,
        origin=parse_origin(settings.origin),
        nan=settings.option_values.get("nan", "auto"),
        skip_damaged=settings.skip_damaged,
    )
    return open_component(opening, settings.channel)


def open_imported(folder: str, settings: FrameSettings, plan: ScanPlan) -> Opened:
    """Open frames and corrections with these settings; errors of opening are raised unchanged."""
    from lfcal.frames import ThinnedSource, colour_scan, corrected_view

    source: FrameSource = open_source(folder, settings, plan)
    source = drain(task_of(settings, folder, "H.h5").iter_used(source))
    # one channel of a colour picture is selected already
    channel = "" if source.metadata.colour else settings.channel
    plan = source.metadata.plan or plan
    frames, own = source, plan
    if channel and (scan := colour_scan(source, plan, channel)) is not None:
        frames, own = ThinnedSource(source, scan), scan.plan
    recipe = _recipe(settings, channel)
    corrected = corrected_view(frames, recipe, plan)
    delivered = Delivered(frames, corrected, recipe, plan, settings.orientation)
    # with a channel or a shift of samples, show the frames as they go into the corrections
    raw = corrected.source if channel or settings.shift else source
    table = np.full(own.shape[:3], -1, np.int64)
    for index in range(len(raw)):
        table[raw.info(index).position] = index
    view = turned(corrected, own, settings.orientation)
    dark = _dark_words(corrected.chain)
    return Opened(
        raw,
        view,
        delivered,
        table,
        own,
        settings.interpolation,
        folder,
        settings,
        dark,
        positions=positions_words(folder, settings),
    )


def _recipe(settings: FrameSettings, channel: str) -> CorrectionRecipe:
    return replace(task_of(settings, "frames", "H.h5").corrections, shift=settings.shift, channel=channel)


def _dark_words(chain: CorrectionChain) -> str:
    """Return a description of the dark signal that the corrections subtract; empty if none."""
    from lfcal.frames import Dark
    from lfcal.frames.corrections import DarkSet

    for step in chain.steps:
        if isinstance(step, DarkSet):
            return f"the mean dark frame of each of {len(step.darks)} exposures" if len(step.darks) > 1 else MEAN_DARK
        if isinstance(step, Dark):
            return MEAN_DARK if step.frame is not None else f"the black level {step.level:g} from the file or the plan"
    return ""


@dataclass(frozen=True, eq=False)
class ImportedFrames:
    """Content of a folder of frames before its import into the project.

    Attributes
    ----------
    folder
        Folder of the frames.
    settings
        Corrections found in the same folder.
    plan
        Plan of the recording; None if there is none.
    opened
        The open frames; None without a plan.
    """

    folder: str
    settings: FrameSettings
    plan: ScanPlan | None
    opened: Opened | None

    def close(self) -> None:
        """Close the frames if they are not imported."""
        if self.opened is not None:
            self.opened.close()


def import_folder(path: str, settings: FrameSettings, plan: ScanPlan | None, *, keep: bool = False) -> ImportedFrames:
    """Open a folder of frames or a recorded session, with the dark frames, white frames and plan found near it.

    Settings of positions, samples, colour and orientation belong to the previous frames and are reset, unless
    ``keep`` is set.

    Errors of opening are raised unchanged; nothing is then imported.
    """
    from lfcal.acquire import SessionFile

    folder, dataset = split_dataset(path)
    chosen = replace(settings, dark="", white="")
    if not keep:
        chosen = replace(chosen, manifest="", pattern="", order="", columns="", first="", shift=0, channel="")
        chosen = replace(chosen, orientation=CHECK, origin="")
    if (folder / "session.json").is_file():
        plan, frames = SessionFile.read(folder).plan, folder
        # a session corrects with its own dark frames; those in this folder belong to the white image
        if (folder / "white").is_dir():
            dark = folder / "dark"
            chosen = replace(chosen, white=str(folder / "white"), dark=str(dark) if dark.is_dir() else "")
    else:
        inside = (folder / "frames").is_dir()
        frames = folder / "frames" if inside else folder
        around = folder if inside else folder.parent
        plan = _plan_in(around, around.parent if folder.is_file() else frames) or plan
        # in the folder of the frames, or in its parent
        places = [place / name for place in (frames, around) for name in ("dark", "white")]
        found = {place.name: str(place) for place in places if place.is_dir()}
        chosen = replace(chosen, dark=found.get("dark", ""), white=found.get("white", ""))
    named = f"{frames}::/{dataset}" if dataset else str(frames)
    opened = None if plan is None else open_imported(named, chosen, plan)
    return ImportedFrames(named, chosen, plan, opened)


def _plan_in(*folders: Path) -> ScanPlan | None:
    found = [folder / "plan.json" for folder in folders if (folder / "plan.json").is_file()]
    return ScanPlan.from_json(read_text(found[0])) if found else None


@dataclass(frozen=True, eq=False)
class Loaded:
    """One frame ``(rows, columns)`` before and after correction, with its statistics.

    Attributes
    ----------
    window
        First row, first column, rows and columns of the cutout.
    point
        Row and column of the paraxial image according to the plan.
    origin
        Sensor row and column of the frame's first pixel; window and point are relative to it.
    crop
        Cutout ``(nt, ns)`` as used for H, before and after correction; None if it leaves the frame.
    pixel_um
        Side of a pixel on the sensor (µm).
    """

    position: Position
    label: str
    raw: NDArray[Any]
    fixed: NDArray[np.float32]
    numbers: FrameNumbers
    window: tuple[int, int, int, int]
    point: tuple[float, float]
    origin: tuple[int, int] = (0, 0)
    crop: tuple[NDArray[Any], NDArray[Any]] | None = None
    pixel_um: float | None = None


def load_frame(opened: Opened, position: Position) -> Loaded:
    """Read and correct one frame; return it with the statistics of all its pixels and its cutout."""
    index = int(opened.frames[position])
    info = opened.view.info(index)
    raw = turned(opened.source, opened.plan, opened.delivered.orientation).read(index)
    fixed = opened.view.samples(index)
    cutout = Cutout.for_plan(opened.plan, interpolation=opened.interpolation)
    wanted = opened.chosen.option_values.get("cutout")
    # the smallest one that loses little light is found from all frames, when H is assembled
    cutout = replace(cutout, shape=wanted) if isinstance(wanted, tuple) else cutout
    corner = cutout.window(position)
    row, column = opened.plan.image_px(position).tolist()
    top, left = info.origin
    return Loaded(
        position,
        info.label,
        raw,
        fixed.values,
        frame_numbers(raw, fixed.saturated),
        (corner.row - top, corner.column - left, *cutout.reach),
        (row - top, column - left),
        info.origin,
        _crop(cutout, corner, (raw, fixed.values), info.origin),
        opened.plan.camera.sensor.pixel_um,
    )


def _crop(
    cutout: Cutout, window: Window, frames: tuple[NDArray[Any], NDArray[Any]], origin: tuple[int, int]
) -> tuple[NDArray[Any], NDArray[Any]] | None:
    """Return the cutout of both frames, whose first sensor pixel is ``origin``; None if it leaves the frames."""
    rows, columns = cutout.region(window)
    top, left = rows.start - origin[0], columns.start - origin[1]
    bottom, right = rows.stop - origin[0], columns.stop - origin[1]
    height, width = frames[0].shape
    if top < 0 or left < 0 or bottom > height or right > width:
        return None
    raw, fixed = (cutout.resample(frame[top:bottom, left:right], window) for frame in frames)
    return raw, fixed


def first_middle_last(opened: Opened) -> tuple[Loaded, ...]:
    """Return the first, middle and last frame in scan order; empty if there are no frames."""
    there = [p for p in opened.plan.positions() if opened.frames[p] >= 0]
    return tuple(load_frame(opened, there[k]) for k in (0, len(there) // 2, -1)) if there else ()


def understood(opened: Opened, found: FoundOrientation | None, chosen: str) -> tuple[str, str, str]:
    """Return the state of opened frames: merit (``"good"``, ``"fair"``, ``"bad"`` or empty), headline, sentence.

    ``found`` is the orientation found for the frames, None while unknown; ``chosen`` is the user's choice.
    """
    if found is None:
        return "", "Inspecting the frames …", "Their orientation is being compared with the plan."
    if (turn := advice(found, chosen)) is not None and not turn.chosen:
        return "bad", "The frames are not oriented as in the plan", f"{turn.words}."
    if opened.left_out:
        return "fair", "Some frames are damaged", f"{len(opened.left_out)} cannot be read and are left out of H."
    if opened.missing:
        return "fair", "Some positions have no frame", f"{opened.missing:,} of {opened.frames.size:,} are missing."
    if not found.name:
        return "fair", "Every position has a frame", f"The orientation of the frames is unclear: {found.reason}."
    return "good", "The frames are complete", "Every position has a frame, and the frames are oriented as in the plan."


def facts_of(opened: Opened) -> tuple[tuple[str, str, str], ...]:
    """Return facts about the frames as rows (name, number, remark)."""
    nz, ny, nx = opened.frames.shape
    rows, columns = opened.view.shape
    chosen = opened.chosen
    white = ("applied" if chosen.use_white else "not applied") if chosen.white else ""
    return (
        ("Frames", f"{len(opened.source):,}", f"{columns} × {rows} px"),
        ("Positions", f"{nx} × {ny}", f"in {nz} plane{'' if nz == 1 else 's'}"),
        ("Missing", f"{opened.missing:,}", ""),
        ("Subtracted", "", opened.dark or "nothing"),
        ("White frames", "", f"{Path(chosen.white).name}, {white}" if white else "none"),
        ("Positions from", "", Path(chosen.manifest).name or opened.positions),
    )


def iter_assembly(opened: Opened, path: str) -> Work[AssemblyReport]:
    """Check the orientation of the frames against the plan, then assemble H plane by plane from corrected frames.

    If you stop it, completed planes are kept, and the next call continues from them.

    Raises
    ------
    InputError
        As `lfcal.psf.upright.iter_upright` and `lfcal.psf.iter_assemble_plan`.
    """
    from lfcal.psf import Reopening
    from lfcal.tasks import ChannelPart

    given, chosen = opened.delivered, opened.chosen
    task = task_of(chosen, opened.folder, path)
    known = {
        "from": asdict(chosen),
        "plan": opened.plan.to_dict(),
        "stamp": stamp_of_files(
            opened.folder,
            *(chosen.dark, chosen.white, chosen.manifest, str(task.fill or ""), str(task.leave_out or "")),
            but=path,
        ),
    }
    source: Any = given.frames  # of a file, or a part of it
    part = ChannelPart(source, opened.plan, given.recipe.channel, Path(path))
    how = AssemblyRun(going_on(), reopening=Reopening("", known))
    made = yield from task.iter_part(part, given.scan, given.recipe, given.corrected, how)
    return made.report


def notes_of(report: AssemblyReport) -> tuple[str, ...]:
    """Return notes on an assembled H, one line each: its verdict, and how frames were turned and averaged."""
    from lfcal.judge import judgement_of

    turned = report.matrix.provenance.get("orientation", {}).get("note")
    return (judgement_of(report).verdict, *([turned] if turned else []), *report.notes)
