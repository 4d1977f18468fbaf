"""Manifests from lists: files are found in the folder, and stage coordinates are converted to positions."""

from __future__ import annotations

import os
import re
import unicodedata
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import FileFormatError, InputError, StorageError, storage_errors
from lfcal.camera import ScanPlan
from lfcal.frames.formats import image_suffixes
from lfcal.frames.lists.listing import Listing
from lfcal.frames.lists.motion import Part
from lfcal.frames.lists.placing import ReadFrame, place
from lfcal.frames.manifest import FrameEntry, Manifest
from lfcal.frames.positions import first_number
from lfcal.frames.source import Position

__all__ = ["files_below", "find_files", "located", "manifest_of"]


def located(listing: Listing, root: Path) -> Listing:
    """Return ``listing`` with the paths of its files relative to ``root``.

    If the list states no pages but names files several times, the rows of a file are taken as its pages, in order.
    """
    files, notes = find_files(listing, root)
    pages = listing.pages
    if not any(pages) and len(set(files)) < len(files):
        _check_pages(listing, files)
        seen: Counter[str] = Counter()
        numbered = []
        for name in files:
            numbered.append(seen[name])
            seen[name] += 1
        pages = tuple(numbered)
        name, times = seen.most_common(1)[0]
        notes.append(f"pages: {name} is listed {times} times; its rows are taken as its pages, in order")
    return replace(listing, files=tuple(files), pages=pages, notes=(*listing.notes, *notes))


def _check_pages(listing: Listing, files: Sequence[str]) -> None:
    """Raise `FileFormatError` if a list of single frames names a file twice: its rows are not pages."""
    counts = Counter(files)
    twice = [name for name, times in counts.items() if times > 1]
    if 2 * len(twice) < len(counts):
        raise FileFormatError.expected(
            f"{listing.name}, rows of {twice[0]}",
            "one",
            counts[twice[0]],
            "delete the wrong rows, or add a column named page",
        )


def manifest_of(
    listing: Listing,
    *,
    plan: ScanPlan | None = None,
    plan_shape: Sequence[int] | None = None,
    first: int | None = None,
    read: ReadFrame | None = None,
    orientation: str = "",
    part: Part | None = None,
) -> tuple[Manifest, tuple[str, ...]]:
    """Return the manifest of a list, and its notes followed by notes on how positions were determined, one line each.

    Parameters
    ----------
    listing
        List from `located`.
    plan
        Scan plan to compare stage coordinates with; needed if the list contains any.
    plan_shape
        Number of positions ``(nz, ny, nx)`` of the scan, if there is no plan. It is used to detect ``first``.
    first
        Number of the first position along each axis, if the list states position numbers. None: detected.
    read, orientation, part
        As in `lfcal.frames.lists.placing.place`.

    Raises
    ------
    InputError
        If there are stage coordinates but no plan, they do not match the plan, or position numbers are less than
        ``first`` or outside the plan.
    FileFormatError
        If position numbers are fractions.
    """
    shape = plan.shape[:3] if plan is not None else plan_shape
    if listing.unit == "index":
        positions, note = _counted(listing, shape, first)
        return _manifest(listing, positions, listing.drift, plan), (*listing.notes, *note)
    if plan is None:
        raise InputError.expected(
            f"{listing.name}, stage coordinates",
            "the plan of the scan",
            "none",
            "choose it with --plan, or make it with lfcal plan CAMERA --positions LIST",
        )
    found = place(listing, plan, read, orientation, part)
    drift = found.drift if listing.drift is None else found.drift + listing.drift
    return _manifest(listing, found.positions, drift, plan), (*listing.notes, *found.notes)


def _counted(
    listing: Listing, shape: Sequence[int] | None, first: int | None
) -> tuple[NDArray[np.intp], tuple[str, ...]]:
    """Return position numbers (z, y, x) from 0, ``(N, 3)``, and a note if they were found to start at 1 in the list."""
    places = listing.places[:, ::-1]
    absent = ~np.isfinite(places).all(axis=0)
    if (places[:, ~absent] != np.round(places[:, ~absent])).any():
        raise FileFormatError.expected(
            f"{listing.name}, positions",
            "whole numbers",
            "fractions",
            "state their unit in the contents of the columns (--columns y_um=…,x_um=…)",
        )
    numbers = np.where(absent, 0, np.nan_to_num(places)).astype(np.intp)
    begin = (
        first_number(numbers[:, ~absent], None if shape is None else np.array(shape)[~absent])
        if first is None
        else first
    )
    numbers[:, ~absent] -= begin
    if numbers.min() < 0:
        k = int(numbers.min(axis=1).argmin())
        raise InputError.expected(
            f"{listing.name}, position of {listing.label(k)}",
            f"numbers from {begin}",
            "a smaller one",
            "correct the number of the first position (--first)",
        )
    note = ("positions: counted from 1 in the list",) if begin == 1 and first is None else ()
    return numbers, note


