"""Files as other programs and systems write them, found in the folder of frames."""

from __future__ import annotations

import os
import re
import unicodedata
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from lfcal.base import StorageError, storage_errors
from lfcal.frames.formats import image_suffixes
from lfcal.frames.lists.listing import Listing

__all__ = ["files_below", "find_files"]


def files_below(root: Path, *, deep: bool) -> list[str]:
    """Return the relative paths of the files below ``root``, links to folders not followed, hidden files left out."""
    names = []
    with storage_errors(root):
        for folder, folders, files in os.walk(root):
            folders[:] = [name for name in folders if deep and not name.startswith(".")]
            base = Path(folder).relative_to(root).as_posix()
            names += [name if base == "." else f"{base}/{name}" for name in files if not name.startswith(".")]
    return names


def find_files(listing: Listing, root: Path) -> tuple[list[str], list[str]]:
    r"""Return the path below ``root`` of each listed frame, and notes on how the names were understood.

    A name may have backslashes, lack its ending, or lead from a folder of another computer (``D:\scan\a.tif``): then
    as much of its end as is found in ``root`` counts. Nothing outside of ``root`` is ever named.

    Raises
    ------
    StorageError
        If a file is not there, or several could be meant.
    """
    wanted = [_parts(name) for name in listing.files]
    deep = any(len(parts) > 1 for parts in wanted)
    there = files_below(root, deep=deep)
    exact = {name: name for name in there}
    # names of files on Windows do not differ by capitals, and macOS writes letters and their dots apart
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
        notes.append(f"names: {min(shortened)}/… is looked for in {root}")
    if ended:
        notes.append(f"names: {listing.files[0]} is taken for {found[0]}")
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
    """Return the file and how many leading folders of its listed path were left away."""
    for dropped in range(len(parts)):
        tail = "/".join(parts[dropped:])
        if tail in exact:
            return tail, dropped
        near = folded.get(_folded(tail), [])
        if len(near) > 1:
            raise StorageError(
                f"{listing.name}: {listing.files[k]!r} may be {near[0]} or {near[1]}; write names with endings"
            )
        if near:
            return near[0], dropped
    raise StorageError(f"{listing.name}: {listing.files[k]!r} is not in {root}; copy it there or correct the list")
