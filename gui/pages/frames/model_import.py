"""What the import of frames is told and what it finds: list, names, alignment, colours, three frames. No Qt."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from gui.models.words import said_in_window
from gui.pages.frames.model import FrameSettings, Imported, Loaded, Opened, import_folder, load_frame, open_imported
from gui.pages.frames.orientation import other_sensor
from lfcal.camera import Camera, ScanPlan
from lfcal.errors import FileFormatError, InputError, LfcalError, StorageError
from lfcal.files import read_text
from lfcal.frames.aligned import find_shift
from lfcal.frames.colour_scan import colours_of
from lfcal.frames.components import COMPONENTS
from lfcal.frames.lists.columns import Column, clear_columns, find_columns, parse_columns
from lfcal.frames.lists.derived import plan_of_list
from lfcal.frames.lists.entries import located
from lfcal.frames.lists.open_table import any_listing, is_plain, reader
from lfcal.frames.lists.table import TABLE_SUFFIXES, Table, read_table
from lfcal.frames.orientation import named_orientation
from lfcal.frames.source import Position

__all__ = ["HOLDS", "UNITS", "ImportChoice", "Survey", "columns_text", "open_choice", "survey"]

HOLDS = (
    ("", "not used"),
    *((role, role) for role in ("file", "x", "y", "z", "page", "exposure")),
    ("dy", "dy (px)"),
    ("dx", "dx (px)"),
)
"""What a column of a list can hold, with the words shown."""
UNITS = ("", "um", "mm", "nm", "index", "s", "ms", "us")
"""Units of columns; empty: found."""
OTHER_SCAN = "the list is of another scan"
REPLACED = "plan: the project's is of another scan; one made from the list takes its place"
ROWS = 4
"""Rows of the list that are shown."""


@dataclass(frozen=True)
class ImportChoice:
    """What the user says of frames; empty is found.

    Attributes
    ----------
    frames
        Folder, or one file of many frames.
    listed
        List of the frames that does not lie with them.
    columns
        What its columns hold, as ``lfcal assemble --columns`` takes it.
    pattern, first
        Positions in names, and what they count from: ``""``, ``"0"`` or ``"1"``.
    shift
        ``"auto"`` or a number of bits.
    channel
        Colour.
    orientation
        What makes the frames upright, one of `lfcal.frames.ORIENTATIONS`; empty: they are checked.
    """

    frames: str
    listed: str = ""
    columns: str = ""
    pattern: str = ""
    first: str = ""
    shift: str = "auto"
    channel: str = ""
    orientation: str = ""


@dataclass(frozen=True, eq=False)
class Survey:
    """What was found for a choice.

    Attributes
    ----------
    table, used
        The list as text, and which columns are used for what; None and empty where there is no list.
    notes
        What was guessed, a line each.
    problem
        Why the frames cannot be opened with this; empty where they can.
    colours
        Channels of a mosaic.
    shift
        Bits that samples are moved down by.
    imported
        The frames, open; None where there is a problem.
    shown
        First, middle and last frame with their cutouts.
    """

    choice: ImportChoice
    table: Table | None = None
    used: tuple[Column, ...] = ()
    notes: tuple[str, ...] = ()
    problem: str = ""
    colours: tuple[str, ...] = ()
    shift: int = 0
    imported: Imported | None = None
    shown: tuple[Loaded, ...] = field(default=())

    def close(self) -> None:
        """Close the frames: they are not wanted."""
        if self.imported is not None:
            self.imported.close()


def columns_text(holds: dict[str, tuple[str, str]]) -> str:
    """Return ``--columns`` for what each column (by its number from 1) holds, with its unit."""
    parts = []
    for number, (role, unit) in holds.items():
        if role:
            allowed = role == "exposure" if unit in ("s", "ms", "us") else role in ("x", "y", "z")
            parts.append(f"{role}{f'_{unit}' if unit and allowed else ''}={number}")
    return ",".join(parts)


def survey(choice: ImportChoice, plan: ScanPlan | None, camera: Camera | None) -> Survey:
    """Return what is found for ``choice``: as much as can be, and what stands in the way of the rest.

    Parameters
    ----------
    choice
        What the user says.
    plan
        The project's plan; one that lies with the frames comes first, as in `import_folder`.
    camera
        Makes the plan of a list of stage coordinates where there is none.
    """
    found = Survey(choice)
    try:
        found = _with_table(found)
        if found.problem:
            return found
        return _with_any_plan(found, plan, camera)
    except FileFormatError as error:
        # only colour pictures have components; the window has a box where the command line has an option
        colours = COMPONENTS if "--channel" in str(error) else ()
        more = "; choose a colour above" if colours and not choice.channel else ""
        return replace(found, problem=f"{said_in_window(str(error))}{more}", colours=colours)
    except LfcalError as error:
        # frames on their side do not fit a sensor; the window has a box where the command line has an option
        turned = "; choose what makes them upright above" if "--orientation" in str(error) else ""
        return replace(found, problem=f"{said_in_window(str(error))}{turned}" if turned else str(error))


def _with_any_plan(found: Survey, plan: ScanPlan | None, camera: Camera | None) -> Survey:
    """Return the frames opened with the project's plan, or with that of the list where it is of another scan."""
    try:
        return _opened(found, plan, camera)
    except InputError as error:
        if plan is None or OTHER_SCAN not in str(error):
            raise
        try:
            other = _opened(found, None, camera)
        except LfcalError:
            raise error from None
        return replace(other, notes=(REPLACED, *other.notes))