def _manifest(
    listing: Listing, positions: NDArray[np.intp], drift: NDArray[Any] | None, plan: ScanPlan | None
) -> Manifest:
    shifts = np.zeros((len(listing), 2)) if drift is None else drift
    exposures = listing.exposures or (None,) * len(listing)
    entries = tuple(
        FrameEntry(file, Position(*at), page, exposure, dy, dx)
        for file, page, at, exposure, (dy, dx) in zip(
            listing.files, listing.pages, positions.tolist(), exposures, shifts.tolist(), strict=True
        )
    )
    return Manifest(entries, plan_shape=None if plan is None else plan.shape[:3])


def files_below(root: Path, *, deep: bool) -> list[str]:
    """Return the paths, relative to ``root``, of the files in ``root`` and, if ``deep``, in its subfolders.

    Files and folders whose names begin with a dot are omitted.
    """
    names = []
    with storage_errors(root):
        for folder, folders, files in os.walk(root):
            folders[:] = [name for name in folders if deep and not name.startswith(".")]
            base = Path(folder).relative_to(root).as_posix()
            names += [name if base == "." else f"{base}/{name}" for name in files if not name.startswith(".")]
    return names


def find_files(listing: Listing, root: Path) -> tuple[list[str], list[str]]:
    r"""Return the path, relative to ``root``, of each listed frame, and notes on how the names were interpreted.

    A name may have backslashes, lack its suffix, or contain a folder of another computer (``D:\scan\a.tif``). The
    longest trailing part of the name that exists below ``root`` is then used. Paths outside ``root`` are never
    returned.

    Raises
    ------
    StorageError
        If a file is missing, or several files match a name.
    """
    wanted = [_parts(name) for name in listing.files]
    deep = any(len(parts) > 1 for parts in wanted)
    there = files_below(root, deep=deep)
    exact = {name: name for name in there}
    # Windows ignores upper and lower case in file names, and macOS separates letters from their accents
    folded: dict[str, list[str]] = {}
    for name in there:
        if PurePosixPath(name).suffix.lower() in image_suffixes():
            for key in {_folded(name), _folded(str(PurePosixPath(name).with_suffix("")))}:
                folded.setdefault(key, []).append(name)
    found: list[str] = []
    shortened: set[str] = set()
    ended = False
    for k, parts in enumerate(wanted):
        name, dropped = _match(listing, k, parts, exact, folded, root)
        found.append(name)
        ended = ended or PurePosixPath(name).suffix.lower() != PurePosixPath(parts[-1]).suffix.lower()
        if dropped:
            shortened.add("/".join(parts[:dropped]))
    notes = []
    if shortened:
        notes.append(f"names: files listed in {min(shortened)}/… are read from {root}")
    if ended:
        notes.append(f"names: {listing.files[0]} is read from {found[0]}")
    return found, notes


def _folded(name: str) -> str:
    return unicodedata.normalize("NFC", name).lower()


def _parts(name: str) -> Sequence[str]:
    """Return folders and file of a path of any system, without drive, root and ``.``; ``..`` matches nothing."""
    return [part for part in re.split(r"[\\/]+", re.sub(r"^[A-Za-z]:", "", name)) if part not in ("", ".")] or [name]


def _match(
    listing: Listing,
    k: int,
    parts: Sequence[str],
    exact: dict[str, str],
    folded: dict[str, list[str]],
    root: Path,
) -> tuple[str, int]:
    """Return the file, and the number of leading folders removed from its listed path."""
    for dropped in range(len(parts)):
        tail = "/".join(parts[dropped:])
        if tail in exact:
            return tail, dropped
        near = folded.get(_folded(tail), [])
        if len(near) > 1:
            raise StorageError(
                f"{listing.name}: {listing.files[k]!r} may be {near[0]} or {near[1]}; include the file extensions"
            )
        if near:
            return near[0], dropped
    raise StorageError(f"{listing.name}: {listing.files[k]!r} is not in {root}; copy it there or correct the list")
