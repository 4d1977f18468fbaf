"""Inspection of frames before import: list, file names, alignment of samples, colours, three frames. No Qt."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from lfcal.base import FileFormatError, InputError, LfcalError, StorageError, read_text
from lfcal.camera import Camera, ScanPlan
from lfcal.frames import COMPONENTS, colours_of, find_shift, named_orientation
from lfcal.frames.lists import (
    TABLE_SUFFIXES,
    Column,
    Table,
    any_listing,
    is_plain,
    located,
    plan_of_list,
    read_table,
    reader,
)
from lfcal_gui.pages.frames import import_choice
from lfcal_gui.pages.frames.import_choice import ImportChoice
from lfcal_gui.pages.frames.model import (
    FrameSettings,
    ImportedFrames,
    Loaded,
    first_middle_last,
    import_folder,
    open_imported,
    open_source,
)
from lfcal_gui.pages.frames.orientation import other_sensor

OTHER_SCAN = "the list is of another scan"
OTHER_LIST = "columns: chosen for another list"
REPLACED = "plan: the project's plan is of another scan; a plan made from the list replaces it"


@dataclass(frozen=True, eq=False)
class Survey:
    """Result of inspecting frames for an `ImportChoice`.

    Attributes
    ----------
    choice
        The user's choice, without column roles that belong to another list.
    table, used
        The list as text, and the columns that are used; None and empty if there is no list.
    notes
        Values that were guessed, one line each.
    problem
        Why the frames cannot be opened with this choice; empty if they can.
    colours
        Channels of a mosaic.
    shift
        Bits by which samples are shifted down.
    imported
        The open frames; None if there is a problem.
    shown
        First, middle and last frame with their cutouts.
    datasets
        Path and description of each dataset to choose from, if a file contains several stacks.
    """

    choice: ImportChoice
    table: Table | None = None
    used: tuple[Column, ...] = ()
    notes: tuple[str, ...] = ()
    problem: str = ""
    colours: tuple[str, ...] = ()
    shift: int = 0
    imported: ImportedFrames | None = None
    shown: tuple[Loaded, ...] = field(default=())
    datasets: tuple[tuple[str, str], ...] = ()

    def close(self) -> None:
        """Close the frames if they are not imported."""
        if self.imported is not None:
            self.imported.close()


def survey(choice: ImportChoice, plan: ScanPlan | None, camera: Camera | None) -> Survey:
    """Inspect the frames of ``choice`` and return what was found, with the first problem if there is one.

    Parameters
    ----------
    choice
        The user's choice.
    plan
        The project's plan. A plan found with the frames takes precedence, as in `import_folder`.
    camera
        Camera used to make a plan from a list of stage coordinates, if there is no plan.
    """
    found = Survey(choice)
    try:
        found = replace(found, datasets=import_choice.choices_of_dataset(choice.frames))
        import_choice.check_ways(choice)
        found = _with_table(found)
        if found.problem:
            return found
        return _with_any_plan(found, plan, camera)
    except LfcalError as error:
        # only colour pictures have components
        colours = COMPONENTS if isinstance(error, FileFormatError) and "--channel" in str(error) else ()
        return replace(found, problem=import_choice.said_in_dialog(str(error)), colours=colours)


def _with_any_plan(found: Survey, plan: ScanPlan | None, camera: Camera | None) -> Survey:
    """Open the frames with the project's plan or, if their list is of another scan, with a plan made from the list."""
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


def _with_table(found: Survey) -> Survey:
    choice, path = found.choice, import_choice.list_of(found.choice)
    listed = path is not None and path.suffix.lower() in TABLE_SUFFIXES and not path.name.endswith("metadata.txt")
    table = read_table(path) if path is not None and listed else None
    if choice.columns and (table is None or choice.header not in ((), table.columns)):
        note = (
            f"{OTHER_LIST}, so it is ignored"
            if table is None
            else f"{OTHER_LIST}, so columns were identified again in {table.name}"
        )
        found = replace(found, choice=replace(choice, columns="", header=()), notes=(note,))
    if table is None:
        return found
    used, problem = import_choice.columns_used(table, found.choice.columns)
    return replace(found, table=table, used=used, problem=import_choice.said_in_dialog(problem))


def settings_of(choice: ImportChoice, shift: int) -> Callable[[FrameSettings], FrameSettings]:
    """Return a function that applies a choice to the settings of the page."""

    def apply(settings: FrameSettings) -> FrameSettings:
        return replace(
            settings,
            manifest=choice.listed,
            pattern=choice.pattern,
            order=choice.order,
            columns=choice.columns,
            first=choice.first,
            shift=shift,
            channel=choice.channel,
            orientation=choice.orientation or settings.orientation,
        )

    return apply


