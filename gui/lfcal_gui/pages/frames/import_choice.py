"""The user's choices for an import: paths, roles of columns, and problems in the words of the dialog. No Qt."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from lfcal.base import InputError
from lfcal.frames import datasets_in, split_dataset
from lfcal.frames.lists import LENGTHS, TABLE_SUFFIXES, TIMES, Column, Table, clear_columns, find_columns, parse_columns
from lfcal_gui.models import said_in_window


@dataclass(frozen=True)
class ImportChoice:
    """The user's choices for an import; empty values are found automatically.

    Attributes
    ----------
    frames
        Folder, or one file of many frames, also with the dataset in it: ``scan.h5::/entry/data``.
    listed
        List of the frames, if it is in another folder.
    columns, header
        Roles of the columns of the list, in the format of ``lfcal assemble --columns``, and the column names for which
        they were chosen. Without names, they apply to any list.
    pattern, first
        Pattern of the positions in file names, and the first index of positions: ``""``, ``"0"`` or ``"1"``.
    order
        Scan order of numbered files: ``"serpentine"`` or ``"raster"``.
    shift
        Number of bits by which left-aligned samples are shifted down, or ``"auto"``.
    channel
        One colour of a mosaic or colour image.
    orientation
        Orientation that makes the frames upright, one of `lfcal.frames.ORIENTATIONS`; empty: it is checked.
    """

    frames: str
    listed: str = ""
    columns: str = ""
    header: tuple[str, ...] = ()
    pattern: str = ""
    first: str = ""
    order: str = ""
    shift: str = "auto"
    channel: str = ""
    orientation: str = ""

    @property
    def place(self) -> Path:
        """Path of the folder or file, without the dataset in it."""
        return split_dataset(self.frames)[0]


def check_ways(choice: ImportChoice) -> None:
    """Raise `InputError` if the user gave more than one source of positions."""
    ways = {"List": choice.listed, "Names": choice.pattern, "Order": choice.order}
    if len(said := [name for name, value in ways.items() if value]) > 1:
        words = f"{', '.join(said[:-1])} and {said[-1]}"
        raise InputError.expected(
            "positions of the frames", "one of List, Names and Order", words, "keep one and clear the others"
        )


def list_of(choice: ImportChoice) -> Path | None:
    """Return the list given by the user, or the only list in the folder of the frames; None if none."""
    if choice.listed:
        return Path(choice.listed)
    place = choice.place
    if choice.pattern or choice.order:
        return None
    if place.is_file():
        return place if place.suffix.lower() in TABLE_SUFFIXES else None
    for folder in (root_of(choice), place):
        if (folder / "manifest.json").is_file():
            return None
        lists = sorted(p for p in folder.glob("*") if p.suffix.lower() in (".csv", ".tsv") and p.is_file())
        lists = [p for p in lists if p.name == "manifest.csv"] or lists
        if lists:
            return lists[0] if len(lists) == 1 else None
    return None


def root_of(choice: ImportChoice) -> Path:
    """Return the folder of the frames, as `import_folder` finds it."""
    place = choice.place
    if place.is_dir() and (place / "frames").is_dir() and not (place / "session.json").is_file():
        return place / "frames"
    return place if place.is_dir() else place.parent


def choices_of_dataset(frames: str) -> tuple[tuple[str, str], ...]:
    """Return path and description of each dataset that may contain frames, if a file has several; otherwise nothing."""
    found, file = datasets_in(frames), split_dataset(frames)[0]
    if len(found) < 2:
        return ()
    return tuple((f"{file}::/{name}", f"/{name}   {' × '.join(map(str, axes))}") for name, axes in found.items())


HOLDS = (
    ("", "not used"),
    *((role, role) for role in ("file", "x", "y", "z", "page", "exposure")),
    ("dy", "dy (px)"),
    ("dx", "dx (px)"),
)
"""Roles that a column of a list can have, with their displayed names."""
LENGTH_UNITS = ("um", "mm", "nm", "m", "index")
TIME_UNITS = ("s", "ms", "us")


def units_of(role: str) -> tuple[str, ...]:
    """Return the units that a column of ``role`` may have; an empty unit means that it is detected."""
    own = {"exposure": TIME_UNITS, **dict.fromkeys("xyz", LENGTH_UNITS)}
    return ("", *own.get(role, ()))


def unit_shown(unit: str) -> str:
    """Return the name in `units_of` of a unit as written in headers, such as um for microns."""
    for known, units in ((LENGTHS, LENGTH_UNITS), (TIMES, TIME_UNITS)):
        if unit in known:
            return next(name for name in units if known[name] == known[unit])
    return unit


def columns_text(holds: dict[str, tuple[str, str]], without: Collection[str] = ()) -> str:
    """Return the value of ``--columns`` for the role and unit of each column (by its number from 1).

    Parameters
    ----------
    holds
        Role and unit of each column; an empty role: not used; an empty unit: detected.
    without
        Roles that no column may have.
    """
    parts = []
    for number, (role, unit) in holds.items():
        if role:
            parts.append(f"{role}{f'_{unit}' if unit and unit in units_of(role) else ''}={number}")
    return ",".join([*parts, *(f"{role}=" for role in sorted(without))])


def not_held(columns: str) -> set[str]:
    """Return the roles that the user excluded for all columns."""
    return {part.rstrip("=") for part in columns.split(",") if part.endswith("=")}


def columns_used(table: Table, columns: str) -> tuple[tuple[Column, ...], str]:
    """Return the columns that have a role, and the problem with these roles as text (empty: none)."""
    said = [part.partition("=")[::2] for part in columns.split(",") if part]
    roles = [key.partition("_")[0] for key, _ in said]
    if twice := [role for role in roles if roles.count(role) > 1]:
        held = [
            Column(role, table.columns[int(number) - 1], key.partition("_")[2])
            for role, (key, number) in zip(roles, said, strict=True)
            if number
        ]
        names = " and ".join(column.name for column in held if column.role == twice[0])
        problem = (
            f"{table.name}, content {twice[0]}: expected one column, got {names}; choose another "
            "content above one of them"
        )
        return tuple(held), problem
    stated = parse_columns(columns) if columns else None
    try:
        return find_columns(table, stated), ""
    except InputError as error:
        return clear_columns(table, stated), str(error)


BOXES = (
    ("--manifest", "choose the List above"),
    ("--columns", "choose the content above the column"),
    ("--pattern", "type the pattern of Names above"),
    ("--order", "choose their Order above"),
    ("--first", "choose above whether Positions are counted from 0 or 1"),
    ("--channel", "choose a colour above"),
    ("--orientation", "choose their Orientation above"),
    ("--origin", "enter their First pixel in Record > Folder when they are open"),
    ("name it as", "choose their Dataset above"),
    ("lfcal plan", "choose the camera, or make the plan of the scan, in Set up"),
)
"""Command-line options in messages, with the corresponding controls of the window."""


def said_in_dialog(problem: str) -> str:
    """Return ``problem`` without its command-line options, and with the remedy in the dialog."""
    *ways, last = [words for option, words in BOXES if option in problem] or [""]
    words = f"{', '.join(ways)}, or {last}" if ways else last
    return "; ".join(filter(None, (said_in_window(problem), words)))
