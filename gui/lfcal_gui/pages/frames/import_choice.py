"""The user's choices for an import, and the paths of frames and list that follow from them. No Qt."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from lfcal.base import InputError
from lfcal.frames import datasets_in, split_dataset
from lfcal.frames.lists import TABLE_SUFFIXES


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
        Meaning of its columns, in the format of ``lfcal assemble --columns``, and the column names it was chosen for.
        Without names it applies to any list.
    pattern, first
        Positions in names, and what they count from: ``""``, ``"0"`` or ``"1"``.
    order
        The scan order, of numbered files: ``"serpentine"`` or ``"raster"``.
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
            "positions of the frames", "one of List, Names and Order", words, "clear the others above"
        )


def list_of(choice: ImportChoice) -> Path | None:
    """Return the list that is named, or the only list in the folder of the frames."""
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
    """Return path and words of each dataset that may hold frames, if a file has several; else nothing."""
    found, file = datasets_in(frames), split_dataset(frames)[0]
    if len(found) < 2:
        return ()
    return tuple((f"{file}::/{name}", f"/{name}   {' × '.join(map(str, axes))}") for name, axes in found.items())