def _opened(found: Survey, plan: ScanPlan | None, camera: Camera | None) -> Survey:
    choice, notes = found.choice, list(found.notes)
    if not choice.place.exists():
        raise StorageError(f"{choice.frames}: no such file or folder; check the path")
    if _own_plan(choice) is None and plan is None and camera is not None:
        plan, said = _derived(choice, camera)
        notes += said
    shift = 0 if choice.shift == "auto" else int(choice.shift)
    imported = _imported(choice, shift, plan)
    opened, scan = imported.opened, imported.plan
    assert opened is not None and scan is not None
    try:
        source = opened.source
        if choice.shift == "auto" and (shift := find_shift(source)):
            opened = open_imported(imported.folder, replace(imported.settings, shift=shift), scan)
            imported.close()
            imported = replace(imported, settings=replace(imported.settings, shift=shift), opened=opened)
            notes.append(f"samples: left-aligned, shifted down by {shift} bits")
        beside = [Path(path) for path in (imported.settings.dark, imported.settings.white) if path]
        notes += [f"{place.name} frames: from the folder {place.name} in {place.parent.name}" for place in beside]
        if odd := other_sensor(opened.delivered.corrected, opened.plan):
            notes.append(odd)
        if choice.order:
            notes.append(f"order: {choice.order}, beginning with {opened.source.info(0).label}")
        notes = [*notes, *opened.source.metadata.notes, *_range_notes(found, opened.plan)]
        shown = first_middle_last(opened)
    except BaseException:
        imported.close()
        raise
    colours = () if choice.channel else colours_of(source, scan)
    return replace(found, notes=tuple(notes), colours=colours, shift=shift, imported=imported, shown=shown)


def _imported(choice: ImportChoice, shift: int, plan: ScanPlan | None) -> ImportedFrames:
    """Return the open frames. Raise `InputError` for problems of the frames first, then if there is no plan."""
    listed = import_choice.list_of(choice)
    if listed is not None and not choice.place.is_file() and listed.parent != import_choice.root_of(choice):
        choice = replace(choice, listed=str(listed))
    chosen = settings_of(choice, shift)
    imported = import_folder(choice.frames, chosen(FrameSettings()), plan, keep=True)
    if imported.opened is None:
        if not choice.order:  # a scan order needs the plan
            open_source(imported.folder, imported.settings, None).close()
        raise InputError.expected(
            "scan plan", "one with the frames or in the project", "none", "make it in Set up, or choose a list"
        )
    return imported


def _own_plan(choice: ImportChoice) -> ScanPlan | None:
    folder = choice.place
    folder = folder if folder.is_dir() else folder.parent
    for place in (folder / "plan.json", folder.parent / "plan.json"):
        if place.is_file():
            return ScanPlan.from_json(read_text(place))
    return None


def _derived(choice: ImportChoice, camera: Camera) -> tuple[ScanPlan | None, list[str]]:
    """Return the plan derived from a list of stage coordinates (None without such a list) and notes on it."""
    path = import_choice.list_of(choice)
    if path is None or is_plain(path):
        return None, []
    listing = any_listing(path, choice.columns)
    if listing.unit == "index":
        return None, []
    root = import_choice.root_of(choice)
    listing = located(listing, root)
    turn = named_orientation(choice.orientation) if choice.orientation else None
    plan, notes = plan_of_list(listing, camera, read=reader(listing, root, turn=turn))
    return plan, [f"plan: made from {path.name}", *notes]


def _range_notes(found: Survey, plan: ScanPlan) -> list[str]:
    """Return a note that compares the depth range of the list with that of the plan."""
    axis, listed = plan.stage.away[1], import_choice.list_of(found.choice)
    column = next((column for column in found.used if column.role == axis), None)
    if listed is None or column is None or is_plain(listed):
        return []
    listing = any_listing(listed, found.choice.columns)
    if listing.unit == "index" or listing.counted:
        return []
    places = listing.places[:, "xyz".index(axis)]
    unit = "µm" if listing.unit == "um" else listing.unit or "of no unit"
    return [
        f"{axis}: from {places.min():.6g} to {places.max():.6g} {unit} in the list "
        f"({column.name}), planes from {min(plan.depths_um):.6g} to {max(plan.depths_um):.6g} µm in the plan"
    ]


def open_choice(survey_: Survey, project: FrameSettings) -> ImportedFrames:
    """Return the frames of a survey, keeping the other settings of the project."""
    imported = survey_.imported
    assert imported is not None
    own: dict[str, Any] = {
        name: getattr(imported.settings, name)
        for name in (
            "manifest",
            "pattern",
            "order",
            "columns",
            "first",
            "shift",
            "channel",
            "dark",
            "white",
            "orientation",
        )
    }
    return replace(imported, settings=replace(project, **own))