def _list_of(choice: ImportChoice) -> Path | None:
    """Return the list that is named, or the only one that lies with the frames."""
    if choice.listed:
        return Path(choice.listed)
    place = Path(choice.frames)
    if place.is_file():
        return place if place.suffix.lower() in TABLE_SUFFIXES else None
    found = sorted(p for p in place.glob("*") if p.suffix.lower() in (".csv", ".tsv")) if not choice.pattern else []
    return found[0] if len(found) == 1 else None


def _with_table(found: Survey) -> Survey:
    path = _list_of(found.choice)
    if path is None or path.suffix.lower() not in TABLE_SUFFIXES or path.name.endswith("metadata.txt"):
        return found
    table = read_table(path)
    try:
        told = parse_columns(found.choice.columns) if found.choice.columns else None
        return replace(found, table=table, used=find_columns(table, told))
    except InputError as error:
        # the window has boxes where the command line has an option
        problem = str(error).partition("; say ")[0] + "; choose it above"
        return replace(found, table=table, used=clear_columns(table), problem=problem)


def settings_of(choice: ImportChoice, shift: int) -> Callable[[FrameSettings], FrameSettings]:
    """Return a function that puts a choice into a page's settings."""

    def apply(settings: FrameSettings) -> FrameSettings:
        return replace(
            settings,
            manifest=choice.listed,
            pattern=choice.pattern,
            columns=choice.columns,
            first=choice.first,
            shift=shift,
            channel=choice.channel,
            orientation=choice.orientation or settings.orientation,
        )

    return apply


def _opened(found: Survey, plan: ScanPlan | None, camera: Camera | None) -> Survey:
    choice, notes = found.choice, []
    if not Path(choice.frames).exists():
        raise StorageError(f"{choice.frames}: no such file or folder; check the path")
    if _own_plan(choice) is None and plan is None and camera is not None:
        plan, said = _derived(choice, camera)
        notes += said
    shift = 0 if choice.shift == "auto" else int(choice.shift)
    chosen = settings_of(choice, shift)
    imported = import_folder(choice.frames, chosen(FrameSettings()), plan, keep=True)
    if imported.opened is None or imported.plan is None:
        raise InputError.expected(
            "scan plan", "one with the frames or in the project", "none", "make it on the Plan page, or choose a list"
        )
    try:
        source = imported.opened.source
        if choice.shift == "auto" and (shift := find_shift(source)):
            opened = open_imported(imported.folder, replace(imported.settings, shift=shift), imported.plan)
            imported.close()
            imported = replace(imported, settings=replace(imported.settings, shift=shift), opened=opened)
            notes.append(f"samples: left-aligned, moved down by {shift}")
        opened = imported.opened
        assert opened is not None
        beside = [Path(path) for path in (imported.settings.dark, imported.settings.white) if path]
        notes += [f"{place.name} frames: those of the folder {place.name} in {place.parent.name}" for place in beside]
        if odd := other_sensor(opened.delivered.corrected, opened.plan):
            notes.append(odd)
        notes = [*notes, *opened.source.metadata.get("notes", ())]
        shown = tuple(load_frame(opened, position) for position in _three(opened))
    except BaseException:
        imported.close()
        raise
    colours = () if choice.channel else colours_of(source, imported.plan)
    return replace(found, notes=tuple(notes), colours=colours, shift=shift, imported=imported, shown=shown)


def _own_plan(choice: ImportChoice) -> ScanPlan | None:
    folder = Path(choice.frames)
    folder = folder if folder.is_dir() else folder.parent
    for place in (folder / "plan.json", folder.parent / "plan.json"):
        if place.is_file():
            return ScanPlan.from_json(read_text(place))
    return None


def _derived(choice: ImportChoice, camera: Camera) -> tuple[ScanPlan | None, list[str]]:
    """Return the plan of a list of stage coordinates, None where there is no such list."""
    path = _list_of(choice)
    if path is None or is_plain(path):
        return None, []
    listing = any_listing(path, choice.columns)
    if listing.unit == "index":
        return None, []
    place = Path(choice.frames)
    root = place if place.is_dir() else place.parent
    listing = located(listing, root)
    turn = named_orientation(choice.orientation) if choice.orientation else None
    plan, notes = plan_of_list(listing, camera, read=reader(listing, root, turn=turn))
    return plan, [f"plan: made from {path.name}", *notes]


def _three(opened: Opened) -> list[Position]:
    """Return the positions of the first, the middle and the last frame in scan order."""
    there = [p for p in opened.plan.positions() if opened.frames[p] >= 0]
    return [there[0], there[len(there) // 2], there[-1]] if there else []


def open_choice(survey_: Survey, project: FrameSettings) -> Imported:
    """Return the frames of a survey with the project's other settings kept."""
    imported = survey_.imported
    assert imported is not None
    own: dict[str, Any] = {
        name: getattr(imported.settings, name)
        for name in ("manifest", "pattern", "columns", "first", "shift", "channel", "dark", "white", "orientation")
    }
    return replace(imported, settings=replace(project, **own))
