"""The frames of a project: which are imported, and how they are corrected. No Qt."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from lfcal.base import drain, read_text
from lfcal.camera import ScanPlan
from lfcal.frames import FrameSource, Position, named_orientation, parse_origin, split_dataset
from lfcal.psf import CHECK, INTERPOLATIONS
from lfcal.records import from_flat
from lfcal.tasks import Assemble
from lfcal_gui.models import PageSettings, options_in
from lfcal_gui.pages.frames.import_choice import ImportChoice, list_of
from lfcal_gui.pages.frames.orientation import turned

if TYPE_CHECKING:
    from lfcal.frames import CorrectedSource, CorrectionChain, CorrectionRecipe, Frames

CORRECTIONS = (
    ("use_dark", "Dark frame", "Subtract what the sensor shows without light: the mean dark frame, else a level"),
    ("use_white", "White frame", "Divide by the relative brightness of the white frame"),
    ("use_defects", "Defect pixels", "Find defective pixels over all frames and interpolate them"),
    ("use_background", "Background", "Subtract the median of each frame's border"),
)
"""Setting, title and meaning of each correction."""

MEAN_DARK = "the mean dark frame"

HELD = frozenset(
    {
        *("frames", "out", "plan", "manifest", "pattern", "order", "columns", "first", "origin", "skip_damaged"),
        *("orientation", "shift", "channel", "dark", "white", "defects", "background", "interpolation"),
    }
)
"""Fields of `lfcal.tasks.Assemble` that have their own widgets; the form shows all others."""

WAYS = (("", "as the plan needs"), *((name, name) for name in INTERPOLATIONS))
"""How a cutout between pixels may be taken, with the words shown."""


@dataclass(frozen=True)
class FrameSettings(PageSettings):
    """Settings that read, correct and cut the frames of a project.

    Attributes
    ----------
    manifest, pattern, order, columns, first
        How positions are found in a folder without a manifest: its list, name pattern or scan order. Then the meaning
        of the list's columns, and the first index (``"0"``, ``"1"``; empty: found automatically).
    shift, channel
        Bits by which left-aligned samples are moved down; one colour of a mosaic or colour picture.
    dark, white
        Folders of dark and white frames, or empty.
    use_dark, use_white, use_defects, use_background
        Which corrections are made; see `CORRECTIONS`.
    skip_damaged
        Whether damaged frames are left out. Every frame is then read once when the folder is opened.
    interpolation
        How cutouts between pixels are taken; empty: as the plan needs.
    orientation
        Orientation that makes the frames upright, one of `lfcal.frames.ORIENTATIONS`, used without a check.
        ``"check"``: frames are used unchanged, unless the check finds that they are turned.
    origin
        Row and column on the sensor of the frames' first pixel, ``"120,64"``; empty: they are whole.
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
        """The other fields by their names, as the record has them."""
        return options_in(Assemble, dict(self.options))

    def usable(self) -> None:
        """Raise `InputError` if the orientation is unknown, or if the origin is not a row and a column."""
        parse_origin(self.origin)
        task_of(self, "frames", "H.h5")
        if self.orientation != CHECK:
            named_orientation(self.orientation)


def task_of(settings: FrameSettings, frames: str, out: str, plan: str = "") -> Assemble:
    """Return how H is made of ``frames`` by the ``plan`` in a file; raises `InputError` if values do not fit."""
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
    return "none: the files say where they are" if listed is None else f"{listed.name}, found"


@dataclass(frozen=True, eq=False)
class Delivered:
    """Input of the assembly of H: the frames as stored in their files, and how to correct and turn them.

    Attributes
    ----------
    frames, corrected
        The frames, before and after the ``recipe``.
    scan
        The plan of the whole scan, of which a colour has only a part.
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
        What H is made from.
    frames
        Number of the frame of each position ``(nz, ny, nx)``, -1 where there is none.
    plan
        The plan they were recorded by: a recorded session brings its own.
    interpolation
        How cutouts between pixels are taken; empty: as the plan needs.
    folder, chosen
        What was opened, and how.
    dark
        What is subtracted as no light; empty: nothing.
    positions
        Where positions come from while no manifest is named, in words.
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
        """Close the frames, on which all views of them are."""
        self.delivered.corrected.close()

    def recorded(self, position: Position) -> Position:
        """Return ``position``, or the nearest with a frame where it has none: in its plane, else in any."""
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
        """Frames that cannot be read and were left out, a line each: which, and why."""
        return tuple(one.reason for one in self.source.metadata.left_out)

    def place(self, position: Position) -> Position:
        """Return the position nearest to ``position`` that the plan has."""
        z, y, x = (min(max(v, 0), n - 1) for v, n in zip(position, self.frames.shape, strict=True))
        return Position(z, y, x)

    def step(self, position: Position, dy: int, dx: int) -> Position:
        """Return the position ``(dy, dx)`` further, line after line within its plane."""
        _, ny, nx = self.frames.shape
        x = position.x + dx
        y = position.y + dy + (x // nx if dx else 0)
        return Position(position.z, y % ny, x % nx)


def open_source(folder: str, settings: FrameSettings, plan: ScanPlan | None) -> Frames:
    """Open uncorrected frames by the settings; errors of opening are raised unchanged."""
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
    """Open frames and corrections by the settings; errors of opening are raised unchanged."""
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
    """Return what the corrections subtract as no light; empty: nothing."""
    from lfcal.frames import Dark
    from lfcal.frames.corrections import DarkSet

    for step in chain.steps:
        if isinstance(step, DarkSet):
            return f"the mean dark frame of each of {len(step.darks)} exposures" if len(step.darks) > 1 else MEAN_DARK
        if isinstance(step, Dark):
            return MEAN_DARK if step.frame is not None else f"the level {step.level:g} that file or plan state"
    return ""


@dataclass(frozen=True, eq=False)
class ImportedFrames:
    """Content of a folder of frames, before it is imported into the project.

    Attributes
    ----------
    folder
        The frames.
    settings
        Corrections found in the same folder.
    plan
        The plan they were recorded by, None where there is none.
    opened
        The frames, None where no plan says how.
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
    """Return the plan in the first of the folders that has one."""
    found = [folder / "plan.json" for folder in folders if (folder / "plan.json").is_file()]
    return ScanPlan.from_json(read_text(found[0])) if found else None
